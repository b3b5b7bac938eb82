"""One running job: what it submits, counts, saves, and how it ends."""

import math
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest
from ledgers import record
from scripted import small

from service.jobs.prepare import JobPreparer
from service.jobs.retry import Action, History, RetryPolicy
from service.jobs.run import BUCKET_SECONDS, ChunkCounts, JobRun
from service.ledger.model import JobState, summary_of
from service.settings import Settings
from worker.study import ChunkReport
from worker.sweep.plan import make_plan

RAMP = {"kind": "ramp", "axis": "gamma", "direction": "up"}
POLICY = RetryPolicy(chunk_tries=2, failed_chunks=2)


@pytest.fixture
def run(tmp_path: Path) -> JobRun:
    """A ramp of 60 cells: six lines along gamma, each in two chunks of five cells."""
    spec = small(protocol=RAMP)
    plan = make_plan(spec, chunk_shape=(1, 1, 5))
    job = record(
        spec, chunk_shape=plan.chunk_shape, chunks_total=len(plan), state=JobState.RUNNING, started=0.0,
        run_started=0.0,
    )  # fmt: skip
    prepared = JobPreparer(Settings(data=tmp_path)).prepare(job)
    return JobRun(job, prepared, np.zeros(len(plan), np.bool_), POLICY)


def submit(run: JobRun) -> int:
    chunk = run.prepared.plan[run.queue.pop()]
    run.add_in_flight(chunk.index, Future())
    return chunk.index


def finish(run: JobRun, chunk: int) -> None:
    run.remove_in_flight(chunk)
    run.unsaved_reports.append(ChunkReport(chunk, 5, 0.1, 0.1, "sum", (5, 0, 0, 0, 0, 0, 0)))
    run.mark_saved()


def fail(run: JobRun, chunk: int, action: Action, error: Exception) -> None:
    run.remove_in_flight(chunk)
    run.apply(chunk, action, error)


def test_it_ends_when_every_chunk_is_done_and_saved(run: JobRun):
    while run.may_submit:
        assert run.final_state is None
        finish(run, submit(run))
    assert run.final_state is JobState.DONE


def test_nothing_is_submitted_while_something_is_unsaved(run: JobRun):
    chunk = submit(run)
    run.remove_in_flight(chunk)
    run.unsaved_reports.append(ChunkReport(chunk, 5, 0.1, 0.1, "sum", (5, 0, 0, 0, 0, 0, 0)))
    assert run.has_unsaved
    assert not run.may_submit
    run.mark_saved()
    assert run.may_submit


def test_what_is_left_follows_the_time_of_paused_slices(run: JobRun):
    chunk, estimated = submit(run), run.remaining_seconds
    run.remove_in_flight(chunk)
    run.add_slice(100.0)
    assert run.remaining_seconds == 100.0 * run.queue.remaining > 10.0 * estimated
    run.queue.requeue(chunk, first=True)
    finish(run, submit(run))
    assert run.remaining_seconds == 50.0 * run.queue.remaining  # of two chunks one may have taken it all


def test_a_chunk_begins_once_unless_it_has_a_checkpoint(run: JobRun):
    paused = JobRun(run.job, run.prepared, np.zeros(12, np.bool_), POLICY, paused=[0])
    assert paused.begun == {0}
    chunk = submit(run)
    assert chunk in run.begun
    fail(run, chunk, Action.CONTINUE, ValueError("paused"))
    assert chunk in run.begun
    finish(run, submit(run))
    assert chunk not in run.begun  # once stored it has no checkpoint


def test_tries_and_losses_are_counted_per_chunk(run: JobRun):
    chunk = submit(run)
    fail(run, chunk, Action.RETRY, ValueError("no"))
    fail(run, submit_again(run, chunk), Action.COLLATERAL, ValueError("no"))
    fail(run, submit_again(run, chunk), Action.REQUEUE, ValueError("no"))
    assert run.history(chunk) == History(tries=1, collateral_losses=1)
    assert run.history(chunk + 1) == History()
    assert run.history(6) == History(has_predecessor=True)


def submit_again(run: JobRun, chunk: int) -> int:
    """Submit chunks until this one comes up; the others are requeued."""
    while (index := submit(run)) != chunk:
        fail(run, index, Action.REQUEUE, ValueError("no"))
    return index


def test_a_job_with_too_many_failures_ends_as_failed_with_the_first(run: JobRun):
    for _ in range(2):
        chunk = submit(run)
        fail(run, chunk, Action.GIVE_UP, ValueError("the spring broke"))
    assert run.final_state is None  # the failures are to be saved first
    assert [failure.chunk for failure in run.unsaved_failures] == [0, 1]
    run.mark_saved()
    assert run.final_state is JobState.FAILED
    where = "chunk 0 (up, gamma 0.5 to 2.5, omega 0.5, xi 0.05)"
    assert summary_of(run.failures) == f"{where}: ValueError: the spring broke (and 1 more chunk failed)"


def test_a_fatal_error_stops_the_job_at_once(run: JobRun):
    fail(run, submit(run), Action.FATAL, OSError("disk full"))
    run.mark_saved()
    assert not run.may_submit
    assert run.history(3).fatal
    assert run.final_state is JobState.FAILED


def test_a_damaged_predecessor_is_unmarked_and_computed_before_its_successor(run: JobRun):
    for _ in range(6):
        finish(run, submit(run))
    chunk = submit(run)
    run.remove_in_flight(chunk)
    run.apply(chunk, Action.RETRY, ValueError("damaged"), recompute_predecessor=True)
    assert run.unsaved_damage == {chunk - 6}
    assert run.has_unsaved
    assert not run.may_submit
    run.mark_saved()
    run.queue.invalidate([chunk - 6])
    order = []
    while run.may_submit:
        order.append(submit(run))
        finish(run, order[-1])
    assert order.index(chunk - 6) < order.index(chunk)
    assert run.final_state is JobState.DONE


def test_a_job_that_is_cancelled_ends_when_nothing_is_in_flight(run: JobRun):
    chunk = submit(run)
    run.stopping = True
    assert not run.may_submit
    assert run.final_state is None
    fail(run, chunk, Action.REQUEUE, ValueError("cancelled"))
    assert run.final_state is JobState.CANCELLED


def test_chunks_are_counted_by_what_they_took_and_by_how_they_came_back():
    tally = ChunkCounts()
    for seconds in (0.005, 0.01, 0.011, 1.0, 299.0, 301.0):
        tally.add_computed(seconds)
    assert tally.computed == 6
    assert tally.seconds == pytest.approx(601.026)
    counts = [2, 3, 3, 3, 4, 4, 4, 4, 4, 5, 6]
    assert tally.by_seconds == list(zip((*BUCKET_SECONDS, math.inf), counts, strict=True))
