"""Clients generated from the API document."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest
from extras import SYSTEM
from scripted import DEADLINE, wait_for
from served import computing, computing_at


def test_a_generated_client_submits_a_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("openapi_python_client", reason=SYSTEM)
    source, package = tmp_path / "openapi.json", tmp_path / "generated"
    with computing(tmp_path / "data") as client:
        source.write_bytes(client.get("/openapi.json").content)
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
