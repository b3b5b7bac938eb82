"""Reads a job's zarr store over HTTP, through the client's connection and with its token."""

import asyncio
import json
import math
from collections.abc import AsyncIterator, Iterable, Iterator
from datetime import timedelta
from http import HTTPStatus
from itertools import islice
from pathlib import Path
from typing import Any, Final, NoReturn
from urllib.parse import unquote

import numpy as np
import xarray
from zarr.abc.store import ByteRequest, OffsetByteRequest, RangeByteRequest, Store, SuffixByteRequest
from zarr.core.buffer import Buffer, BufferPrototype, default_buffer_prototype
from zarr.core.sync import sync
from zarr.storage import LocalStore, ObjectStore

from service.client import accessor  # noqa: F401 - registers `dataset.bounce`
from service.client.errors import NotFound, Refused, StoreUnreachable, UnexpectedAnswer
from service.client.transport import Transport

#: The codecs of the service's stores. Others can do more than decode: one of them unpickles.
CODECS: Final = frozenset({"bytes", "crc32c", "sharding_indexed", "vlen-utf8", "zstd"})
#: The documents that describe groups and arrays; our stores have none of zarr's version 2.
_METADATA: Final = "zarr.json"
_VERSION_2: Final = (".zarray", ".zgroup", ".zattrs", ".zmetadata")

#: Maximum arrays of a store; ours have about twenty.
MAX_ARRAYS: Final = 1_000
#: Maximum values of an array with at most one dimension, read when the store is opened; an axis has 100,000.
MAX_COORDINATE: Final = 1_000_000
#: Maximum values of a chunk, which is decoded whole; ours have up to 96 MiB.
MAX_CHUNK: Final = 256 * 2**20

#: A bucket that does not answer soon is not read directly.
_FEW_RETRIES: Final[Any] = {"max_retries": 1, "retry_timeout": timedelta(seconds=2)}
_READ_ONLY: Final = "a job's store is read only"


def open_store(
    transport: Transport, path: str, job_id: str, *, chunks: Any = None, direct: bool = False
) -> xarray.Dataset:
    """The store at `path` as a lazy Dataset: values are read when used. Raises StoreUnreachable.

    chunks: as in `xarray.open_zarr`. direct: read chunks at the store's own address, if this machine can.
    Raises UnexpectedAnswer for a store that the service cannot have written.
    """
    address = store_url(transport, path, job_id) if direct else None
    try:
        store = HTTPStore(transport, path, address)
        dataset: xarray.Dataset = xarray.open_zarr(store, consolidated=True, chunks=chunks)
    except (FileNotFoundError, ValueError) as error:
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
        raise StoreUnreachable(f"job {job_id} has no store yet: it has not started") from error
    address = response.headers.get("Bounce-Store")
    if not address:
        raise UnexpectedAnswer(f"{transport.url} does not give the address of its stores")
    return unquote(address)


