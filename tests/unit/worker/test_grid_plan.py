"""The plan of studies other than sweeps: blocks partition the grid and are found by their place."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from worker.grid_plan import Block, GridPlan

grids = st.lists(st.tuples(st.integers(1, 7), st.integers(1, 9)), min_size=1, max_size=4).map(
    lambda axes: GridPlan(tuple(n for n, _ in axes), tuple(size for _, size in axes))
)


@given(grids)
def test_blocks_partition_the_grid_in_order(plan: GridPlan):
    times = np.zeros(plan.grid, dtype=int)
    blocks = list(plan)
    for block in blocks:
        times[block.slices] += 1
        assert times[block.slices].shape == block.shape
        assert block.cells == math.prod(block.shape)
    assert np.all(times == 1)
    assert plan.cells == times.size
    assert [block.index for block in blocks] == list(range(len(plan)))
    starts = [tuple(low for low, _ in block.spans) for block in blocks]
    assert starts == sorted(starts)  # the last dimension is the fastest
    assert plan.lines == len(plan) == math.prod(plan.counts)


def test_a_plan_is_a_sequence():
    plan = GridPlan((2, 3), (1, 2))
    assert plan[-1] == plan[3] == Block(3, ((1, 2), (2, 3)))
    assert plan[1:3] == [plan[1], plan[2]]
    for index in (4, -5):
        with pytest.raises(IndexError):
            plan[index]


@pytest.mark.parametrize("shape", [(1,), (1, 0), (-1, 2), (1, 1, 1)])
def test_impossible_blocks_are_refused(shape: tuple[int, ...]):
    with pytest.raises(ValueError, match=r"^chunk_shape: must be 2 sizes of at least 1, not "):
        GridPlan((2, 3), shape)
