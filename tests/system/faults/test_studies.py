"""Basins, multistability and adaptive maps have the same bytes whoever computes them and whoever dies."""

import os
import random
import signal
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from harm import pids
from scripted import Few, wait_for
from served import Running, running
from studies import STUDIES

from service.ledger.model import JobRecord, JobState
from worker import studies
from worker.executors.dask import Dask
from worker.executors.inline import Inline
from worker.kernel_cache import use_cache

PATIENCE = 180.0


@pytest.fixture(scope="module")
def workers() -> Iterator[Dask]:
    """Two worker processes of this module, which it kills."""
    use_cache()
    executor = Dask(workers=2)
    yield executor
    executor.close()


def submitted(service: Running, spec: dict[str, Any]) -> JobRecord:
    return service.manager.submit(studies.parse(spec)).job


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "spec",
    # That of basins takes longest; test_damage.py computes one again, in several slices.
    [pytest.param(spec, id=name) for name, spec in STUDIES.items() if name != "basins"],
)
def test_a_killed_worker_a_cancel_and_another_number_of_workers_change_no_byte(
    tmp_path: Path, workers: Dask, spec: dict[str, Any]
):
    chance = random.Random(4)
    with closing(Inline()) as one, running(tmp_path / "one", one) as service:
        job = service.until(submitted(service, spec), JobState.DONE, seconds=PATIENCE)
        assert job.chunks_total > 4
        expected = service.stored(job)
    wait_for(lambda: workers.state().workers == 2)
    first = Few(workers, 4)
    with running(tmp_path / "two", first) as service:
        job = submitted(service, spec)
        wait_for(lambda: service.job(job).chunks_done >= 1)
        os.kill(chance.choice(pids(workers)), signal.SIGKILL)
        wait_for(lambda: service.job(job).chunks_done >= 2)
        service.manager.cancel(job.id)
        wait_for(lambda: first.give_back() or service.job(job).state is JobState.CANCELLED)
        assert service.job(job).chunks_done <= 4
        first.most = job.chunks_total
        service.manager.resume(job.id)
        service.until(job, JobState.DONE, seconds=PATIENCE)
        assert service.stored(job) == expected
