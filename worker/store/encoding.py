"""One array's chunk as bytes: little-endian numbers in zstd, in a shard where inner chunks are smaller.

The bytes are those that zarr writes, but for the order of inner chunks in a shard, which the format leaves
open.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from math import prod
from typing import Any, Final, NamedTuple

import numpy as np
from numcodecs.checksum32 import CRC32C
from numcodecs.zstd import compress, decompress
from numpy.typing import NDArray

#: Of zstd, whose frames carry a checksum.
LEVEL: Final = 3
#: Offset and length of an inner chunk that a shard does not have.
_ABSENT: Final = 2**64 - 1
_INDEX_ENTRY: Final = 16
_CRC: Final = 4
#: Puts the checksum of a shard's index behind it, and compares it.
_CHECKED: Final = CRC32C(location="end")


class ArrayForm(NamedTuple):
    """How one array is stored, from the store's metadata."""

    dtype: np.dtype[Any]
    fill: Any
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    chunks: tuple[int, ...]  # of a file
    inner: tuple[int, ...]  # of what is compressed together: `chunks`, unless these are shards
    separator: str  # between the coordinates in the keys of chunks

    @property
    def sharded(self) -> bool:
        """Whether a file has several inner chunks, and an index of them at its end."""
        return self.inner != self.chunks

    @property
    def inner_counts(self) -> tuple[int, ...]:
        """Inner chunks of a file along each dimension."""
        return tuple(n // size for n, size in zip(self.chunks, self.inner, strict=True))

    @property
    def index_bytes(self) -> int:
        """Bytes of a shard's index."""
        return _INDEX_ENTRY * prod(self.inner_counts) + _CRC


def encode(form: ArrayForm, values: NDArray[Any]) -> bytes:
    """A chunk's bytes. `values`: of its cells that are in the grid, fewer than a chunk's at the edge."""
    block = values
    if values.shape != form.chunks:
        block = np.full(form.chunks, form.fill, form.dtype)
        block[tuple(slice(n) for n in values.shape)] = values
    if not form.sharded:
        return _compressed(form, block)
    counts = form.inner_counts
    index = np.full((prod(counts), 2), _ABSENT, "<u8")
    parts, offset = [], 0
    for number, coords in enumerate(product(*map(range, counts))):
        first = [at * n for at, n in zip(coords, form.inner, strict=True)]
        if all(at < n for at, n in zip(first, values.shape, strict=True)):
            part = _compressed(
                form, block[tuple(slice(at, at + n) for at, n in zip(first, form.inner, strict=True))]
            )
            index[number] = offset, len(part)
            offset += len(part)
            parts.append(part)
    return b"".join([*parts, _CHECKED.encode(index.tobytes())])


def decode(form: ArrayForm, content: bytes) -> NDArray[Any]:
    """The values of an inner chunk. Raises RuntimeError or ValueError for damaged bytes."""
    values = np.empty(form.inner, form.dtype)  # a damaged header may declare a far larger size
    decompress(content, values)
    return values


def spans_of(form: ArrayForm, index: bytes, inner: Sequence[tuple[int, ...]]) -> list[tuple[int, int]]:
    """Offset and length of inner chunks, by their coordinates in a shard. Raises ValueError for damage."""
    try:
        entries = bytes(_CHECKED.decode(index))
    except RuntimeError as error:
        raise ValueError(f"the index of the shard is damaged: {error}") from None
    if len(index) != form.index_bytes:
        raise ValueError("the shard is cut off")
    table = np.frombuffer(entries, "<u8").reshape(*form.inner_counts, 2)
    spans = [(int(table[coords][0]), int(table[coords][1])) for coords in inner]
    if any(offset == _ABSENT for offset, _ in spans):
        raise ValueError("the shard lacks a chunk")
    return spans


def form_of(metadata: Mapping[str, Any]) -> ArrayForm:
    """From the metadata of an array. Raises KeyError, TypeError or ValueError for what we do not write."""
    dtype = np.dtype(metadata["data_type"]).newbyteorder("<")
    chunks = tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"])
    codec = metadata["codecs"][0]
    sharded = codec["name"] == "sharding_indexed"
    return ArrayForm(
        dtype,
        _fill(dtype, metadata["fill_value"]),
        tuple(metadata["dimension_names"]),
        tuple(metadata["shape"]),
        chunks,
        tuple(codec["configuration"]["chunk_shape"]) if sharded else chunks,
        metadata["chunk_key_encoding"]["configuration"]["separator"],
    )


def _fill(dtype: np.dtype[Any], value: Any) -> Any:
    """A fill from its JSON: numbers that are not finite are texts, complex ones a list of two."""
    numbers = [float(part) if isinstance(part, str) else part for part in np.atleast_1d(value).tolist()]
    return complex(*numbers) if dtype.kind == "c" else numbers[0]


def _compressed(form: ArrayForm, block: NDArray[Any]) -> bytes:
    content: bytes = compress(np.ascontiguousarray(block, form.dtype), level=LEVEL, checksum=True)
    return content
