"""Plans of chunks, whatever the study."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from worker.study import Plan


@pytest.mark.parametrize("wrong", [(1, 0, 1), (1, 1)])
def test_impossible_chunks_are_refused(wrong):
    with pytest.raises(ValueError, match=r"^chunk_shape: must be "):
        Plan((1, 1, 10), wrong)


@given(st.lists(st.tuples(st.integers(1, 7), st.integers(1, 9)), min_size=1, max_size=4))
def test_chunks_of_other_grids_partition_them_in_order(axes: list[tuple[int, int]]):
    plan = Plan(tuple(n for n, _ in axes), tuple(size for _, size in axes))
    times = np.zeros(plan.grid, dtype=int)
    for chunk in plan:
        times[chunk.slices] += 1
        assert times[chunk.slices].shape == chunk.shape
    assert np.all(times == 1)
    assert plan.cells == times.size
    starts = [tuple(low for low, _ in chunk.spans) for chunk in plan]
    assert starts == sorted(starts)  # the last dimension is the fastest
    assert plan.lines == len(plan) == math.prod(plan.counts)
    layout = [
        tuple(low // size for low, size in zip(start, plan.chunk_shape, strict=True)) for start in starts
    ]
    assert [plan.number(*coords) for coords in layout] == list(range(len(plan)))
