"""Which job submits the next chunk, whatever jobs and places there are."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.jobs.run import ReadyQueue
from service.jobs.schedule import (
    MAX_IN_FLIGHT,
    MAX_TIMES_IN_FLIGHT,
    Job,
    Rotation,
    Schedule,
    Waiting,
)

WINDOW, ACTIVE, SLICE = 4, 3, 1.5


@dataclass
class Active:
    """A job in memory."""

    id: str
    seq: int
    chunk_seconds: float
    chunks: int  # neither done nor in flight
    in_flight: list[int] = field(default_factory=list)
    turns: list[int] = field(default_factory=list)

    @property
    def remaining_seconds(self) -> float:
        return self.chunk_seconds * (self.chunks + len(self.in_flight))

    @property
    def may_submit(self) -> bool:
        return self.chunks > 0

    @property
    def is_idle(self) -> bool:
        return not self.in_flight


class Cluster:
    """Jobs that follow a schedule on an executor that computes them in the order they came."""

    def __init__(self, workers: int, window_seconds: float) -> None:
        self.schedule = Schedule(WINDOW, window_seconds, ACTIVE, SLICE)
        self.schedule.slots = WINDOW * workers
        self.jobs: dict[str, Active] = {}  # all unfinished ones
        self.active: dict[str, Active] = {}
        self.queue: deque[tuple[Active, float | None]] = deque()  # chunks in flight; the estimates of turns

    def sync(self) -> None:
        waiting = [
            Waiting(job.id, job.seq, job.chunk_seconds, job.remaining_seconds)
            for job in self.jobs.values()
            if job.id not in self.active
        ]
        self.schedule.update(waiting, dict.fromkeys(self.jobs, None))

    def submit(self) -> list[tuple[Job, bool]]:
        """The jobs that have submitted a chunk, and whether in turn."""
        submitted = []
        while (due := self.schedule.next(self.active)) is not None:
            job = self.jobs[due.job.id]
            if not due.is_turn:  # nobody smaller could have had the place
                assert all(job.remaining_seconds <= other.remaining_seconds for other in self.able(job))
            if due.leaving is not None:
                assert due.leaving.is_idle
                del self.active[due.leaving.id]
            if self.schedule.waiting.pop(job.id, None):
                self.active[job.id] = job
            assert len(self.active) <= ACTIVE
            job.chunks -= 1
            job.in_flight.append(job.chunks)
            if due.is_turn:
                job.turns.append(job.chunks)
                self.schedule.rotation.begin_turn(job.id, job.chunk_seconds)
            self.queue.append((job, job.chunk_seconds if due.is_turn else None))
            submitted.append((job, due.is_turn))
        return submitted

    def able(self, placed: Active) -> list[Active]:
        """Jobs that could submit a chunk instead of one that has or gets a place."""
        room = len(self.active) < ACTIVE or placed.id not in self.active
        waiting = [self.jobs[job_id] for job_id in self.schedule.waiting] if room else []
        return [job for job in [*self.active.values(), *waiting] if job.may_submit]

    def compute(self) -> None:
        """One chunk comes back."""
        job, turn = self.queue.popleft()
        self.schedule.rotation.count(job.chunk_seconds, turn)
        chunk = job.turns.pop(0) if turn is not None else next(c for c in job.in_flight if c not in job.turns)
        job.in_flight.remove(chunk)
        if not job.chunks and not job.in_flight:
            del self.active[job.id], self.jobs[job.id]


JOBS = st.lists(
    st.tuples(st.floats(0.001, 30.0), st.integers(1, 60)), min_size=1, max_size=8
)  # seconds of a chunk, chunks


@settings(deadline=None)
@given(JOBS, st.integers(1, 3), st.sampled_from([0.0, 2.0]), st.data())
def test_every_job_is_done_the_smallest_first_and_no_limit_is_passed(
    jobs: list[tuple[float, int]], workers: int, window_seconds: float, data: st.DataObject
):
    cluster = Cluster(workers, window_seconds)
    for seq, (seconds, chunks) in enumerate(jobs):
        cluster.jobs[str(seq)] = Active(str(seq), seq, seconds, chunks)
        if data.draw(st.booleans()):
            cluster.sync()
            cluster.submit()
    most = MAX_TIMES_IN_FLIGHT * max(cluster.schedule.slots, MAX_IN_FLIGHT)
    for _ in range(3 * sum(chunks for _, chunks in jobs) + 10):
        cluster.sync()
        cluster.submit()
        turns = sum(len(job.turns) for job in cluster.active.values())
        assert turns <= max(workers // 2, 1)
        assert len(cluster.queue) <= most + turns
        if not cluster.jobs:
            return
        cluster.compute()
    raise AssertionError(f"not done: {cluster.jobs}")


# Rotation


def test_owners_come_in_turn_however_many_jobs_they_have():
    rotation, taken = Rotation(1.0), ""
    owners = dict.fromkeys("abcdefgh", "one")
    rotation.update(owners)
    rotation.update(owners | dict.fromkeys("xy", "two"))
    for _ in range(6):
        taken += next(iter(rotation))
        rotation.begin_turn(taken[-1], 0.0)
    assert taken == "axbycx"


def test_turns_take_their_share_of_the_time_and_no_more():
    """Chunks outside of the rotation take 0.3 s each, turns are estimated at 0.5 s and take 0.8 s."""
    rotation, outside, taken = Rotation(1.0), 0.0, 0.0
    rotation.update({"a": "", "b": ""})
    for _ in range(1000):
        if rotation.is_due(0.5):
            rotation.begin_turn("a", 0.5)
            rotation.count(0.8, turn=0.5)
            taken += 0.8
        else:
            rotation.count(0.3, turn=None)
            outside += 0.3
    assert taken / (taken + outside) == pytest.approx(0.25, rel=0.02)


def test_chunks_are_scattered_over_the_map():
    queue = ReadyQueue(10, np.zeros(10, np.bool_))
    order = [queue.pop() for _ in range(10)]
    assert order == [0, 8, 4, 2, 6, 1, 9, 5, 3, 7]
