"""Reads a job's zarr store over HTTP, through the connection and with the token of the client."""

import asyncio
import json
from collections.abc import AsyncIterator, Iterable, Iterator
from typing import Any, Final, NoReturn

import xarray
from zarr.abc.store import ByteRequest, OffsetByteRequest, RangeByteRequest, Store, SuffixByteRequest
from zarr.core.buffer import Buffer, BufferPrototype

from service.client import accessor  # noqa: F401 - registers `dataset.bounce`
from service.client.errors import NotFound, StoreUnreachable, UnexpectedAnswer
from service.client.transport import Transport

#: The codecs of the stores that the service writes. Others can do more than decode: one of them unpickles.
CODECS: Final = frozenset({"bytes", "vlen-utf8", "zstd"})
#: The documents that describe groups and arrays; of zarr's version 2 there is none in our stores.
_METADATA: Final = "zarr.json"
_VERSION_2: Final = (".zarray", ".zgroup", ".zattrs", ".zmetadata")

_READ_ONLY: Final = "a job's store is read only"


def open_store(transport: Transport, path: str, job_id: str) -> xarray.Dataset:
    """The store at `path` as a lazy Dataset: values are read where they are used. Raises StoreUnreachable.

    Raises UnexpectedAnswer for a store that the service cannot have written.
    """
    try:
        dataset: xarray.Dataset = xarray.open_zarr(HTTPStore(transport, path), consolidated=True, chunks=None)
    except (FileNotFoundError, ValueError) as error:
        raise StoreUnreachable(f"job {job_id} has no store yet: it has not started") from error
    # Of stores of earlier releases, so that `to_netcdf` can write them too.
    nested = {name: value for name, value in dataset.attrs.items() if isinstance(value, dict | list)}
    return dataset.assign_attrs({name: json.dumps(value) for name, value in nested.items()})


class HTTPStore(Store):
    """A read-only zarr store: a key is a path below one address of the service."""

    def __init__(self, transport: Transport, path: str) -> None:
        super().__init__(read_only=True)
        self._transport, self._path = transport, path

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
        content = await asyncio.to_thread(self._read, key)
        return None if content is None else prototype.buffer.from_bytes(_slice(content, byte_range))

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        """Parts of the values of several keys."""
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]

    async def exists(self, key: str) -> bool:
        """Whether the key has a value."""
        return await asyncio.to_thread(self._read, key) is not None

    def _read(self, key: str) -> bytes | None:
        if key.endswith(_VERSION_2):
            return None
        try:
            content = self._transport.get(f"{self._path}/{key}").content
        except NotFound:
            return None
        if key.endswith(_METADATA):
            self._check(key, content)
        return content

    def _check(self, key: str, content: bytes) -> None:
        """Raise UnexpectedAnswer unless all arrays in a metadata document use codecs of ours only."""
        try:
            unknown = {
                codec["name"] for array in _arrays(json.loads(content)) for codec in array["codecs"]
            } - CODECS
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise UnexpectedAnswer(f"{self}/{key} is not the metadata of a bounce store") from error
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
    """The metadata of the arrays in a document: its own, or those that a group keeps together."""
    if document["zarr_format"] != 3:
        raise ValueError("not of zarr's version 3")
    if document["node_type"] == "array":
        if document.get("storage_transformers"):
            raise ValueError("storage transformers")
        yield document
    for inner in ((document.get("consolidated_metadata") or {}).get("metadata") or {}).values():
        yield from _arrays(inner)


def _slice(content: bytes, byte_range: ByteRequest | None) -> bytes:
    if isinstance(byte_range, RangeByteRequest):
        return content[byte_range.start : byte_range.end]
    if isinstance(byte_range, OffsetByteRequest):
        return content[byte_range.offset :]
    if isinstance(byte_range, SuffixByteRequest):
        return content[-byte_range.suffix :]
    return content
