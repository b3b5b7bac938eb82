"""What the supervisor decides, step by step: its thread is not started, and no chunk is computed."""

import threading
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NamedTuple

import pytest
from running import costing
from scripted import DEADLINE, Held, small, sweep
from tables import for_each

from service.errors import LedgerUnavailable
from service.jobs.ledger import Ledger
from service.jobs.manager import JobManager
from service.jobs.model import JobRecord, JobState
from service.jobs.supervisor import (
    MAX_IN_FLIGHT,
    PASSED_SECONDS,
    TURN_PRIORITY,
    ChunksInvalidated,
    Sync,
    _two_digits,
)
from service.settings import Settings
from worker import store
from worker.analysis.model_selection import ModelChoice
from worker.executors.base import ClusterState
from worker.executors.errors import ClusterLost
from worker.plan import Chunk
from worker.spec import SweepSpec
from worker.tasks import SLICE_SECONDS, ChunkPaused, ChunkReport, Terms

#: Between two syncs; a step that a test does not ask for would wait so long.
HEARTBEAT = 4 * DEADLINE


class Sent(NamedTuple):
    """A chunk as the executor got it."""

    name: str
    chunk: Chunk
    future: "Future[ChunkReport]"
    seconds: float
    priority: float
    terms: Terms


class Noting(Held):
    """Notes what it gets, and computes nothing."""

    def __init__(self, capacity: int = 2) -> None:
        super().__init__(capacity)
        self.connected, self.refused = True, tuple[str, ...]()
        self.sent: list[Sent] = []
        self.called: list[Future[Any]] = []

    def submit(
        self,
        spec: SweepSpec,
        chunk: Chunk,
        store_url: str,
        *,
        seconds: float = 0.0,
        priority: float = 0.0,
        terms: Terms | None = None,
        **_: Any,
    ) -> "Future[ChunkReport]":
        future: Future[ChunkReport] = Future()
        assert terms is not None
        self.sent.append(Sent(spec.name, chunk, future, seconds, priority, terms))
        return future

    def call(self, *_: Any) -> "Future[Any]":
        self.called.append(Future())
        return self.called[-1]

    def state(self) -> ClusterState:
        return ClusterState(self.connected, self.capacity, refused=self.refused)

    def names(self) -> list[str]:
        return [sent.name for sent in self.sent]

    def turns(self) -> list[str]:
        """The names of the jobs whose turns were sent."""
        return [sent.name for sent in self.sent if sent.priority == TURN_PRIORITY]

    def lose(self) -> None:
        """All chunks come back: the cluster is lost."""
        for sent in self.sent:
            if not sent.future.done():
                sent.future.set_exception(ClusterLost("gone"))


class Steps:
    """A job manager whose supervisor takes a step when the test says so."""

    def __init__(self, ledger: Ledger, manager: JobManager, settings: Settings) -> None:
        self.ledger, self.manager, self.settings = ledger, manager, settings
        self.supervisor = manager._supervisor

    def submit(self, spec: SweepSpec) -> JobRecord:
        return self.manager.submit(spec).job

    def job(self, job: JobRecord) -> JobRecord:
        current = self.ledger.find(job.id)
        assert current is not None
        return current

    def state(self, job: JobRecord) -> JobState:
        return self.job(job).state

    def sync(self) -> None:
        """A step with a sync, as at a heartbeat."""
        self.supervisor.wake()
        self.step()

    def step(self) -> None:
        """Take in what has arrived."""
        assert not self.supervisor._inbox.empty()
        self.supervisor._messages.extend(self.supervisor._receive())
        self.supervisor._step()

    def chunk_seconds(self, job: JobRecord) -> float:
        """Core-seconds of a chunk on average, by the cost table."""
        return self.manager.preparer.prepare(job).core_seconds / job.chunks_total


AUTO = small(name="auto", model={"kind": "auto", "tolerance": 0.5}, gamma=[2.0, 2.5], omega=0.5, xi=0.26)


