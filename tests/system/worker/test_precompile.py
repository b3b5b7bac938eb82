"""The process that compiles every kernel beside a worker that has nothing to do."""

import subprocess
import sys
from pathlib import Path

from scripted import wait_for

from worker.kernel_cache import BESIDE


def beside(root: Path) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-P", "-m", "worker.kernel_cache", BESIDE, str(root)]
    return subprocess.Popen(command, stdin=subprocess.PIPE)


def test_one_process_compiles_until_its_worker_ends(tmp_path: Path):
    with beside(tmp_path) as first:
        wait_for(lambda: any(tmp_path.rglob("*-of-*.lock")))  # it compiles for a contact model
        with beside(tmp_path) as second:
            assert second.wait(60.0) == 0
        assert first.poll() is None
    assert first.returncode == 0
