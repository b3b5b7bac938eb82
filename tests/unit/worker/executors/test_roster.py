"""What is known of workers: the events of their plugin, what the cluster tells, what it is asked for."""

import asyncio
import io
import pickle
from types import SimpleNamespace
from typing import Any

import pytest
from distributed import Status
from distributed.protocol.pickle import dumps
from tables import for_each

from worker.executors.base import ClusterState
from worker.executors.plugins import DEMAND, Demand, WorkerAdmission
from worker.executors.roster import Roster


def event(worker: str, **what: Any) -> dict[str, Any]:
    return {"worker": worker, "host": f"host of {worker}", "process": 7, **what}


@pytest.mark.parametrize("plugin", [WorkerAdmission({"Python": "3.11"}, ("stores", "mark")), Demand()])
def test_every_python_can_unpickle_the_plugins_without_this_project(plugin: Any):
    imported = []

    class Unpickler(pickle.Unpickler):
        def find_class(self, module: str, name: str) -> Any:
            imported.append((module, name))
            return super().find_class(module, name)

    made = Unpickler(io.BytesIO(dumps(plugin))).load()  # type: ignore[no-untyped-call]
    assert imported == [("builtins", "eval")]
    assert vars(made) == vars(plugin)


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


@for_each(("state", "fault", "explanation"), [
    (ClusterState(True, 1), None, None),
    (ClusterState(True, 1, reason="was slow", refused=("worker a",)), None, None),
    (
        ClusterState(True, 0, planned=0, refused=("worker a", "worker b")),
        "no workers yet (0 asked for); jobs wait until there are; workers refused: 2",
        "no workers yet (0 asked for); jobs wait until there are; workers refused: 2; worker a; worker b",
    ),
])  # fmt: skip
def test_why_no_chunk_is_computed(state: ClusterState, fault: str | None, explanation: str | None):
    assert (state.fault, state.explanation) == (fault, explanation)


@pytest.fixture
def scheduler() -> SimpleNamespace:
    """What the plugin sees of a scheduler of three workers that wants two by its tasks."""
    statuses = (Status.running, Status.paused, Status.running)
    workers = {number: SimpleNamespace(status=status) for number, status in enumerate(statuses)}
    return SimpleNamespace(adaptive_target=lambda _: 2, handlers={}, workers=workers, task_metadata={})


def test_a_cluster_shall_have_workers_for_what_is_left(scheduler: SimpleNamespace):
    demand = Demand()
    asyncio.run(demand.start(scheduler))
    target, needs = scheduler.handlers["adaptive_target"], scheduler.task_metadata[DEMAND]
    assert scheduler.adaptive_target("5s") == target("5s") == 2
    needs["one"] = (20.0, 100)
    assert target("5s") == 4 + 1  # and one for that which is paused
    assert target("4.9s") == 5 + 1
    needs["one"] = (1000.0, 3)
    assert target("5s") == 3 + 1
    needs["two"] = (11.0, 100)
    assert target("5s") == 3 + 3 + 1
    demand.remove_client(scheduler, "one")
    assert target("5s") == 3 + 1
    needs["two"] = (1.0, 1)
    assert target() == 2  # by the setting, of some seconds; never less than the tasks need
    demand.remove_client(scheduler, "two")
    demand.remove_client(scheduler, "nobody")
    assert target("5s") == 2
