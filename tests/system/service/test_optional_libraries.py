"""What an installation without extras says when it is asked for what needs one."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import pytest
from click.testing import CliRunner
from extras import EXTRAS, WITHOUT
from paths import CACHE, ROOT
from scripted import DEADLINE
from served import computing, finished

from service.cli.main import main

SWEEP: Final[dict[str, Any]] = {
    "gamma": [1.2, 1.3], "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"}, "settle": 5, "observe": 5,
}  # fmt: skip


@pytest.fixture
def no_pyarrow(monkeypatch: pytest.MonkeyPatch) -> None:
    from service.views import encode

    monkeypatch.setattr(encode, "find_spec", lambda name: None if name == "pyarrow" else 1 / 0)


def test_over_http_parquet_is_501_and_netcdf_is_there(tmp_path: Path, no_pyarrow: None):
    with computing(tmp_path) as client:
        job = finished(client, SWEEP)
        answers = [
            client.get(f"{job}/export?format=parquet"),
            client.post("/v1/plans?format=parquet", json=SWEEP),
            client.post("/v1/trajectories?format=parquet", json={"gamma": 1.2, "omega": 0.5, "xi": 0.26}),
        ]
        for answer in answers:
            assert (answer.status_code, answer.json()["title"]) == (501, "Not Implemented")
            assert 'pip install -e ".[parquet]"' in answer.json()["detail"]
        assert client.get(f"{job}/export?format=nc").status_code == 200


def test_a_run_says_so_before_it_computes(tmp_path: Path, no_pyarrow: None):
    specification = tmp_path / "sweep.json"
    specification.write_text(json.dumps(SWEEP))
    done = CliRunner().invoke(main, ["run", str(specification), "-o", str(tmp_path / "a.parquet")])
    assert done.exit_code == 1
    assert 'pip install -e ".[parquet]"' in done.stderr
    assert list(tmp_path.iterdir()) == [specification]


def test_a_program_without_any_extra_computes_and_writes_all_else(tmp_path: Path):
    """In a process that can import nothing but what the project depends on."""
    code = WITHOUT + (
        "from service import local; import pathlib;"
        f"spec, folder = {SWEEP!r}, pathlib.Path({str(tmp_path)!r});"
        "[local.run_to_file(spec, folder / f'a.{ending}', ending, {'omega': 0.5, 'xi': 0.26}, progress=False)"
        " for ending in ('nc', 'csv', 'png')];"
        "print(len(local.run(spec, progress=False).gamma))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False, timeout=DEADLINE,
        env={"NUMBA_CACHE_DIR": str(CACHE), "TMPDIR": str(tmp_path)}, input=json.dumps(EXTRAS),
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "2\n"), done.stderr
    assert {path.suffix for path in tmp_path.glob("a.*")} == {".nc", ".csv", ".png"}