@contextmanager
def stepping(folder: Path, executor: Noting, **options: Any) -> Iterator[Steps]:
    settings = Settings(data=folder, **{"heartbeat_seconds": HEARTBEAT, "window_seconds": 0, **options})
    with Ledger(settings.ledger_path) as ledger:
        yield Steps(ledger, JobManager(ledger, executor, settings), settings)


def of_cells(cells: int, **changes: Any) -> SweepSpec:
    """A sweep of so many cells, in eight chunks; its name is their number."""
    return sweep(str(cells), gamma={"start": 0.5, "stop": 1.2, "num": cells}, **changes)


def report(sent: Sent, seconds: float = 0.1) -> None:
    """The chunk comes back as if it were computed."""
    cells = sent.chunk.cells
    sent.future.set_result(ChunkReport(sent.chunk.index, cells, seconds, seconds, "00", (0, cells)))


# How much is in flight


@pytest.mark.parametrize(
    ("workers", "connected", "window", "chunks"),
    [(0, False, 2, 0), (0, True, 2, 2), (1, True, 2, 2), (3, True, 2, 6), (1, True, 1, 1)],
)
def test_each_worker_has_its_window_of_chunks_and_without_workers_one_would(
    tmp_path: Path, workers: int, connected: bool, window: int, chunks: int
):
    executor = Noting(workers)
    executor.connected = connected
    with stepping(tmp_path, executor, window=window) as steps:
        job = steps.submit(of_cells(100))
        steps.sync()
        assert len(executor.sent) == steps.manager.chunks_in_flight == chunks
        assert steps.manager.is_computing() is (chunks > 0)
        assert steps.state(job) is (JobState.RUNNING if chunks else JobState.QUEUED)


def test_of_short_chunks_there_are_as_many_as_make_the_windows_seconds(tmp_path: Path):
    executor = Noting(2)
    with stepping(tmp_path, executor, window=2, window_seconds=1e9) as steps:
        job = steps.submit(costing(chunks=200, seconds=0.75))
        steps.sync()
        assert len(executor.sent) == MAX_IN_FLIGHT
        seconds = steps.chunk_seconds(job)
    with stepping(tmp_path / "other", again := Noting(2), window=2, window_seconds=4.75 * seconds) as steps:
        steps.submit(costing(chunks=100, seconds=0.75))
        steps.sync()
        assert len(again.sent) == 10  # of two workers


def test_all_jobs_together_have_four_times_as_many_chunks(tmp_path: Path):
    """Each smaller job passes those before it, until there are too many at the executor."""
    executor = Noting(1)
    with stepping(tmp_path, executor, window=2) as steps:
        for cells in (800, 400, 200, 100, 48):
            steps.submit(of_cells(cells))
            steps.sync()
        assert executor.names() == ["800"] * 2 + ["400"] * 2 + ["200"] * 2 + ["100"] * 2


def test_a_job_whose_model_is_being_chosen_has_its_place(tmp_path: Path):
    executor = Noting()
    with stepping(tmp_path, executor, active_jobs=1) as steps:
        steps.submit(AUTO)
        steps.sync()
        steps.submit(of_cells(100))
        steps.sync()
        assert (len(executor.called), executor.names()) == (1, [])


def test_a_job_goes_on_as_soon_as_its_model_is_chosen(tmp_path: Path):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        job = steps.submit(AUTO)
        steps.sync()
        choice = ModelChoice(model="rigid", reason="because", tolerance=0.5, table=())
        executor.called[0].set_result(choice)
        steps.step()
        assert steps.state(job) is JobState.RUNNING
        assert set(executor.names()) == {"auto"}


def test_before_its_first_look_nothing_is_known_to_be_wrong_or_left(tmp_path: Path):
    with stepping(tmp_path, Noting(0)) as steps:
        steps.submit(of_cells(100))
        assert (steps.manager.cluster_fault, steps.manager.remaining_seconds) == (None, 0.0)
        steps.sync()
        assert steps.manager.cluster_fault is not None
        assert steps.manager.remaining_seconds > 0.0


