"""One array's chunk as bytes: little-endian numbers in zstd, in a shard where inner chunks are smaller.

The bytes are those of zarr, except for the order of inner chunks in a shard, which the format leaves open,
and for a seal behind each inner chunk: a skippable frame of zstd, which decoders ignore. It holds a
digest of the job, the array, the position, and the length and checksum of the compressed data, which zstd
verifies. The bytes of a chunk follow from its job's specification, so a chunk with its own seal is the stored
chunk.
"""

import struct
from collections.abc import Mapping, Sequence
from hashlib import blake2b
from itertools import product
from math import prod
from typing import Any, Final, NamedTuple

import numpy as np
from numcodecs.checksum32 import CRC32C
from numcodecs.zstd import compress, decompress
from numpy.typing import NDArray

from worker.store.backend import ChunkCoords
from worker.study import Layout

#: Compression level of zstd.
LEVEL: Final = 3
#: Offset and length of an inner chunk missing from a shard.
_ABSENT: Final = 2**64 - 1
_INDEX_ENTRY: Final = 16
_CRC: Final = 4
#: Head of a seal: the magic number of a skippable frame, and the number of bytes that follow.
_SEALED_BYTES: Final = 16
_SEAL_HEAD: Final = struct.pack("<II", 0x184D2A5B, _SEALED_BYTES)
#: Head of a zstd frame, its magic number.
_FRAME_HEAD: Final = struct.pack("<I", 0xFD2FB528)
#: Bytes at the end of a zstd frame, the checksum of its content.
_CHECKSUM_BYTES: Final = 4
_SEAL_BYTES: Final = len(_SEAL_HEAD) + _SEALED_BYTES
#: Appends the checksum of a shard's index, and verifies it.
_CHECKED: Final = CRC32C(location="end")


class ArrayForm(NamedTuple):
    """How one array is stored, from the store's metadata."""

    dtype: np.dtype[Any]
    fill: Any
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    chunks: tuple[int, ...]  # of a file
    inner: tuple[int, ...]  # of a compressed unit: `chunks`, unless these are shards
    seal: str  # the job and the array's name

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


def chunk_key(name: str, dims: int, coords: ChunkCoords) -> str:
    """Key of one array's chunk in its store; `dims` is the array's number of dimensions."""
    numbers = [*coords, *[0] * (dims - len(coords))]
    return f"{name}/c.{'.'.join(map(str, numbers))}"


def encode(form: ArrayForm, values: NDArray[Any], coords: Sequence[int]) -> bytes:
    """A chunk's bytes. `values`: its cells, fewer than a whole chunk at the edge of the grid."""
    block = values
    if values.shape != form.chunks:
        block = np.full(form.chunks, form.fill, form.dtype)
        block[tuple(slice(n) for n in values.shape)] = values
    counts = form.inner_counts
    index = np.full((prod(counts), 2), _ABSENT, "<u8")
    parts, offset = [], 0
    for number, inner in enumerate(product(*map(range, counts))):
        first = [i * n for i, n in zip(inner, form.inner, strict=True)]
        if all(start < n for start, n in zip(first, values.shape, strict=True)):
            cells = block[tuple(slice(start, start + n) for start, n in zip(first, form.inner, strict=True))]
            part = compress(np.ascontiguousarray(cells, form.dtype), level=LEVEL, checksum=True)
            parts.append(part + _seal(form, part, position(form, coords, inner)))
            index[number] = offset, len(parts[-1])
            offset += len(parts[-1])
    return b"".join([*parts, _CHECKED.encode(index.tobytes())]) if form.sharded else parts[0]


def decode(form: ArrayForm, content: bytes, index: tuple[int, ...]) -> NDArray[Any]:
    """The values of the inner chunk at a position. Raises RuntimeError or ValueError for damaged bytes."""
    check_seal(form, content, index)
    values = np.empty(form.inner, form.dtype)
    if _declared(content) != values.nbytes:  # less would leave in it what the memory held
        raise ValueError("its bytes do not fill the chunk")
    decompress(content, values)
    return values


