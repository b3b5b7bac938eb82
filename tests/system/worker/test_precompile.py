"""The process that compiles every kernel beside a worker that has nothing to do."""

from pathlib import Path

from scripted import wait_for

from worker.precompile import Precompiling


def test_it_compiles_until_it_is_stopped(tmp_path: Path):
    process = Precompiling(str(tmp_path))
    try:
        wait_for(lambda: any(tmp_path.rglob("*-of-*.lock")))  # it compiles for a contact model
        assert process._process.poll() is None
    finally:
        process.stop()
    assert process._process.returncode is not None


def test_of_two_only_one_compiles(tmp_path: Path):
    first = Precompiling(str(tmp_path))
    try:
        wait_for(lambda: any(tmp_path.rglob("*-of-*.lock")))
        second = Precompiling(str(tmp_path))
        wait_for(lambda: second._process.poll() == 0)
        second.stop()
        assert first._process.poll() is None
    finally:
        first.stop()