def test_a_busy_job_keeps_its_place_and_an_idle_one_leaves_it_to_a_smaller_one(tmp_path: Path):
    executor = Noting(1)
    with stepping(tmp_path, executor, window=2, active_jobs=1) as steps:
        large = steps.submit(of_cells(400))
        steps.sync()
        small = steps.submit(of_cells(48))
        steps.sync()
        assert (set(executor.names()), steps.state(small)) == ({"400"}, JobState.QUEUED)
        executor.lose()
        steps.sync()
        assert steps.state(small) is JobState.RUNNING
        steps.step()  # which finds the other one waiting
        seconds = sum(job.chunks_total * steps.chunk_seconds(job) for job in (large, small))
        assert steps.manager.remaining_seconds == pytest.approx(seconds)


def test_an_idle_job_does_not_leave_its_place_to_one_with_as_much_left(tmp_path: Path):
    executor = Noting(1)
    with stepping(tmp_path, executor, window=2, active_jobs=1) as steps:
        earlier = steps.submit(of_cells(100, omega=0.6))
        steps.manager.cancel(earlier.id)
        job = steps.submit(of_cells(100))
        assert steps.chunk_seconds(job) == steps.chunk_seconds(earlier)
        steps.sync()
        executor.lose()
        steps.manager.resume(earlier.id)
        steps.sync()
        assert (steps.state(job), steps.state(earlier)) == (JobState.RUNNING, JobState.QUEUED)


def test_a_job_that_ends_leaves_its_place_to_the_next_at_once(tmp_path: Path):
    executor = Noting(4)
    with stepping(tmp_path, executor, window=2, active_jobs=1) as steps:
        first, second = steps.submit(of_cells(48)), steps.submit(of_cells(100))
        steps.sync()
        for sent in executor.sent:
            report(sent)
        steps.step()
        assert (steps.state(first), steps.state(second)) == (JobState.DONE, JobState.QUEUED)
        steps.step()
        assert steps.state(second) is JobState.RUNNING


def test_a_job_whose_chunks_are_all_marked_already_is_done(tmp_path: Path):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        job = steps.submit(of_cells(100))
        plan = steps.manager.preparer.prepare(job).plan
        reports = [ChunkReport(chunk.index, chunk.cells, 0.1, 0.1, "00", (0, 0)) for chunk in plan.chunks]
        with steps.ledger.writing() as ledger:
            ledger.run(job, 1.0)
            ledger.mark_done(job, reports)
        steps.sync()
        assert (steps.state(job), executor.sent) == (JobState.DONE, [])


def test_a_lost_cluster_is_told_and_the_next_look_is_soon(tmp_path: Path):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        steps.sync()
        assert steps.manager.cluster_fault is None
        assert HEARTBEAT / 2 < steps.supervisor._next_sync - time.monotonic() <= HEARTBEAT
        executor.capacity = 0
        steps.sync()
        assert steps.manager.cluster_fault == "no workers yet; jobs wait until there are"
        assert 0.0 < steps.supervisor._next_sync - time.monotonic() <= HEARTBEAT / 4
        assert steps.manager.notices() == []
        executor.refused = ("worker a: it is another",)
        steps.sync()
        assert steps.manager.notices()[0] == "workers refused: 1; the log names them"


def test_a_job_at_the_address_of_a_deleted_one_waits_until_its_results_are_removed(tmp_path: Path):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        job = steps.submit(of_cells(100))
        steps.manager.cancel(job.id)
        steps.manager.delete(job.id)
        job = steps.submit(of_cells(100))
        steps.sync()
        assert (steps.state(job), executor.sent) == (JobState.QUEUED, [])
        assert steps.manager._deleter._carry_out_all()
        steps.step()
        assert (steps.state(job), len(executor.sent) > 0) == (JobState.RUNNING, True)


# What a chunk is sent with


@pytest.mark.parametrize(("workers", "slice_seconds"), [(2, SLICE_SECONDS), (8, 2 * SLICE_SECONDS)])
def test_with_many_workers_chunks_pause_less_often(tmp_path: Path, workers: int, slice_seconds: float):
    executor = Noting(workers)
    with stepping(tmp_path, executor) as steps:
        steps.submit(of_cells(100))
        steps.sync()
        assert {sent.terms for sent in executor.sent} == {Terms(slice_seconds, begins=True)}