class HTTPStore(Store):
    """A read-only zarr store: a key is a path below one address of the service.

    address: the service's address of the store; chunks are read there if this machine finds the same store.
    The arrays' metadata always come from the service, as they determine how chunks are decoded.
    Pickled, it contains the service's address and the token.
    """

    def __init__(self, transport: Transport, path: str, address: str | None = None) -> None:
        super().__init__(read_only=True)
        self._transport, self._path, self._address = transport, path, address
        self._direct = None if address is None else self._same_store(address)

    def __reduce__(self) -> tuple[Any, ...]:
        return HTTPStore, (self._transport, self._path, self._address)

    @property
    def reads_directly(self) -> bool:
        """Whether chunks are read at the store's own address."""
        return self._direct is not None

    def _same_store(self, address: str) -> Store | None:
        """The store at an address, if it is the job's; None if it cannot be read from here."""
        try:
            if address.startswith("s3://"):
                from obstore.store import S3Store

                store: Store = ObjectStore(
                    S3Store.from_url(address, retry_config=_FEW_RETRIES), read_only=True
                )
            else:
                if not Path(address, _METADATA).is_file():
                    return None  # another machine's folder; zarr would wait for a pipe
                store = LocalStore(address, read_only=True)
            root = sync(store.get(_METADATA, default_buffer_prototype()))
        except Exception:  # noqa: BLE001 - another machine's folder, no obstore, no key of the bucket
            return None
        return store if root is not None and root.to_bytes() == self._fetch(_METADATA) else None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, HTTPStore) and (self._transport, self._path) == (
            other._transport,
            other._path,
        )

    def __hash__(self) -> int:
        return hash((id(self._transport), self._path))

    def __str__(self) -> str:
        return f"{self._transport.url}{self._path}"

    async def get(
        self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        """The value of a key, or a part of it; None if there is none."""
        if self._direct is not None and not key.endswith((_METADATA, *_VERSION_2)):
            return await self._direct.get(key, prototype, byte_range)
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

    def _fetch(self, key: str, byte_range: ByteRequest | None = None) -> bytes | None:
        if key.endswith(_VERSION_2):
            return None
        try:
            response = self._transport.get(f"{self._path}/{key}", headers=_range_header(byte_range))
        except NotFound:
            return None
        except Refused as error:
            if error.status != HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
                raise
            return b""
        if key.endswith(_METADATA):
            self._check(key, response.content)
        # A proxy may ignore the range and send all bytes.
        return response.content if response.status_code == 206 else _slice(response.content, byte_range)

    def _check(self, key: str, content: bytes) -> None:
        """Raise UnexpectedAnswer unless the arrays in a metadata document have our sizes and codecs."""
        try:
            arrays = list(islice(_arrays(json.loads(content)), MAX_ARRAYS + 1))
            too_large = _too_large(arrays)
            unknown = {name for array in arrays for name in _names(array["codecs"])} - CODECS
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise UnexpectedAnswer(f"{self}/{key} is not the metadata of a bounce store") from error
        if too_large:
            raise UnexpectedAnswer(f"{self}/{key} describes {too_large}: not a bounce store")
        if unknown:
            names = ", ".join(sorted(map(repr, unknown)))
            raise UnexpectedAnswer(f"{self}/{key} names codecs that no bounce store has: {names[:200]}")

    @property
    def supports_writes(self) -> bool:
        return False

    @property
    def supports_deletes(self) -> bool:
        return False

    @property
    def supports_listing(self) -> bool:
        return False

    async def set(self, key: str, value: Buffer) -> NoReturn:
        raise PermissionError(_READ_ONLY)

    async def delete(self, key: str) -> NoReturn:
        raise PermissionError(_READ_ONLY)

    def list(self) -> AsyncIterator[str]:
        raise NotImplementedError

    def list_prefix(self, prefix: str) -> AsyncIterator[str]:
        raise NotImplementedError

    def list_dir(self, prefix: str) -> AsyncIterator[str]:
        raise NotImplementedError


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


def _too_large(arrays: list[dict[str, Any]]) -> str:
    """What would take more time or memory than the service's stores; empty if nothing."""
    if len(arrays) > MAX_ARRAYS:
        return f"more than {MAX_ARRAYS:,} arrays"
    for array in arrays:
        values = math.prod(array["shape"])
        if len(array["shape"]) <= 1 and values > MAX_COORDINATE:
            return f"a coordinate of {values:,} values; at most {MAX_COORDINATE:,} are read"
        chunk = math.prod(array["chunk_grid"]["configuration"]["chunk_shape"])
        if chunk > MAX_CHUNK:
            return f"chunks of {chunk:,} values; at most {MAX_CHUNK:,} are read"
    return ""


def _names(codecs: list[dict[str, Any]]) -> Iterator[str]:
    """The names of codecs, including those inside shards."""
    for codec in codecs:
        yield codec["name"]
        for inner in ("codecs", "index_codecs"):
            yield from _names((codec.get("configuration") or {}).get(inner) or [])


def _range_header(byte_range: ByteRequest | None) -> dict[str, str]:
    if isinstance(byte_range, RangeByteRequest) and byte_range.end > byte_range.start:
        return {"Range": f"bytes={byte_range.start}-{byte_range.end - 1}"}
    if isinstance(byte_range, OffsetByteRequest):
        return {"Range": f"bytes={byte_range.offset}-"}
    if isinstance(byte_range, SuffixByteRequest):
        return {"Range": f"bytes=-{byte_range.suffix}"}
    return {}


def _slice(content: bytes, byte_range: ByteRequest | None) -> bytes:
    if isinstance(byte_range, RangeByteRequest):
        return content[byte_range.start : byte_range.end]
    if isinstance(byte_range, OffsetByteRequest):
        return content[byte_range.offset :]
    if isinstance(byte_range, SuffixByteRequest):
        return content[-byte_range.suffix :]
    return content
