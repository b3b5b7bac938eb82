"""Reads a job's zarr store over HTTP, through the client's connection and with its token."""

import asyncio
import json
import os
from collections.abc import AsyncIterator, Iterable, Iterator
from http import HTTPStatus
from itertools import islice
from math import prod
from typing import Any, Final
from urllib.parse import unquote_to_bytes

import numpy as np
import xarray
from zarr.abc.store import ByteRequest, OffsetByteRequest, RangeByteRequest, Store, SuffixByteRequest
from zarr.core.buffer import Buffer, BufferPrototype

from service.client import dataset  # noqa: F401 - registers `dataset.bounce`
from service.client.errors import NotFound, Refused, StoreUnreachable, UnexpectedAnswer
from service.client.transport import Transport

#: The codecs of the service's stores. Others can do more than decode: one of them unpickles.
CODECS: Final = frozenset({"bytes", "crc32c", "sharding_indexed", "vlen-utf8", "zstd"})
#: The documents that describe groups and arrays.
_METADATA: Final = "zarr.json"

#: Maximum arrays of a store; ours have about twenty.
MAX_ARRAYS: Final = 1_000
#: Maximum values of an array with at most one dimension, read when the store is opened; an axis has 100,000.
MAX_COORDINATE: Final = 1_000_000
#: Maximum values of a chunk, which is decoded whole; ours have up to 96 MiB.
MAX_CHUNK: Final = 256 * 2**20


def open_store(transport: Transport, path: str, job_id: str, *, chunks: Any = None) -> xarray.Dataset:
    """The store at `path` as a lazy Dataset: values are read when used.

    chunks: as in `xarray.open_zarr`. Raises StoreUnreachable, and UnexpectedAnswer for a store that the
    service cannot have written.
    """
    try:
        store = HTTPStore(transport, path)
        dataset: xarray.Dataset = xarray.open_zarr(store, consolidated=True, chunks=chunks, zarr_format=3)
    except FileNotFoundError as error:
        raise StoreUnreachable(f"job {job_id} has no store yet: it has not started") from error
    # Not every xarray writes texts of any length to a file; all write those of fixed length.
    texts = {
        name: (coord.dims, np.array(coord.values.tolist(), np.str_), coord.attrs)
        for name, coord in dataset.coords.items()
        if coord.dtype.kind in "OT"
    }
    return dataset.assign_coords(texts)


def store_url(transport: Transport, path: str, job_id: str) -> str:
    """The address of the store at `path`. Raises StoreUnreachable, UnexpectedAnswer."""
    try:
        response = transport.get(f"{path}/{_METADATA}")
    except NotFound as error:
        if error.status == HTTPStatus.GONE:
            raise
        raise StoreUnreachable(f"job {job_id} has no store yet: it has not started") from error
    address = response.headers.get("Bounce-Store")
    if not address:
        raise UnexpectedAnswer(f"{transport.url} does not give the address of its stores")
    return os.fsdecode(unquote_to_bytes(address))


