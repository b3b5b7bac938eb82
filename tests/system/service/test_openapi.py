"""Clients generated from the API document."""

import importlib
import json
import os
import shutil
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


#: A client in TypeScript: it submits a sweep, waits for it, and prints its job and what a wrong sweep gets.
TYPESCRIPT = """
import createClient from "openapi-fetch";
import type { paths } from "./api.js";

declare const process: { argv: string[] };
const client = createClient<paths>({ baseUrl: process.argv[2] });
const { data: job, error } = await client.POST("/v1/jobs", {
  body: {
    gamma: { start: 1.0, stop: 2.0, num: 5 },
    omega: 0.5,
    xi: [0.1, 0.26],
    model: { kind: "rigid" },
    settle: 20,
    observe: 10,
  },
});
if (!job || !("id" in job)) throw new Error(JSON.stringify(error));
const read = () => client.GET("/v1/jobs/{job_id}", { params: { path: { job_id: job.id } } });
let now = await read();
for (let i = 0; i < 600 && now.data?.state !== "done"; i++) {
  await new Promise((after) => setTimeout(after, 100));
  now = await read();
}
const wrong = await client.POST("/v1/jobs", { body: { gamma: -1.0, omega: 0.5, xi: 0.26 } });
console.log(JSON.stringify([now.data, wrong.response.status, wrong.error?.errors?.[0].field]));
"""

COMPILER = {
    "strict": True, "target": "es2022", "module": "nodenext", "moduleResolution": "nodenext",
    "lib": ["es2022", "dom"], "types": [],
}  # fmt: skip


def node_modules() -> Path | None:
    """The folder of what npm installed for all, if the parts of a client in TypeScript are there."""
    if shutil.which("npm") is None or shutil.which("node") is None:
        return None
    found = subprocess.run(["npm", "root", "--global"], capture_output=True, text=True, check=False)
    modules = Path(found.stdout.strip() or os.devnull)
    parts = ("openapi-typescript", "openapi-fetch", "typescript")
    return modules if all((modules / part).is_dir() for part in parts) else None


def test_a_generated_client_in_typescript_submits_a_sweep(tmp_path: Path, document: Any):
    modules = node_modules()
    if modules is None:
        pytest.skip("needs npm install --global openapi-typescript openapi-fetch typescript@5")

    def run(script: str, *arguments: object) -> subprocess.CompletedProcess[str]:
        command = ["node", script, *map(str, arguments)]
        return subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=DEADLINE
        )

    (tmp_path / "node_modules").symlink_to(modules)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    (tmp_path / "tsconfig.json").write_text(json.dumps({"compilerOptions": COMPILER, "files": ["main.ts"]}))
    (tmp_path / "openapi.json").write_text(json.dumps(document))
    generate, compile_ = "node_modules/openapi-typescript/bin/cli.js", "node_modules/typescript/bin/tsc"
    made = run(generate, "openapi.json", "--default-non-nullable=false", "--output", "api.ts")
    assert made.returncode == 0, made.stderr
    (tmp_path / "main.ts").write_text(TYPESCRIPT.replace('kind: "rigid"', 'kind: "rubber"'))
    assert '"rubber"' in run(compile_, "--noEmit").stdout
    (tmp_path / "main.ts").write_text(TYPESCRIPT)
    compiled = run(compile_)
    assert compiled.returncode == 0, compiled.stdout
    with computing_at(tmp_path / "data") as address:
        told = run("main.js", address)
    assert told.returncode == 0, told.stderr
    job, status, field = json.loads(told.stdout)
    assert (job["state"], job["progress"]["cells_done"]) == ("done", 10)
    assert (status, field) == (422, "gamma")
