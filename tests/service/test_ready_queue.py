"""The order in which chunks are computed, each after its predecessor."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.jobs.ready_queue import NONE, ReadyQueue
from service.jobs.run import predecessors
from worker.plan import make_plan
from worker.spec import SweepSpec


def ready_queue(predecessors: list[int], done: tuple[int, ...] = ()) -> ReadyQueue:
    mask = np.zeros(len(predecessors), np.bool_)
    mask[list(done)] = True
    return ReadyQueue(np.array(predecessors, np.int64), mask)


def drain(queue: ReadyQueue) -> list[int]:
    """Pop and complete one chunk at a time."""
    order = []
    while queue.ready:
        order.append(queue.pop())
        queue.complete(order[-1:])
    return order


def test_independent_chunks_come_in_their_order():
    assert drain(ready_queue([NONE] * 5)) == [0, 1, 2, 3, 4]


def test_a_chunk_waits_for_the_one_before_it():
    chain = ready_queue([NONE, 0, 1])
    assert chain.pop() == 0
    assert not chain.ready
    chain.complete([0])
    assert chain.pop() == 1


def test_chains_move_on_together():
    assert drain(ready_queue([NONE, NONE, 0, 1, 2, 3])) == [0, 1, 2, 3, 4, 5]


def test_a_done_chunk_is_not_popped_and_makes_its_successor_ready():
    assert drain(ready_queue([NONE, 0, 1, NONE], done=(0, 3))) == [1, 2]


def test_a_requeued_chunk_is_popped_again():
    two = ready_queue([NONE, NONE])
    two.requeue(two.pop())
    assert [two.pop(), two.pop()] == [1, 0]
    assert not two.ready
    assert not two.finished


def test_successors_of_an_invalidated_chunk_wait_for_it_again():
    chain = ready_queue([NONE, 0, 1, NONE], done=(0, 3))
    chain.invalidate([0, 3])
    assert sorted(drain(chain)) == [0, 1, 2, 3]
    assert chain.finished


def test_a_popped_chunk_is_not_popped_twice_when_its_predecessor_is_invalidated():
    chain = ready_queue([NONE, 0, 1], done=(0,))
    assert chain.pop() == 1
    chain.invalidate([0])
    assert chain.pop() == 0
    chain.complete([0])
    assert not chain.ready
    chain.complete([1])
    assert drain(chain) == [2]


def test_a_requeued_chunk_waits_for_an_invalidated_predecessor():
    chain = ready_queue([NONE, 0], done=(0,))
    assert chain.pop() == 1
    chain.invalidate([0])
    chain.requeue(1)
    assert drain(chain) == [0, 1]


def test_it_is_finished_when_all_are_done():
    assert ready_queue([NONE, 0], done=(0, 1)).finished
    assert not ready_queue([NONE, 0], done=(0, 1)).ready


def test_popping_from_an_empty_queue_is_an_error():
    with pytest.raises(IndexError):
        ready_queue([NONE], done=(0,)).pop()


@given(st.data())
def test_every_chunk_comes_once_and_after_its_predecessor(data: st.DataObject):
    size = data.draw(st.integers(1, 30))
    after = [data.draw(st.integers(NONE, index - 1)) for index in range(size)]
    done = data.draw(st.sets(st.integers(0, size - 1)))
    order = drain(ready_queue(after, tuple(done)))
    assert sorted(order) == [index for index in range(size) if index not in done]
    place = {index: position for position, index in enumerate(order)}
    assert all(
        after[index] in done or after[index] == NONE or place[after[index]] < place[index] for index in order
    )


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
    expected = [NONE if chunk.after is None else chunk.after for chunk in plan.chunks]
    assert predecessors(plan).tolist() == expected


def test_a_million_chunks_take_a_few_bytes_each():
    many = ReadyQueue(np.full(1_000_000, NONE), np.zeros(1_000_000, np.bool_))
    assert [many.pop() for _ in range(3)] == [0, 1, 2]
    held = sum(array.nbytes for array in vars(many).values() if isinstance(array, np.ndarray))
    assert held <= 34e6
