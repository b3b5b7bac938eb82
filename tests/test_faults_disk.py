"""No room for results: the job fails with the reason, the service lives, and resuming finishes it."""

import os
import resource
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from scripted import sweep
from test_lifecycle import running

from kernel.params import Outcome
from service.jobs import JobState
from worker.executors import Dask, Inline


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 2 MB, where this machine lets us have one."""
    place = tmp_path / "small"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(place)]
    try:
        mounted = subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        mounted = False
    if not mounted:
        pytest.skip("file systems cannot be mounted here")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def fill(path: Path) -> None:
    """Take what room there is, to the last byte."""
    with path.open("wb", buffering=0) as file:
        for size in (1 << 16, 1 << 12, 1):
            try:
                while True:
                    file.write(b"x" * size)
            except OSError:
                continue


def test_a_full_disk_fails_the_job_and_no_more(small_disk: Path):
    """Ledger and stores on it."""
    executor, spec = Inline(), sweep(gamma={"start": 2.0, "stop": 5.0, "num": 100}, keep=64, observe=200)
    with running(small_disk / "data", executor, heartbeat_seconds=0.2) as service:
        service.until(service.submit(sweep(omega=0.7)), JobState.DONE)
        ballast = small_disk / "ballast"
        fill(ballast)
        os.truncate(ballast, ballast.stat().st_size - (200 << 10))  # for accepting it
        job = service.until(service.submit(spec), JobState.FAILED)
        assert job.error is not None
        assert "No space left on device" in job.error
        ballast.unlink()
        job = service.until(service.submit(spec), JobState.DONE)
        assert (service.outcomes(job) != Outcome.MISSING).all()
    executor.close()


def test_a_disk_without_a_byte_left_delays_a_job_until_there_is_room(small_disk: Path):
    """Not even the ledger can say what happened; the job goes on by itself."""
    executor = Inline()
    with running(small_disk / "data", executor, heartbeat_seconds=0.2) as service:
        job = service.submit(sweep(gamma={"start": 0.5, "stop": 1.2, "num": 600}))
        service.until(job, JobState.RUNNING)
        ballast = small_disk / "ballast"
        fill(ballast)
        executor.ready()
        ballast.unlink()
        job = service.until(job, JobState.DONE, JobState.FAILED)
        if job.state is JobState.FAILED:  # a chunk met the full disk
            assert "No space left" in (job.error or "")
            service.submit(sweep(gamma={"start": 0.5, "stop": 1.2, "num": 600}))
            service.until(job, JobState.DONE)
    executor.close()


def test_a_limit_on_the_size_of_files_fails_the_job_and_no_more(tmp_path: Path, cluster: Dask):
    spec = sweep(gamma={"start": 2.0, "stop": 5.0, "num": 100}, keep=64, observe=200)
    run = cluster._link.client.run
    with running(tmp_path, cluster) as service:
        run(resource.setrlimit, resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
        try:
            job = service.until(service.submit(spec), JobState.FAILED)
        finally:
            run(resource.setrlimit, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
        assert "File too large" in (job.error or "")
        job = service.until(service.submit(spec), JobState.DONE)
        assert (service.outcomes(job) != Outcome.MISSING).all()
