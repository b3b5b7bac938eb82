"""Layouts of stores: shards, whatever the study."""

import numpy as np
from tables import for_each

from worker.study import Array, Layout


def sized(**sizes: int) -> Layout:
    """One chunk of so many cells of 8 bytes."""
    array = Array("outcome", tuple(sizes), "<f8", 0, {})
    return Layout(sizes, {dim: np.arange(n) for dim, n in sizes.items()}, {}, (array,))


@for_each(
    ("sizes", "inner"),
    [
        ({"x": 2**21}, None),  # 16 MiB
        ({"x": 17 * 2**17 + 64}, {"x": (17 * 2**17 + 64) // 8}),
        ({"x": 2**22}, {"x": 2**19}),  # 32 MiB in parts of 4
        ({"x": 2048, "y": 2048}, {"x": 512, "y": 1024}),
        ({"x": 3 * 2**20 + 1}, None),  # odd
    ],
)
def test_large_chunks_are_halved_into_parts_of_four_megabytes(sizes, inner):
    cut = sized(**sizes)
    assert cut.inner_sizes == inner
    assert cut.inner_shape(cut.arrays[0]) == (inner and tuple(inner.values()))