def _declared(frame: bytes) -> int:
    """Bytes of a zstd frame's content, by its head (RFC 8878, 3.1.1.1); 0 if it does not say."""
    if not frame.startswith(_FRAME_HEAD):
        return 0
    size, single, key = frame[4] >> 6, frame[4] >> 5 & 1, frame[4] & 3
    start, width = 6 - single + (0, 1, 2, 4)[key], (single, 2, 4, 8)[size]
    return int.from_bytes(frame[start : start + width], "little") + (256 if width == 2 else 0)


def position(form: ArrayForm, coords: Sequence[int], inner: Sequence[int]) -> tuple[int, ...]:
    """Position of an inner chunk in the array, in inner chunks; omitted coordinates are 0."""
    dims = len(form.dims)
    outer, within = ([*part, *[0] * (dims - len(part))] for part in (coords, inner))
    return tuple(c * n + i for c, n, i in zip(outer, form.inner_counts, within, strict=True))


def check_seal(form: ArrayForm, content: bytes, index: tuple[int, ...]) -> None:
    """Raise ValueError unless an inner chunk's bytes are those stored at this position."""
    body = memoryview(content)[:-_SEAL_BYTES]
    if content[-_SEAL_BYTES:] != _seal(form, body, index):
        raise ValueError("its bytes are not those stored here")


def check_file(form: ArrayForm, content: bytes, coords: Sequence[int]) -> None:
    """Raise ValueError or RuntimeError unless a chunk's file is the one stored at these coordinates."""
    if not form.sharded:
        check_seal(form, content, position(form, coords, ()))
        return
    entries = _index(form, content[-form.index_bytes :])
    for inner in product(*map(range, form.inner_counts)):
        offset, length = (int(number) for number in entries[inner])
        if offset != _ABSENT:
            check_seal(form, content[offset : offset + length], position(form, coords, inner))


def _seal(form: ArrayForm, body: memoryview | bytes, index: tuple[int, ...]) -> bytes:
    fact = f"{form.seal} {form.dtype.str} {form.shape} {form.chunks} {form.inner} {index} {len(body)}\n"
    content = fact.encode() + bytes(body[-_CHECKSUM_BYTES:])
    return _SEAL_HEAD + blake2b(content, digest_size=_SEALED_BYTES).digest()


def spans_of(form: ArrayForm, index: bytes, inner: Sequence[tuple[int, ...]]) -> list[tuple[int, int]]:
    """Offset and length of inner chunks, by their coordinates in a shard along its first dimensions.

    Raises as `decode`.
    """
    table = _index(form, index)
    spans = [(int(offset), int(length)) for offset, length in (table[coords].ravel() for coords in inner)]
    if any(offset == _ABSENT for offset, _ in spans):
        raise ValueError("the shard lacks a chunk")
    return spans


def _index(form: ArrayForm, index: bytes) -> NDArray[np.uint64]:
    """(inner_counts, 2) offset and length of the inner chunks of a shard. Raises as `decode`."""
    entries = bytes(_CHECKED.decode(index))
    if len(index) != form.index_bytes:
        raise ValueError("the shard is cut off")
    return np.frombuffer(entries, "<u8").reshape(*form.inner_counts, 2)


def forms_in(layout: Layout) -> dict[str, ArrayForm]:
    """The forms of a layout's arrays, by name."""
    return {
        array.name: ArrayForm(
            np.dtype(array.dtype).newbyteorder("<"),
            array.fill,
            array.dims,
            layout.shape(array),
            layout.chunk_shape(array),
            layout.inner_shape(array) or layout.chunk_shape(array),
            f"{layout.identity.get('job')} {array.name}",
        )
        for array in layout.arrays
    }


def same(form: ArrayForm, other: ArrayForm | None) -> bool:
    """Whether two arrays are stored alike."""
    if other is None or form._replace(fill=0) != other._replace(fill=0):
        return False
    return np.array_equal(form.fill, other.fill, equal_nan=True)


def form_of(metadata: Mapping[str, Any], seal: str) -> ArrayForm:
    """The form in an array's metadata. Raises KeyError, TypeError or ValueError for one we do not write."""
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
        seal,
    )


def _fill(dtype: np.dtype[Any], value: Any) -> Any:
    """A fill value from its JSON: infinities and NaN are texts, complex numbers lists of two."""
    numbers = [float(part) if isinstance(part, str) else part for part in np.atleast_1d(value).tolist()]
    return complex(*numbers) if dtype.kind == "c" else numbers[0]
