"""Workers on a machine with nothing else to do: times, and a kernel that is compiled."""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from harm import fragile_cluster, pids, wait_until_ready
from scripted import costing, wait_for
from served import Running, running

from service.ledger.model import JobState
from worker.executors.dask import Dask
from worker.sweep import SweepSpec

RUNS = int(os.environ.get("BOUNCE_TEST_RUNS", "5"))
PATIENCE = 180.0


@pytest.fixture(scope="module")
def fragile() -> Iterator[Dask]:
    with fragile_cluster() as executor:
        yield executor


#: Cells of a huge job. None is at rest: such cells cost next to nothing.
BOUNCING = {"start": 2.0, "stop": 5.0, "num": 16_000}


def test_cancelling_does_not_wait_for_compilation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The kernel of exponents is not compiled at the start of a worker, and takes many seconds."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    with closing(Dask(workers=1, memory=2 << 30)) as executor:
        wait_for(lambda: executor.state().workers == 1, seconds=PATIENCE)
        worker = pids(executor, 1)
        with running(tmp_path, executor) as service:
            sweep = costing(exponents=3, protocol={"kind": "ramp", "axis": "gamma", "direction": "up"})
            job = service.submit(sweep)
            service.until(job, JobState.RUNNING)
            time.sleep(1.0)
            began = time.monotonic()
            service.manager.cancel(job.id)
            ended = service.until(job, JobState.CANCELLED)
            assert time.monotonic() - began < 5
            assert ended.chunks_done == 0
        assert pids(executor, 1) == worker  # which goes on compiling


def test_a_chunk_that_holds_the_interpreter_is_ended_too(tmp_path: Path, fragile: Dask):
    wait_until_ready(fragile)
    with running(tmp_path, fragile, chunk_seconds=2.0, chunk_tries=1) as service:
        job = service.until(service.submit(costing("freeze:1")), JobState.FAILED)
        assert job.chunks_done == job.chunks_total - 1


@pytest.mark.timeout(400)
def test_a_small_job_beside_a_huge_one_is_hardly_delayed(
    tmp_path: Path, fragile: Dask, capsys: pytest.CaptureFixture[str]
):
    """Takes at most three times its time alone, plus a second: the longest chunk of the huge job."""
    wait_until_ready(fragile)
    with running(tmp_path, fragile, window_seconds=0.5) as service:
        alone = [timed(service, small(0.6 + run / 100)) for run in range(3)]
        huge = service.submit(costing("huge", gamma=BOUNCING))
        wait_for(lambda: service.job(huge).chunks_done >= 2)
        beside = []
        for run in range(RUNS):
            time.sleep(0.4)
            beside.append(timed(service, small(0.8 + run / 100)))
        assert service.job(huge).state is JobState.RUNNING
        service.manager.cancel(huge.id)
        service.until(huge, JobState.CANCELLED)
    with capsys.disabled():
        sys.stderr.write(f"\nalone {sorted(alone)[1]:.2f} s, beside at most {max(beside):.2f} s\n")
    assert max(beside) <= 3 * sorted(alone)[1] + 1.0, (alone, beside)


def small(omega: float) -> SweepSpec:
    return costing("small", chunks=8, seconds=0.1, omega=omega)


def timed(service: Running, spec: SweepSpec) -> float:
    began = time.monotonic()
    service.until(service.submit(spec), JobState.DONE)
    return time.monotonic() - began
