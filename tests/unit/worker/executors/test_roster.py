"""What is known of workers: the events of their plugin, what the cluster tells, what it is asked for."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from distributed import Status
from tables import for_each

from worker.executors.base import ClusterState
from worker.executors.plugins import DEMAND, Demand
from worker.executors.roster import MARKS, Roster


def event(worker: str, **what: Any) -> dict[str, Any]:
    return {"worker": worker, "host": f"host of {worker}", "process": 7, **what}


def test_a_refused_worker_is_listed_until_it_is_admitted_or_gone(caplog: pytest.LogCaptureFixture):
    roster = Roster()
    roster.note(event("a", refused="its numpy is 1"))
    roster.note(event("a", refused="its numpy is 1"))
    assert caplog.text.count("refused: worker a") == 1
    roster.note(event("b", refused="no kernel"))
    assert roster.refused == {
        "a": "worker a on host of a (process 7): its numpy is 1",
        "b": "worker b on host of b (process 7): no kernel",
    }
    roster.note(event("a", refused="another reason"))
    assert "another reason" in caplog.text
    assert roster.refused["a"].endswith("another reason")
    roster.note(event("a", admitted=True))
    roster.keep({"b", "c"})
    assert list(roster.refused) == ["b"]
    roster.keep({"c"})
    assert roster.refused == {}


def test_a_chunk_that_fails_everywhere_is_a_mark_against_nobody():
    roster = Roster()
    for worker in ("a", "b", "c"):
        roster.failed("chunk", worker)
    assert roster.failed_on("chunk") == {"a", "b", "c"}
    assert roster.failed_on("other") == frozenset()


def test_marks_in_a_row_lead_to_a_rest():
    roster = Roster()
    for chunk in range(MARKS):
        roster.failed(chunk, "bad")
    assert [roster.computed(chunk, "good") for chunk in range(MARKS)] == [[], [], ["bad"]]
    assert roster.failed_on(0) == frozenset()


def test_a_chunk_computed_clears_the_marks():
    roster = Roster()
    for chunk in range(2 * MARKS):
        roster.failed(chunk, "unlucky")
        assert roster.computed(chunk, "good") == []
        assert roster.computed("another", "unlucky") == []


@for_each(
    ("state", "fault", "explanation"),
    [
        (ClusterState(True, 1), None, None),
        (ClusterState(True, 1, reason="was slow", refused=("worker a",)), None, None),
        (
            ClusterState(True, 0, planned=0, refused=("worker a", "worker b")),
            "no workers yet (0 asked for); jobs wait until there are; workers refused: 2",
            "no workers yet (0 asked for); jobs wait until there are; workers refused: 2; worker a; worker b",
        ),
    ],
)
def test_why_no_chunk_is_computed(state: ClusterState, fault: str | None, explanation: str | None):
    assert (state.fault, state.explanation) == (fault, explanation)


@pytest.fixture
def scheduler() -> SimpleNamespace:
    """What the plugin sees of a scheduler of three workers that wants two by its tasks."""
    statuses = (Status.running, Status.paused, Status.running)
    workers = {number: SimpleNamespace(status=status) for number, status in enumerate(statuses)}
    return SimpleNamespace(adaptive_target=lambda _: 2, handlers={}, workers=workers)


def test_a_cluster_shall_have_workers_for_what_is_left(scheduler: SimpleNamespace):
    demand = Demand()
    asyncio.run(demand.start(scheduler))
    target, tell = scheduler.handlers["adaptive_target"], scheduler.handlers[DEMAND]
    assert scheduler.adaptive_target("5s") == target("5s") == 2
    tell(client="one", seconds=20.0, tasks=100)
    assert target("5s") == 4 + 1  # and one for that which is paused
    assert target("4.9s") == 5 + 1
    tell(client="one", seconds=1000.0, tasks=3)
    assert target("5s") == 3 + 1
    tell(client="two", seconds=11.0, tasks=100)
    assert target("5s") == 3 + 3 + 1
    demand.remove_client(scheduler, "one")
    assert target("5s") == 3 + 1
    tell(client="two", seconds=1.0, tasks=1)
    assert target() == 1 + 1  # by the setting, of some seconds
    scheduler.adaptive_target = None
    demand.remove_client(scheduler, "two")
    demand.remove_client(scheduler, "nobody")
    assert target("5s") == 2


def test_it_is_never_less_than_the_tasks_need(scheduler: SimpleNamespace):
    scheduler.adaptive_target = lambda _: 9
    demand = Demand()
    asyncio.run(demand.start(scheduler))
    scheduler.handlers[DEMAND](client="one", seconds=20.0, tasks=100)
    assert scheduler.adaptive_target("5s") == 9