def test_a_chunk_that_paused_is_sent_first_and_does_not_begin(tmp_path: Path):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        steps.submit(of_cells(100))
        steps.sync()
        executor.sent[1].future.set_exception(ChunkPaused("paused"))
        steps.step()
        assert [sent.chunk.index for sent in executor.sent] == [0, 1, 2, 3, 1]
        assert not executor.sent[-1].terms.begins


def test_the_time_limit_is_of_the_settings_or_of_the_chunks_longest_time(tmp_path: Path):
    spec = of_cells(100, settle_until=100_000)
    for limit in (1e-9, 1e6):
        folder, executor = tmp_path / f"{limit}", Noting()
        with stepping(folder, executor, chunk_seconds=limit, chunk_slack=3.0) as steps:
            job = steps.submit(spec)
            steps.sync()
            longest = steps.manager.preparer.prepare(job).longest_cell_seconds
            cells = executor.sent[0].chunk.cells
            assert executor.sent[0].seconds == pytest.approx(max(limit, 3.0 * cells * longest))


@pytest.mark.parametrize("settle", [1500, 5_000_000])
def test_a_chunk_is_passed_for_ten_seconds_or_less_if_its_job_is_short(tmp_path: Path, settle: int):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        job = steps.submit(of_cells(100, settle=settle))
        seconds = steps.manager.preparer.prepare(job).core_seconds
        assert (seconds < 1.0) == (settle == 1500)
        waits = PASSED_SECONDS * min(seconds, 1.0)
        before = time.monotonic()
        steps.sync()
        assert before + waits <= -executor.sent[0].priority <= time.monotonic() + waits + 1e-6


# Turns


@pytest.mark.parametrize(("workers", "jobs", "turns"), [(1, 2, 1), (3, 2, 1), (8, 2, 4), (8, 1, 0)])
def test_turns_take_half_of_the_workers_at_most(tmp_path: Path, workers: int, jobs: int, turns: int):
    executor = Noting(workers)
    with stepping(tmp_path, executor, window=2) as steps:
        for number in range(jobs):
            steps.submit(costing(chunks=40, seconds=0.75, omega=0.5 + number / 10))
        steps.sync()
        assert not [sent for sent in executor.sent if sent.priority == TURN_PRIORITY]
        for _ in range(4):
            steps.supervisor._rotation.earn(1e6)
            steps.sync()
        assert len(executor.turns()) == turns


@pytest.mark.parametrize(
    ("earned", "active_jobs", "turns"), [(0.99, 2, []), (1.01, 2, ["800"]), (1.01, 1, [])]
)
def test_a_turn_of_a_job_that_waits_is_taken_when_it_is_earned_and_there_is_room(
    tmp_path: Path, earned: float, active_jobs: int, turns: list[str]
):
    executor = Noting(1)
    with stepping(tmp_path, executor, window=2, active_jobs=active_jobs) as steps:
        job = steps.submit(of_cells(800))
        steps.submit(of_cells(400))
        steps.sync()
        assert executor.names() == ["400"] * 2
        steps.supervisor._rotation.earn(3 * earned * steps.chunk_seconds(job))  # turns get a third
        steps.sync()
        assert executor.turns() == turns
        assert steps.state(job) is (JobState.RUNNING if turns else JobState.QUEUED)


def test_an_idle_job_leaves_its_place_to_one_whose_turn_it_is(tmp_path: Path):
    executor = Noting(1)
    with stepping(tmp_path, executor, window=2, active_jobs=1) as steps:
        jobs = [steps.submit(of_cells(cells)) for cells in (800, 400)]
        steps.sync()
        for sent in executor.sent:
            report(sent)
        steps.supervisor._rotation.earn(1e6)
        steps.step()
        assert executor.turns() == ["800"]
        assert [steps.job(job).chunks_done for job in jobs] == [0, 2]


