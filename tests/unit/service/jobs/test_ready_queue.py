"""The order in which chunks are computed, each after its predecessor."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.jobs.ready_queue import ReadyQueue
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
