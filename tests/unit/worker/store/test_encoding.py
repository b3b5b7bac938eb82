"""Chunks as bytes: shards with an index, and what is damaged about them."""

from itertools import product

import numpy as np
import pytest
from numcodecs.zstd import compress
from tables import for_each

from worker.store import encoding
from worker.store.encoding import LEVEL, ArrayForm, decode, encode, spans_of


def form(chunks: tuple[int, ...] = (4, 4), inner: tuple[int, ...] = (2, 4), fill: float = 7) -> ArrayForm:
    return ArrayForm(np.dtype("<i4"), fill, ("x", "y"), (10, 10), chunks, inner, "a job")


@for_each("inner", [(2, 4), (1, 2), (2, 2), (4, 1)])
@for_each("shape", [(4, 4), (3, 4), (2, 3), (1, 1)])
def test_a_shard_has_the_inner_chunks_with_cells(inner: tuple[int, int], shape: tuple[int, int]):
    shard, values = form(inner=inner), np.arange(16, dtype=np.int32).reshape(4, 4)[: shape[0], : shape[1]]
    assert shard.sharded
    assert shard.inner_counts == (4 // inner[0], 4 // inner[1])
    assert shard.index_bytes == 16 * 16 // (inner[0] * inner[1]) + 4
    content = encode(shard, values, (0, 0))
    index = content[-shard.index_bytes :]
    whole = np.full((4, 4), 7)
    whole[: shape[0], : shape[1]] = values
    end = 0
    for coords in product(*map(range, shard.inner_counts)):
        first = tuple(at * n for at, n in zip(coords, inner, strict=True))
        if any(at >= n for at, n in zip(first, shape, strict=True)):
            with pytest.raises(ValueError, match="the shard lacks a chunk"):
                spans_of(shard, index, [coords])
            continue
        [(offset, length)] = spans_of(shard, index, [coords])
        assert offset == end
        end += length
        cells = tuple(slice(at, at + n) for at, n in zip(first, inner, strict=True))
        assert decode(shard, content[offset:end], coords).tolist() == whole[cells].tolist()
    assert end == len(content) - shard.index_bytes


def test_a_damaged_index_is_no_index():
    shard = form()
    content = encode(shard, np.zeros((4, 4), np.int32), (0, 0))
    index = content[-shard.index_bytes :]
    assert len(spans_of(shard, index, [(0, 0), (1, 0)])) == 2
    with pytest.raises(RuntimeError, match="checksum do not match"):
        spans_of(shard, bytes([index[0] ^ 1]) + index[1:], [(0, 0)])
    shorter = form(chunks=(2, 4), inner=(1, 4))._replace(chunks=(6, 4), inner=(2, 4))
    with pytest.raises(ValueError, match="the shard is cut off"):
        spans_of(shorter, index, [(0, 0)])


@for_each("size", [1, 255, 256, 300, 70_000])
def test_a_sealed_chunk_is_filled_by_its_frame(size: int):
    """What a shorter one leaves is the memory of others."""
    whole, values = (
        ArrayForm(np.dtype("<u1"), 0, ("x",), (size,), (size,), (size,), "a job"),
        np.arange(size + 1),
    )
    for n in (size - 1, size, size + 1):
        frame = compress(values[:n].astype("<u1"), level=LEVEL, checksum=True)
        content = frame + encoding._seal(whole, frame, (0,))
        if n == size:
            assert decode(whole, content, (0,)).tolist() == (values[:n] % 256).tolist()
            continue
        with pytest.raises(ValueError, match="do not fill the chunk"):
            decode(whole, content, (0,))