@pytest.mark.parametrize(
    "first",
    [of_cells(100, protocol={"kind": "ramp", "axis": "gamma", "direction": "up"}), AUTO],
    ids=["no chunk is ready", "its model is being chosen"],
)
def test_a_job_that_cannot_take_its_turn_leaves_it_to_the_next(tmp_path: Path, first: SweepSpec):
    executor = Noting(8)
    with stepping(tmp_path, executor, window=1) as steps:
        steps.submit(first)
        steps.submit(costing("other", chunks=40, seconds=0.75, omega=0.7))
        steps.sync()
        for _ in range(4):
            steps.supervisor._rotation.earn(1e6)
            steps.sync()
        assert executor.turns() == ["other"] * 4
        assert not any(sent.future.cancelled() for sent in executor.sent)


def test_without_a_cluster_no_turn_is_taken_either(tmp_path: Path):
    executor = Noting()
    executor.connected = False
    with stepping(tmp_path, executor) as steps:
        for omega in (0.5, 0.6):
            steps.submit(of_cells(100, omega=omega))
        steps.supervisor._rotation.earn(1e6)
        steps.sync()
        assert executor.sent == []


@pytest.mark.parametrize(
    ("taken", "earned"), [(0.6, 0.2), (100.0, SLICE_SECONDS / 3)], ids=["short", "longer than a slice"]
)
def test_a_chunk_earns_turns_by_what_it_took(tmp_path: Path, taken: float, earned: float):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        steps.submit(of_cells(400))
        steps.sync()
        report(executor.sent[0], taken)
        steps.step()
        assert steps.supervisor._rotation.is_due(0.99 * earned)
        assert not steps.supervisor._rotation.is_due(1.01 * earned)
        assert (steps.manager.tally.computed, steps.manager.tally.seconds) == (1, taken)


@pytest.mark.parametrize("error", [ChunkPaused("paused"), ValueError("no")], ids=["paused", "failed"])
def test_a_chunk_that_paused_took_a_slice_and_one_that_failed_its_estimate(tmp_path: Path, error: Exception):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        job = steps.submit(of_cells(400))
        steps.sync()
        executor.sent[0].future.set_exception(error)
        steps.step()
        taken = SLICE_SECONDS if isinstance(error, ChunkPaused) else steps.chunk_seconds(job)
        assert steps.supervisor._rotation.is_due(0.99 * taken / 3)
        assert not steps.supervisor._rotation.is_due(1.01 * taken / 3)


def test_a_turn_that_took_less_leaves_its_time_to_others(tmp_path: Path):
    executor = Noting(1)
    with stepping(tmp_path, executor) as steps:
        jobs = [steps.submit(of_cells(400, omega=omega)) for omega in (0.5, 0.6)]
        steps.sync()
        rotation = steps.supervisor._rotation
        rotation.earn(1e6)
        steps.sync()
        [turn] = [sent for sent in executor.sent if sent.priority == TURN_PRIORITY]
        left = SLICE_SECONDS - steps.chunk_seconds(jobs[0])
        assert rotation.is_due(left * 0.999)
        assert not rotation.is_due(left + steps.chunk_seconds(jobs[0]) / 2)
        assert turn.chunk.index in next(iter(steps.supervisor._runs.values())).turns
        chunk = steps.chunk_seconds(jobs[0])
        report(turn, chunk / 2)
        steps.step()
        assert len(executor.turns()) == 2  # the next one has begun
        assert rotation.is_due(left - 0.6 * chunk)
        assert not rotation.is_due(left - 0.4 * chunk)


# What it asks for


@for_each(
    ("value", "rounded"),
    [(0.0, 0.0), (-1.0, 0.0), (1234.0, 1300.0), (1200.0, 1200.0), (7.0, 7.0), (0.0123, 0.013), (99.1, 100.0)],
)
def test_numbers_are_told_in_two_digits_rounded_up(value: float, rounded: float):
    assert _two_digits(value) == pytest.approx(rounded)


