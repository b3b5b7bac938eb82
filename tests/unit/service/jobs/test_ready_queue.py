"""The order in which chunks are computed, each after its predecessor."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.jobs.ready_queue import ROTATION_SHARE, ReadyQueue, Rotation
from worker.sweep import SweepSpec
from worker.sweep.plan import make_plan


def drain(queue: ReadyQueue) -> list[int]:
    """Pop and complete one chunk at a time."""
    order = []
    while queue.ready:
        order.append(queue.pop())
        queue.complete(order[-1:])
    return order


@pytest.mark.parametrize("protocol", [
    {"kind": "rest"},
    {"kind": "ramp", "axis": "gamma", "direction": "up"},
    {"kind": "ramp", "axis": "omega", "direction": "both"},
    {"kind": "ramp", "axis": "xi", "direction": "down"},
])  # fmt: skip
def test_predecessors_are_those_of_the_plans_chunks(
    small_spec: Callable[..., SweepSpec], protocol: dict[str, str]
):
    plan = make_plan(small_spec(protocol=protocol), chunk_shape=(1, 2, 3))
    expected = [-1 if chunk.after is None else chunk.after for chunk in plan]
    assert [max(index - plan.lines, -1) for index in range(len(plan))] == expected


def test_a_million_chunks_take_a_few_bytes_each():
    many = ReadyQueue(1_000_000, np.zeros(1_000_000, np.bool_))
    assert [many.pop() for _ in range(3)] == [0, 1, 2]
    held = sum(array.nbytes for array in vars(many).values() if isinstance(array, np.ndarray))
    assert held <= 9e6


@given(st.data())
def test_every_chunk_comes_once_whatever_is_invalidated(data: st.DataObject):
    size = data.draw(st.integers(1, 12))
    lines = data.draw(st.integers(1, size))
    done = data.draw(st.sets(st.integers(0, size - 1)))
    queue, popped = ReadyQueue(lines, np.isin(np.arange(size), list(done))), list[int]()

    def may_run(index: int) -> bool:
        return index < lines or index - lines in done

    for _ in range(data.draw(st.integers(0, 40))):
        action = data.draw(st.sampled_from(["pop", "complete", "requeue", "first", "invalidate"]))
        if action == "invalidate":
            undone = data.draw(st.sets(st.integers(0, size - 1)))
            queue.invalidate(undone)
            done -= undone
        elif action == "pop":
            if queue.ready:
                popped.append(queue.pop())
                assert may_run(popped[-1])
        elif popped:
            chunk = popped.pop(data.draw(st.integers(0, len(popped) - 1)))
            if action == "complete":
                queue.complete([chunk])
                done.add(chunk)
            else:
                queue.requeue(chunk, first=action == "first")
        expected = {
            index for index in range(size)
            if index not in done and index not in popped and may_run(index)
        }  # fmt: skip
        assert queue.ready == len(expected)
        assert queue.remaining == size - len(done)
    for chunk in popped:
        queue.requeue(chunk)
    assert sorted(drain(queue)) == [index for index in range(size) if index not in done]


def test_a_chunk_that_paused_comes_before_all_others():
    queue = ReadyQueue(3, np.zeros(3, np.bool_))
    first = queue.pop()
    queue.requeue(queue.pop())
    queue.requeue(first, first=True)
    assert drain(queue) == [0, 2, 1]


# Rotation


def turns(rotation: Rotation, number: int) -> str:
    """The next jobs to have a turn."""
    taken = []
    for _ in range(number):
        taken.append(next(iter(rotation)))
        rotation.begin_turn(taken[-1], 0.0)
    return "".join(taken)


def rotation_of(jobs: str, owner: str = "") -> Rotation:
    rotation = Rotation(1.0)
    rotation.update(dict.fromkeys(jobs, owner))
    return rotation


def test_jobs_come_in_turn_and_new_ones_at_the_end():
    rotation = rotation_of("abc")
    assert turns(rotation, 4) == "abca"
    rotation.update(dict.fromkeys("abcd", ""))
    assert turns(rotation, 5) == "bcadb"


def test_jobs_that_have_ended_have_no_turn():
    rotation = rotation_of("abc")
    rotation.update(dict.fromkeys("ac", ""))
    assert turns(rotation, 3) == "aca"
    rotation.update({})
    assert list(rotation) == []


def test_owners_come_in_turn_however_many_jobs_they_have():
    rotation = rotation_of("abcdefgh", "one")
    rotation.update(dict.fromkeys("abcdefgh", "one") | dict.fromkeys("xy", "two"))
    assert turns(rotation, 6) == "axbycx"


@given(st.lists(st.sampled_from("abcdefghij"), min_size=1, unique=True), st.data())
def test_no_job_waits_for_more_turns_than_there_are_jobs(jobs: list[str], data: st.DataObject):
    """Whichever jobs follow and end: those that came later have at most one turn before it."""
    rotation, waiting = rotation_of("".join(jobs)), jobs[-1]
    ahead = len(jobs) - 1
    for number in range(100):
        new = data.draw(st.integers(0, 3))
        present = [*rotation, *(f"{number}-{k}" for k in range(new))]
        rotation.update(dict.fromkeys(present, ""))
        job = next(iter(rotation))
        if job == waiting:
            break
        rotation.begin_turn(job, 0.0)
    assert number <= ahead


def test_turns_take_their_share_of_the_time_and_no_more():
    """Chunks outside of the rotation take 0.3 s each, turns are estimated at 0.5 s and take 0.8 s."""
    rotation, outside, taken = rotation_of("ab"), 0.0, 0.0
    for _ in range(1000):
        if rotation.is_due(0.5):
            rotation.begin_turn("a", 0.5)
            rotation.end_turn(0.5, 0.8)
            taken += 0.8
        else:
            rotation.earn(0.3)
            outside += 0.3
    assert taken / (taken + outside) == pytest.approx(ROTATION_SHARE, rel=0.02)
