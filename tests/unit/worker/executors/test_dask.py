"""What an executor makes of workers and of a scheduler that are too busy to answer soon."""

from types import SimpleNamespace
from typing import Any

import pytest
from scripted import DEADLINE

from worker.executors import dask
from worker.executors.dask import Dask
from worker.executors.plugins import NOT_JUDGED
from worker.executors.roster import Roster


@pytest.fixture
def executor() -> Any:
    """One without a cluster."""
    executor = Dask.__new__(Dask)
    executor._roster, executor._tasks = Roster(), {}
    executor._target = SimpleNamespace(planned=lambda: None)
    return executor


@pytest.mark.parametrize("last", [["", NOT_JUDGED], ["no kernel", "no kernel"]])
def test_own_workers_are_judged_before_they_count_as_refused(
    executor: Any, monkeypatch: pytest.MonkeyPatch, last: list[str]
):
    monkeypatch.setattr(dask, "JUDGED_SECONDS", 0.0)
    answers = iter([[NOT_JUDGED, NOT_JUDGED], ["no kernel", NOT_JUDGED], last])
    run = lambda *_, **__: dict(enumerate(next(answers)))  # noqa: E731
    executor._connection = SimpleNamespace(client=SimpleNamespace(run=run))
    assert executor._why_none_computes(DEADLINE) == last[0]


def test_a_chunk_that_failed_goes_elsewhere_also_after_a_scheduler_did_not_answer(executor: Any):
    answers = iter([{"a": 1, "b": 1}, None, {}])
    executor._connection = SimpleNamespace(worker_threads=lambda: next(answers), fault="")
    executor._roster.failed("a chunk", "a")
    found = []
    for _ in range(3):
        executor._count()
        found.append((executor._state.workers, executor._others("a chunk")))
    assert found == [(2, ("b",)), (0, ("b",)), (0, ())]