class HTTPStore(Store):
    """A read-only zarr store: a key is a path below one address of the service.

    It wraps no other store: a later zarr would ask that one for parts of shards, and take fill values for
    what it lacks. Pickled, it contains the service's address and the token.
    """

    supports_writes = supports_deletes = supports_listing = False

    def __init__(self, transport: Transport, path: str) -> None:
        self._transport, self._path = transport, path
        super().__init__(read_only=True)

    def __reduce__(self) -> tuple[Any, ...]:
        return HTTPStore, (self._transport, self._path)

    def __eq__(self, other: object) -> bool:
        return self is other

    __hash__ = object.__hash__

    def __str__(self) -> str:
        return f"{self._transport.url}{self._path}"

    async def get(
        self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        """The value of a key, or a part of it; None if there is none."""
        content = await asyncio.to_thread(self._fetch, key, byte_range)
        return None if content is None else prototype.buffer.from_bytes(content)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        """Parts of the values of several keys."""
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]

    async def exists(self, key: str) -> bool:
        """Whether the key has a value."""
        return await asyncio.to_thread(self._fetch, key) is not None

    async def set(self, key: str, value: Buffer) -> None:
        """Refuse it."""
        self._check_writable()

    async def delete(self, key: str) -> None:
        """Refuse it."""
        self._check_writable()

    def _keys(self, prefix: str = "") -> AsyncIterator[str]:
        """Refuse it."""
        raise NotImplementedError("the service lists no keys")

    list = list_prefix = list_dir = _keys

    def _fetch(self, key: str, byte_range: ByteRequest | None = None) -> bytes | None:
        headers, part = _range(byte_range)
        try:
            response = self._transport.get(f"{self._path}/{key}", headers=headers)
        except NotFound as error:
            if error.status == HTTPStatus.GONE:  # the job was deleted: its cells are not missing
                raise
            return None
        except Refused as error:
            if error.status != HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
                raise
            return b""
        if key.endswith(_METADATA):
            self._check(key, response.content)
        # A proxy may ignore the range and send all bytes.
        is_part = response.status_code == HTTPStatus.PARTIAL_CONTENT
        return response.content if is_part else response.content[part]

    def _check(self, key: str, content: bytes) -> None:
        """Raise UnexpectedAnswer unless the arrays in a metadata document have our sizes and codecs."""
        try:
            fault = _fault(json.loads(content))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise UnexpectedAnswer(f"{self}/{key} is not the metadata of a bounce store") from error
        if fault:
            raise UnexpectedAnswer(f"{self}/{key} describes {fault}: not a bounce store")


def _fault(document: dict[str, Any]) -> str:
    """A property that the service's stores do not have and that could cost time or memory; else empty."""
    arrays = list(islice(_arrays(document), MAX_ARRAYS + 1))
    if len(arrays) > MAX_ARRAYS:
        return f"more than {MAX_ARRAYS:,} arrays"
    for array in arrays:
        values = prod(array["shape"])
        if len(array["shape"]) <= 1 and values > MAX_COORDINATE:
            return f"a coordinate of {values:,} values; at most {MAX_COORDINATE:,} are read"
        chunk = prod(array["chunk_grid"]["configuration"]["chunk_shape"])
        if chunk > MAX_CHUNK:
            return f"chunks of {chunk:,} values; at most {MAX_CHUNK:,} are read"
        if unknown := set(_codecs(array["codecs"])) - CODECS:
            return f"codecs that no bounce store has: {', '.join(sorted(map(repr, unknown)))[:200]}"
    return ""


def _arrays(document: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The metadata of the arrays in a document: its own, or a group's."""
    if document["zarr_format"] != 3:
        raise ValueError("not of zarr's version 3")
    if document["node_type"] == "array":
        if document.get("storage_transformers"):
            raise ValueError("storage transformers")
        yield document
    for inner in ((document.get("consolidated_metadata") or {}).get("metadata") or {}).values():
        yield from _arrays(inner)


def _codecs(codecs: list[dict[str, Any]]) -> Iterator[str]:
    """The names of codecs, including those inside shards."""
    for codec in codecs:
        yield codec["name"]
        for inner in ("codecs", "index_codecs"):
            yield from _codecs((codec.get("configuration") or {}).get(inner) or [])


def _range(byte_range: ByteRequest | None) -> tuple[dict[str, str], slice]:
    """The header that asks for a part of a value, and the part."""
    match byte_range:
        case RangeByteRequest(start, end):
            return {"Range": f"bytes={start}-{end - 1}"} if end > start else {}, slice(start, end)
        case OffsetByteRequest(offset):
            return {"Range": f"bytes={offset}-"}, slice(offset, None)
        case SuffixByteRequest(suffix):
            return {"Range": f"bytes=-{suffix}"}, slice(-suffix, None)
    return {}, slice(None)
