"""`bounce run`, interrupted."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest
from scripted import DEADLINE, wait_for
from stores import files
from studies import spec_of

from service import local
from service.client.models import JobStatus

SPEC = spec_of((0.6, 3.0, 25), [0.5, 0.6], 0.26, name="local", window=(30, 20, 4))

#: Cells of which a chunk takes tenths of a second, and the whole some seconds.
SOFT = {"kind": "soft", "penetration": 1e-3, "restitution": 0.01}
LONG = spec_of((1.0, 4.0, 40), (0.5, 0.6, 10), 0.26, name="local", model=SOFT, window=(4000, 20, 4))

OMEGA = {"start": 0.4, "stop": 1.2, "num": 60}
ORBITS = {"omega": OMEGA, "xi": [0.05, 0.1, 0.2], "protocol": {"kind": "orbits"}, "points": 40}


def chunks_done(folder: Path) -> int:
    """The chunks with which the next run begins, by the ledger; 0 before it has its tables."""
    address = f"file:{folder}/ledger.sqlite?mode=ro"
    with suppress(sqlite3.OperationalError), closing(sqlite3.connect(address, uri=True)) as ledger:
        return int(ledger.execute("SELECT count(*) FROM chunks").fetchone()[0])
    return 0


def interrupted(tmp_path: Path, number: int, spec: dict[str, Any] = LONG) -> subprocess.Popen[str]:
    """A `bounce run` that got a signal after chunks were stored."""
    file = tmp_path / "long.json"
    file.write_text(json.dumps(spec))
    process = subprocess.Popen(
        [sys.executable, "-m", "service.cli.entry", "run", str(file), "-o", "long.zarr", "--workers", "1"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # noqa: PLW1509
    )

    def has_begun() -> bool:
        assert process.poll() is None, process.communicate()[1]
        return chunks_done(tmp_path / "long.zarr.partial") >= 3

    wait_for(has_begun)
    process.send_signal(number)
    return process


@pytest.mark.parametrize(("number", "spec"), [(signal.SIGINT, LONG), (signal.SIGKILL, ORBITS)])
def test_an_interrupted_run_goes_on_where_it_stopped(
    tmp_path: Path, number: signal.Signals, spec: dict[str, Any]
):
    process = interrupted(tmp_path, number, spec)
    _, text = process.communicate(timeout=DEADLINE)
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert "the same command goes on in long.zarr.partial" in text
        assert "Traceback" not in text
    assert not (tmp_path / "long.zarr").exists()
    with pytest.raises(FileExistsError, match="another specification"):
        local.run(SPEC, tmp_path / "long.zarr", progress=False)
    seen: list[JobStatus] = []
    local.run(spec, tmp_path / "long.zarr", progress=seen.append)
    assert seen[0].progress.chunks_done > 0
    assert seen[-1].progress.cells_done == seen[-1].progress.cells_total
    local.run(spec, tmp_path / "whole.zarr", progress=False)
    assert files(tmp_path / "long.zarr") == files(tmp_path / "whole.zarr")
    assert not (tmp_path / "long.zarr.partial").exists()
