"""A scheduler that freezes, and one that is killed and restarted: found again, and nothing is computed twice.

Scheduler and workers are processes of their own that are restarted whenever they end, as with `restart:
unless-stopped`. With the limits for a machine with nothing else to do:

    BOUNCE_TEST_FREEZE=60 BOUNCE_TEST_BACK=15 pytest -n 0 tests/nightly/faults/test_scheduler.py
"""

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import psutil
import pytest
from dask_processes import Cluster, Restarted
from paths import CACHE, ROOT
from scripted import Counting, costing, free_port, wait_for
from served import Running, running

from service.ledger.model import JobRecord, JobState
from worker.executors.dask import Dask
from worker.kernel_cache import use_cache

#: The longest time (s) until the job goes on: scheduler and workers have to start. 15 on a quiet machine.
BACK = float(os.environ.get("BOUNCE_TEST_BACK", "60"))
#: Chunks in flight, of one job on two workers.
WINDOW = 4
FREEZE = float(os.environ.get("BOUNCE_TEST_FREEZE", "6"))


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[Restarted, str]]:
    use_cache()
    cluster = Cluster(tmp_path, free_port(), {"NUMBA_CACHE_DIR": str(CACHE), "PYTHONPATH": str(ROOT)})
    yield cluster.scheduler, cluster.address
    cluster.end()


@pytest.mark.timeout(600)
def test_a_scheduler_that_freezes_and_one_that_dies(
    tmp_path: Path, scheduler: tuple[Restarted, str], capsys: pytest.CaptureFixture[str]
):
    restarted, address = scheduler
    with closing(Dask(address, timeout=60)) as executor:
        counting = Counting(executor)
        wait_for(lambda: executor.state().workers == 2, seconds=90)
        with running(tmp_path / "data", counting) as service:
            job = service.submit(costing(chunks=150, seconds=0.1))

            def status() -> str:
                workers = executor.state().workers
                return f"{counting.submitted} submitted to {workers} workers: {service.job(job)}"

            def goes_on(since: float) -> float:
                """Seconds from `since` until another chunk is done."""
                done = service.job(job).chunks_done
                wait_for(lambda: service.job(job).chunks_done > done, status, 90)
                return time.monotonic() - since

            wait_for(lambda: service.job(job).chunks_done >= 2, status, 90)

            restarted.process.send_signal(signal.SIGSTOP)
            frozen = time.monotonic()
            wait_for(service.manager.fault)
            noticed = time.monotonic() - frozen
            time.sleep(max(FREEZE - noticed, 0))
            repetition = NoRepetition(service, job, counting)
            restarted.process.send_signal(signal.SIGCONT)
            thawed = goes_on(time.monotonic())
            repetition.check()

            wait_for(lambda: executor.state().workers == 2, status, 90)
            killed = time.monotonic()
            restarted.process.kill()
            wait_for(service.manager.fault)
            time.sleep(0.5)
            repetition = NoRepetition(service, job, counting)
            back = goes_on(killed)
            repetition.check()
            job = service.until(job, JobState.DONE, seconds=120)
            repetition.check()
            assert counting.submitted <= job.chunks_total + 2 * WINDOW
        with capsys.disabled():
            sys.stderr.write(
                f"\nfrozen for {FREEZE:g} s: not ready after {noticed:.1f} s, goes on {thawed:.1f} s after it"
                f"\nkilled: goes on after {back:.1f} s\n"
            )
        assert noticed < 10
        assert max(thawed, back) < BACK


@pytest.mark.timeout(600)
def test_lost_schedulers_leave_no_connections(scheduler: tuple[Restarted, str]):
    """Without the client of one connection, six losses leave about ten."""
    restarted, address = scheduler
    with closing(Dask(address, timeout=60)) as executor:
        wait_for(lambda: executor.state().workers == 2, seconds=90)
        before = psutil.Process().num_fds()
        for _ in range(6):
            restarted.process.kill()
            wait_for(lambda: executor.state().workers == 0, seconds=90)
            wait_for(lambda: executor.state().workers == 2, seconds=90)
        wait_for(lambda: psutil.Process().num_fds() <= before + 2, seconds=30)


class NoRepetition:
    """Checks that no chunk is submitted from now on that is marked as done now."""

    def __init__(self, service: Running, job: JobRecord, counting: Counting) -> None:
        self._done = set(np.flatnonzero(service.ledger.done_mask(job)))
        self._counting, self._first = counting, counting.submitted

    def check(self) -> None:
        assert not self._done & set(self._counting.chunks[self._first :])
