"""Layouts of stores: shards, whatever the study."""

from dataclasses import replace

import numpy as np
from tables import for_each

from worker.study import Array, Layout


@for_each(
    ("sizes", "inner", "alike"),
    [
        ({"x": 2**16}, None, None),  # 512 kiB
        ({"x": 2**16 + 64}, (2**13 + 8,), None),
        ({"x": 64, "y": 2048}, (16, 1024), None),
        ({"x": 15, "y": 2**14}, (15, 1024), None),  # odd
        ({"x": 2**21}, (2**14,), None),  # 16 MiB
        ({"x": 2048, "y": 2048}, (128, 128), (512, 1024)),
        ({"x": 3 * 2**20 + 1}, None, None),
    ],
)
def test_large_chunks_are_halved(sizes, inner, alike):
    """In turn along every dimension; by releases up to 0.2 along the longest, of larger ones."""
    array = Array("outcome", tuple(sizes), "<f8", 0, {})  # in one chunk
    cut = Layout(sizes, {dim: np.arange(n) for dim, n in sizes.items()}, {}, (array,))
    assert cut.inner_shape(array) == inner
    assert replace(cut, cut_alike=True).inner_shape(array) == alike
    assert len(cut.cuts) == (1 if inner == alike else 2)
