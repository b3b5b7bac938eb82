"""Records of jobs: states, transitions, progress, and how they are shown over HTTP."""

from pathlib import Path
from typing import Any

import ledgers
import pytest
from scripted import Held, sweep, wait_for
from served import get, service
from tables import for_each

from service.errors import IllegalTransition
from service.ledger.model import Failure, JobRecord, JobState, check_transition, summary_of

#: Every transition there is; anything else is illegal.
ALLOWED = {
    ("queued", "running"),
    ("queued", "failed"),
    ("queued", "cancelled"),
    ("running", "done"),
    ("running", "failed"),
    ("running", "cancelled"),
    ("done", "running"),
    ("done", "failed"),
    ("failed", "queued"),
    ("cancelled", "queued"),
}


def record(**changes: Any) -> JobRecord:
    """A running job of 1000 cells, of which 400 are done."""
    running: dict[str, Any] = {
        "state": JobState.RUNNING, "cells_total": 1000, "chunks_total": 10, "created": 90.0, "started": 95.0,
        "progressed": 104.0, "chunks_done": 4, "cells_done": 400, "cells_computed": 40,
    }  # fmt: skip
    return ledgers.record(sweep(), **running | changes)


@for_each("new", JobState)
@for_each("old", JobState)
def test_transitions_are_these_and_no_others(old: JobState, new: JobState):
    if (old, new) in ALLOWED:
        check_transition(old, new)
    else:
        with pytest.raises(IllegalTransition, match=f"{old} cannot become {new}"):
            check_transition(old, new)


def test_the_time_left_falls_between_chunks_to_half_at_least():
    job = record(progressed=104.0, seconds_left=16.0)
    first = record(progressed=104.0, seconds_left=16.0, cells_done=0)
    assert [x.progress(104.0, compiling=True)["eta_seconds"] for x in (job, first)] == [16.0, None]
    assert first.progress(104.0)["eta_seconds"] == 16.0
    assert job.eta_seconds(109.0) == 11.0
    assert job.eta_seconds(204.0) == 8.0
    assert record(seconds_left=16.0, progressed=None).eta_seconds(104.0) is None
    assert record(seconds_left=None).eta_seconds(104.0) is None
    assert record(seconds_left=16.0, state=JobState.DONE).eta_seconds(104.0) is None


@pytest.mark.parametrize(("first_cells", "needed"), [(100, 40 + 60), (91, 40 + 55)])
def test_an_adaptive_map_needs_at_least_the_first_rounds_of_the_chunks_to_come(first_cells: int, needed: int):
    progress = record(first_cells=first_cells).progress(104.0)
    assert (progress["cells_computed"], progress["cells_needed"]) == (40, needed)


@for_each("change", [
    {"id": "b" * 32}, {"state": JobState.DONE}, {"error": "because"}, {"choice": "{}"},
    {"chunks_done": 5}, {"started": 51.0}, {"finished": 60.0}, {"owner": "ann"}, {"pinned": True},
    {"kernel_version": "0"},
])  # fmt: skip
def test_what_a_job_shows_has_another_revision_when_it_changes(change: dict[str, Any]):
    assert record(**change).revision(104.0) != record().revision(104.0)


def test_what_a_job_shows_has_another_revision_when_the_time_left_has_changed_by_a_tenth():
    job = record(seconds_left=100.0)
    assert job.revision(104.1) == job.revision(104.0) != job.revision(115.0)


def failures(*tries: int) -> list[Failure]:
    return [Failure(number, f"chunk {number}", "no", None, count) for number, count in enumerate(tries)]


@for_each(("given", "summary"), [
    (failures(), None),
    (failures(1), "chunk 0: no"),
    (failures(2), "chunk 0: no (2 times)"),
    (failures(1, 5), "chunk 0: no (and 1 more chunk failed)"),
    (failures(3, 1, 1), "chunk 0: no (3 times) (and 2 more chunks failed)"),
])  # fmt: skip
def test_failures_are_told_by_the_first_and_the_number_of_others(given: list[Failure], summary: str | None):
    assert summary_of(given) == summary


def test_a_job_that_is_not_computed_says_why_until_it_ends(tmp_path: Path):
    with service(tmp_path, Held(capacity=0)) as client:
        here = client.post("/v1/jobs", json=sweep().as_submitted()).headers["Location"]
        manager = client.app.state.service.manager  # type: ignore[attr-defined]
        wait_for(lambda: manager.supervisor.cluster.explanation is not None)
        assert get(client, here)["notice"] == manager.supervisor.cluster.explanation
        client.post(f"{here}/cancel")
        wait_for(lambda: bool(get(client, here)["state"] == "cancelled"))
        assert get(client, here)["notice"] is None
