"""Clients generated from the API document."""

import importlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from extras import SYSTEM
from scripted import DEADLINE, wait_for
from served import computing, computing_at


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with computing(tmp_path_factory.mktemp("data")) as client:
        return client.get("/openapi.json").json()


def test_a_generated_client_submits_a_sweep(tmp_path: Path, document: Any, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("openapi_python_client", reason=SYSTEM)
    source, package = tmp_path / "openapi.json", tmp_path / "generated"
    source.write_text(json.dumps(document))
    (tmp_path / "options.yml").write_text("post_hooks: []\n")
    command = [sys.executable, "-m", "openapi_python_client", "generate", "--fail-on-warning"]
    options = ["--path", source, "--meta", "none", "--output-path", package]
    subprocess.run([*command, *options, "--config", tmp_path / "options.yml"], check=True, cwd=tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    generated = importlib.import_module("generated")
    models = importlib.import_module("generated.models")
    calls = {
        name: importlib.import_module(f"generated.api.{tag}.{name}").sync
        for tag, name in (("jobs", "submit_job"), ("jobs", "get_job"))
    }
    with (
        computing_at(tmp_path / "data") as address,
        generated.Client(base_url=address, timeout=DEADLINE) as client,
    ):
        fields = {"gamma": models.Range(start=1.0, stop=2.0, num=5), "omega": 0.5, "xi": [0.1, 0.26]}
        sweep = models.SweepSpec(**fields, model=models.Rigid(), settle=20, observe=10)
        job = calls["submit_job"](client=client, body=sweep)
        wait_for(lambda: calls["get_job"](job.id, client=client).state == "done")
        problem = calls["submit_job"](client=client, body=models.SweepSpec(gamma=-1.0, omega=0.5, xi=0.26))
        assert problem.status == 422
        assert problem.errors[0].field == "gamma"