def test_it_tells_the_executor_what_is_left_and_how_many_chunks_could_run(tmp_path: Path):
    executor = Noting(1)
    with stepping(tmp_path, executor, active_jobs=1) as steps:
        first, other = steps.submit(of_cells(200)), steps.submit(of_cells(400))
        seconds = steps.chunk_seconds(first)
        others = other.chunks_total * steps.chunk_seconds(other)
        steps.sync()  # both are waiting
        assert executor.asked == (_two_digits(first.chunks_total * seconds + others), 2)
        for sent in executor.sent[:2]:
            report(sent)
        steps.sync()
        left = (first.chunks_total - 2) * seconds + others
        assert executor.asked == (_two_digits(left), _two_digits(first.chunks_total - 2 + 1))
        assert steps.manager.remaining_seconds == pytest.approx(left)
        steps.manager.cancel(first.id)
        steps.sync()
        assert executor.asked[1] == 2 + 1  # what is in flight, and the other job


# Cancelling


def test_without_workers_the_chunks_of_a_stopped_job_are_taken_back(tmp_path: Path):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        stopped = steps.submit(of_cells(100))
        steps.sync()
        other = steps.submit(of_cells(48))
        steps.sync()
        steps.manager.cancel(stopped.id)
        steps.sync()
        assert not any(sent.future.cancelled() for sent in executor.sent)  # workers may be computing them
        executor.connected, executor.capacity = False, 0
        steps.sync()
        assert not any(sent.future.cancelled() for sent in executor.sent)
        executor.connected = True
        steps.sync()
        assert {sent.name for sent in executor.sent if sent.future.cancelled()} == {"100"}
        steps.step()
        assert steps.state(stopped) is JobState.CANCELLED
        assert steps.state(other) is JobState.RUNNING


