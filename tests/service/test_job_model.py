"""States, transitions and progress."""

import pytest

from kernel.params import KERNEL_VERSION
from service.errors import IllegalTransition
from service.jobs.model import (
    LEGAL,
    RESUMABLE,
    UNFINISHED,
    JobRecord,
    JobState,
    Progress,
    check_transition,
)

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


@pytest.mark.parametrize("new", JobState)
@pytest.mark.parametrize("old", JobState)
def test_transitions_are_these_and_no_others(old: JobState, new: JobState):
    if (old, new) in ALLOWED:
        check_transition(old, new)
    else:
        with pytest.raises(IllegalTransition, match=f"{old} cannot become {new}"):
            check_transition(old, new)


def test_every_state_has_its_transitions_and_is_unfinished_resumable_or_done():
    assert set(LEGAL) == set(JobState)
    assert set(UNFINISHED) | set(RESUMABLE) | {JobState.DONE} == set(JobState)


def test_percent_is_100_only_when_all_is_done():
    assert Progress(0, 9, 0, 1_000_000).percent == 0
    assert Progress(8, 9, 999_999, 1_000_000).percent == 99.9
    assert Progress(9, 9, 1_000_000, 1_000_000).percent == 100


def test_eta_uses_the_rate_of_this_run_alone():
    # 900 of 1000 cells were done before; this run did 20 in 4 s, 80 are left
    progress = Progress(0, 0, 920, 1000, run_seconds=4.0, run_cells=20)
    assert progress.eta_seconds == pytest.approx(16.0)


def test_a_rate_may_be_of_one_cell_or_of_less_than_a_second():
    assert Progress(0, 9, 1, 10, run_seconds=3.0, run_cells=1).eta_seconds == pytest.approx(27.0)
    assert Progress(0, 9, 4, 10, run_seconds=0.5, run_cells=4).eta_seconds == pytest.approx(0.75)


def test_eta_is_unknown_without_a_rate():
    assert Progress(0, 9, 0, 1000, run_seconds=3.0, run_cells=0).eta_seconds is None
    assert Progress(0, 9, 4, 1000, run_seconds=0.0, run_cells=4).eta_seconds is None
    assert Progress(5, 9, 500, 1000).eta_seconds is None


@pytest.mark.parametrize(
    ("state", "finished", "repairing"),
    [
        (JobState.RUNNING, 5.0, True),
        (JobState.RUNNING, None, False),
        (JobState.DONE, 5.0, False),
        (JobState.FAILED, 5.0, False),
        (JobState.QUEUED, None, False),
    ],
)
def test_only_a_running_job_that_was_done_before_is_repairing(
    state: JobState, finished: float | None, repairing: bool
):
    job = JobRecord(
        id="a" * 32, name="", spec="{}", kernel_version=KERNEL_VERSION, chunk_shape=(1, 1, 1), chunks_total=1,
        cells_total=1, seq=1, state=state, cancel_requested=False, error=None, created=0.0, started=0.0,
        finished=finished, run_started=0.0, run_cells=0, chunks_done=0, cells_done=0, cells_settling=0,
        cells_computed=0, choice=None, replaced_by=None,
    )  # fmt: skip
    assert job.repairing is repairing
