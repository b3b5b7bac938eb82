"""Layouts of stores: shards, whatever the study."""

import numpy as np
from tables import for_each

from worker.study import Array, Layout


@for_each(("sizes", "inner"), [
    ({"x": 2**16}, None),  # 512 kiB
    ({"x": 2**16 + 64}, (2**13 + 8,)),
    ({"x": 64, "y": 2048}, (16, 1024)),
    ({"x": 15, "y": 2**14}, (15, 1024)),  # odd
    ({"x": 2**21}, (2**14,)),  # 16 MiB
    ({"x": 2048, "y": 2048}, (128, 128)),
    ({"x": 3 * 2**20 + 1}, None),
])  # fmt: skip
def test_large_chunks_are_halved(sizes, inner):
    """In turn along every dimension."""
    array = Array("outcome", tuple(sizes), "<f8", 0, {})  # in one chunk
    cut = Layout(sizes, {dim: np.arange(n) for dim, n in sizes.items()}, {}, (array,))
    assert cut.inner_shape(array) == inner
