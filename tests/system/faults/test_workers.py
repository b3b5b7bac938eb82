"""Workers that die, hang, or exceed their memory: only the job to blame fails, and nothing is lost.

The long version, on a machine with nothing else to do:

    BOUNCE_TEST_RUNS=10 pytest -n 0 tests/system/faults/test_workers.py tests/nightly/faults/test_workers.py
"""

import os
import random
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from harm import died_writing, fragile_cluster, pids, wait_until_ready
from scripted import Counting, costing, wait_for
from served import running

from service.ledger.model import JobState
from worker.executors.dask import Dask
from worker.executors.inline import Inline

RUNS = int(os.environ.get("BOUNCE_TEST_RUNS", "2"))
#: Whether to check times, on a machine with nothing else to do.
STRICT = RUNS >= 10
#: The time limit of a chunk (s): far above what a chunk needs on a busy machine.
HUNG = 8.0
PATIENCE = 180.0


@pytest.fixture(scope="module")
def fragile() -> Iterator[Dask]:
    with fragile_cluster() as executor:
        yield executor


#: Cells of a huge job. None is at rest: such cells cost next to nothing.
BOUNCING = {"start": 2.0, "stop": 5.0, "num": 16_000}


def test_workers_killed_at_random_cost_only_what_was_in_flight(tmp_path: Path, fragile: Dask, inline: Inline):
    chance = random.Random(2)
    with running(tmp_path / "calm", inline) as service:
        calm = service.until(service.submit(costing()), JobState.DONE)
        expected = service.stored(calm)
    for run in range(RUNS):
        wait_until_ready(fragile)
        counting = Counting(fragile)
        with running(tmp_path / str(run), counting) as service:
            job = service.submit(costing())
            wait_for(lambda job=job, service=service: service.job(job).chunks_done >= 1)
            time.sleep(chance.uniform(0, 0.5))
            os.kill(chance.choice(pids(fragile)), signal.SIGKILL)
            service.until(job, JobState.DONE)
            assert service.stored(job) == expected
            assert counting.submitted - calm.chunks_total <= 4  # the window


def test_workers_are_killed_where_their_cluster_cannot_be_closed(monkeypatch: pytest.MonkeyPatch):
    """As distributed's fails, where a worker that died is just being started again."""
    executor = Dask(workers=1)
    cluster = executor._target.cluster
    close, worker = cluster.close, psutil.Process(cluster.workers[0].pid)

    def fail() -> None:
        raise AssertionError("can only join a started process")

    monkeypatch.setattr(cluster, "close", fail)
    executor.close()
    worker.wait(PATIENCE)
    close()  # its replacement


def test_what_a_killed_worker_had_begun_to_write_goes_with_the_end_of_the_job(tmp_path: Path, fragile: Dask):
    wait_until_ready(fragile)
    with running(tmp_path, fragile) as service:
        job = service.submit(costing("die_writing:2"))
        url = service.settings.store_of(job.store)
        service.until(job, JobState.DONE)
        assert died_writing(url).read_bytes()
        assert not list(Path(url, ".partial").iterdir())


@pytest.mark.timeout(400)
def test_only_the_job_to_blame_fails(tmp_path: Path, fragile: Dask):
    """Chunks that hang, exceed the memory, crash and raise, all at once, beside two jobs without any."""
    wait_until_ready(fragile)
    tries = 2  # a chunk may be slow or unlucky once
    terms = {"chunk_seconds": HUNG, "chunk_slack": 1.0, "chunk_tries": tries}
    with running(tmp_path, fragile, **terms) as service:
        bad = {
            name: service.submit(costing(f"{name}:2", omega=omega))
            for name, omega in {"hang": 0.51, "hog": 0.52, "poison": 0.53, "fail": 0.54}.items()
        }
        good = [service.submit(costing(omega=omega)) for omega in (0.6, 0.7)]
        for job in good:
            service.until(job, JobState.DONE, seconds=PATIENCE)
        ended = {name: service.until(job, JobState.FAILED, seconds=PATIENCE) for name, job in bad.items()}
        with service.ledger.reading() as ledger:
            failed = {name: ledger.failures(job) for name, job in ended.items()}
    why = {
        "hang": "it took longer than",
        "hog": "MB of memory",
        "poison": "died",
        "fail": "ValueError: the sp",
    }
    for name, job in ended.items():
        [failure] = failed[name]
        assert not STRICT or (job.finished or 0) - (job.started or 0) < tries * HUNG + 10
        assert (failure.chunk, failure.tries) == (2, tries)
        assert failure.place.startswith("chunk 2 (rest, gamma ")
        assert why[name] in failure.error
        assert job.chunks_done == job.chunks_total - 1
    assert "the spring broke" in (failed["fail"][0].traceback or "")


def test_nothing_waits_behind_a_chunk_that_hangs(tmp_path: Path, fragile: Dask):
    """The other chunks of its job, and another job, end long before its time limit."""
    wait_until_ready(fragile)
    with running(tmp_path, fragile, chunk_seconds=PATIENCE) as service:
        hung, good = service.submit(costing("hang:0")), service.submit(costing(omega=0.6))
        service.until(good, JobState.DONE)
        wait_for(lambda: service.job(hung).chunks_done == service.job(hung).chunks_total - 1)
        assert service.job(hung).state is JobState.RUNNING
        service.manager.cancel(hung.id)
        service.until(hung, JobState.CANCELLED)
        wait_until_ready(fragile)  # its worker is free again


def test_a_small_job_beside_a_huge_one_waits_only_for_what_has_begun(tmp_path: Path, fragile: Dask):
    """While it runs, at most three chunks of the huge job are computed, though dozens wait."""
    wait_until_ready(fragile)
    counting = Counting(fragile)
    with running(tmp_path, counting) as service:
        huge = service.submit(costing("huge", gamma=BOUNCING))
        wait_for(lambda: service.job(huge).chunks_done >= 2)
        for run in range(RUNS // 2):
            name = f"small {run}"
            small = service.submit(costing(name, chunks=10, seconds=0.03, omega=0.8 + run / 100))
            service.until(small, JobState.DONE)
            ended = counting.ended
            first, last = ended.index(name), len(ended) - ended[::-1].index(name)
            # One on each worker at the start, and one beside the last chunk of the small job.
            assert ended[first:last].count("huge") <= 3
        assert service.job(huge).state is JobState.RUNNING
        service.manager.cancel(huge.id)
        service.until(huge, JobState.CANCELLED)