def test_a_cancel_flag_that_cannot_be_set_is_set_at_the_next_sync(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        job = steps.submit(of_cells(100))
        steps.sync()
        url = steps.settings.store_of(job.id)
        steps.manager.cancel(job.id)
        with monkeypatch.context() as patched:
            patched.setattr(store, "set_cancelled", Refusing(PermissionError("no")))
            steps.sync()
        sent = len(executor.sent)
        report(executor.sent[0])
        steps.step()
        assert not store.is_cancelled(url)
        assert (steps.state(job), steps.job(job).chunks_done) == (JobState.RUNNING, 1)
        assert len(executor.sent) == sent  # the job sends no more, flag or not
        steps.sync()
        assert store.is_cancelled(url)


def test_what_killed_workers_left_is_removed_as_a_job_ends_and_as_it_begins_again(tmp_path: Path):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        job = steps.submit(of_cells(100))
        steps.sync()
        partial = Path(steps.settings.store_of(job.id), ".partial", "0123456789abcdef.partial")
        partial.write_bytes(b"half")
        steps.manager.cancel(job.id)
        for sent in executor.sent:
            sent.future.set_exception(CancelledError())
        steps.sync()
        assert steps.state(job) is JobState.CANCELLED
        assert not partial.exists()
        partial.write_bytes(b"half")
        steps.manager.resume(job.id)
        steps.sync()
        assert steps.state(job) is JobState.RUNNING
        assert not partial.exists()


# What goes wrong


class Refusing:
    """A function that raises an error, whatever it is given."""

    def __init__(self, error: Exception) -> None:
        self.error, self.calls = error, 0

    def __call__(self, *_: Any) -> None:
        self.calls += 1
        raise self.error


def test_a_bucket_that_does_not_answer_is_asked_once_at_each_sync(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    executor, create = Noting(), Refusing(store.UNREACHABLE[0]("no answer"))
    with stepping(tmp_path, executor) as steps:
        jobs = [steps.submit(of_cells(cells)) for cells in (100, 200, 400)]
        with monkeypatch.context() as patched:
            patched.setattr(store, "create", create)
            steps.sync()
            assert create.calls == 1
            steps.sync()
            assert create.calls == 2
        assert {steps.state(job) for job in jobs} == {JobState.QUEUED}
        steps.sync()
        assert steps.state(jobs[0]) is JobState.RUNNING


def test_a_lost_cluster_gets_nothing_until_the_next_sync(tmp_path: Path):
    executor = Noting(1)
    with stepping(tmp_path, executor, window=2) as steps:
        steps.submit(of_cells(100))
        steps.sync()
        executor.lose()
        steps.step()
        assert len(executor.sent) == 2
        steps.sync()
        assert len(executor.sent) == 4


def test_a_job_that_cannot_be_prepared_fails_at_once_though_there_is_enough_to_compute(tmp_path: Path):
    with stepping(tmp_path, Noting()) as steps:
        first, other = steps.submit(of_cells(100)), steps.submit(of_cells(400))
        with steps.ledger.writing() as ledger:
            ledger._sql.execute("UPDATE jobs SET spec = '{}' WHERE seq = ?", [other.seq])
    with stepping(tmp_path, executor := Noting()) as steps:
        steps.sync()
        assert (steps.state(first), steps.state(other)) == (JobState.RUNNING, JobState.FAILED)
        assert str(steps.job(other).error).startswith("the job cannot start: SpecInvalid: ")
        assert set(executor.names()) == {"100"}


@pytest.mark.parametrize("error", [None, ValueError("no")], ids=["made", "not made"])
@pytest.mark.parametrize("change", ["cancelled", "deleted", "accepted again"])
def test_a_job_that_ends_while_its_store_is_made_stays_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: str, error: Exception | None
):
    real, executor = store.create, Noting()

    def create(*given: Any) -> None:
        real(*given)
        steps.manager.cancel(job.id)
        if change != "cancelled":
            steps.manager.delete(job.id)
        if change == "accepted again":
            steps.submit(of_cells(100))
        if error is not None:
            raise error

    monkeypatch.setattr(store, "create", create)
    with stepping(tmp_path, executor) as steps:
        job = steps.submit(of_cells(100))
        steps.sync()
        assert executor.sent == []
        found = steps.ledger.find(job.id)
        left = None if found is None else (found.state, found.error)
        states = {"cancelled": JobState.CANCELLED, "accepted again": JobState.QUEUED}
        assert left == (None if change == "deleted" else (states[change], None))


def test_no_run_begins_while_anybody_has_chunks_of_the_job_computed_again(tmp_path: Path):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        job = steps.submit(of_cells(100))
        with steps.supervisor.invalidating(job.id):
            with steps.supervisor.invalidating(job.id):
                pass
            steps.sync()
            assert (steps.state(job), executor.sent) == (JobState.QUEUED, [])
        steps.step()
        assert steps.state(job) is JobState.RUNNING


def test_a_job_whose_run_breaks_is_made_anew_and_fails_the_third_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        job, other = steps.submit(of_cells(100)), steps.submit(of_cells(400))
        monkeypatch.setattr(store, "sync_folders", Refusing(KeyError("a field")))
        for _ in range(3):
            assert steps.state(job) is not JobState.FAILED
            del executor.sent[:]
            steps.sync()
            first, *others = [sent for sent in executor.sent if sent.name == "100"]
            report(first)
            steps.step()
            assert others
            assert all(sent.future.cancelled() for sent in others)
        assert steps.state(job) is JobState.FAILED
        assert steps.job(job).error == "internal error: KeyError: 'a field'"
        assert steps.state(other) is not JobState.FAILED


def test_a_step_that_the_ledger_refuses_keeps_what_came_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    executor = Noting()
    with stepping(tmp_path, executor) as steps:
        job = steps.submit(of_cells(100))
        steps.sync()
        report(executor.sent[0])
        with monkeypatch.context() as patched:
            patched.setattr(steps.ledger, "writing", Refusing(LedgerUnavailable("locked")))
            with pytest.raises(LedgerUnavailable):
                steps.step()
        assert steps.job(job).chunks_done == 0
        steps.sync()
        assert steps.job(job).chunks_done == 1
        assert steps.state(job) is JobState.RUNNING


def test_a_job_that_is_resumed_may_break_as_often_as_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    executor = Noting()

    def break_run() -> None:
        with monkeypatch.context() as patched:
            patched.setattr(store, "sync_folders", Refusing(KeyError("a field")))
            del executor.sent[:]
            steps.sync()
            report(executor.sent[0])
            steps.step()
        assert steps.job(job).chunks_done == 0

    with stepping(tmp_path, executor) as steps:
        job = steps.submit(of_cells(100))
        break_run()
        break_run()
        steps.manager.cancel(job.id)
        steps.sync()
        assert steps.state(job) is JobState.CANCELLED
        steps.manager.resume(job.id)
        break_run()
        assert steps.state(job) is JobState.RUNNING


class Waits(threading.Event):
    """Notes how long it is waited for, and does not wait."""

    def __init__(self) -> None:
        super().__init__()
        self.noted: list[float | None] = []

    def wait(self, timeout: float | None = None) -> bool:
        self.noted.append(timeout)
        return False


@pytest.mark.parametrize("error", [LedgerUnavailable("locked"), KeyError("a field")])
def test_a_step_that_fails_is_tried_again_after_a_heartbeat(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
):
    """Nothing is begun before the ledger is found to be the one it was."""
    executor, tries = Noting(), 0

    def check() -> None:
        nonlocal tries
        tries += 1
        if tries == 3:
            stop.set()
        raise error

    def state() -> ClusterState:
        stop.set()
        return ClusterState(False, 0)

    with stepping(tmp_path, executor) as steps:
        steps.supervisor._stop = stop = Waits()
        monkeypatch.setattr(steps.ledger, "check", check)
        monkeypatch.setattr(executor, "state", state)
        steps.supervisor._work()
    assert stop.noted == [HEARTBEAT] * 3


class Inbox(SimpleQueue[Any]):
    """Notes how long it is waited for, and does not wait."""

    def __init__(self) -> None:
        self.noted: list[float | None] = []

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        self.noted.append(timeout)
        return super().get(block=False)


def test_a_sync_that_is_due_is_not_waited_for(tmp_path: Path):
    with stepping(tmp_path, Noting()) as steps:
        supervisor, inbox = steps.supervisor, Inbox()
        supervisor._inbox = inbox
        for due in (-5.0, 5.0):
            supervisor._next_sync = time.monotonic() + due
            assert supervisor._receive() == [Sync()]
        late, early = inbox.noted
        assert late == 0.0
        assert early is not None
        assert 0.0 < early <= 5.0


def test_a_message_that_comes_as_a_sync_is_due_is_taken_in_with_it(tmp_path: Path):
    with stepping(tmp_path, Noting()) as steps:
        supervisor, message = steps.supervisor, ChunksInvalidated("a" * 32, [0])
        for due, received in ((5.0, [message, message]), (-5.0, [message, message, Sync()])):
            supervisor._next_sync = time.monotonic() + due
            for _ in range(2):
                supervisor._inbox.put(message)
            assert supervisor._receive() == received


def test_stopping_waits_for_the_step_under_way(tmp_path: Path):
    class Slow(Noting):
        ended = False

        def state(self) -> ClusterState:
            begun.set()
            assert steps.supervisor._stop.wait(DEADLINE)
            threading.Event().wait(0.1)
            self.ended = True
            return super().state()

    begun, executor = threading.Event(), Slow()
    with stepping(tmp_path, executor) as steps:
        steps.supervisor.start()
        assert begun.wait(DEADLINE)
        steps.manager.stop()
        assert executor.ended


def test_what_was_not_started_can_be_stopped(tmp_path: Path):
    """As by a service that fails to start."""
    with stepping(tmp_path, Noting()) as steps:
        steps.manager.stop()


def test_a_sync_makes_good_what_the_ledgers_reserve_has_lost(tmp_path: Path):
    with stepping(tmp_path, Noting()) as steps:
        pages = steps.ledger._number("PRAGMA freelist_count")
        assert pages > 0
        with steps.ledger.writing() as ledger:
            ledger._sql.execute("CREATE TABLE used AS SELECT zeroblob(200000)")
        assert steps.ledger._number("PRAGMA freelist_count") < pages
        steps.sync()
        assert steps.ledger._number("PRAGMA freelist_count") >= pages
