"""A job's zarr store, read through the client's own connection, token and all."""

import asyncio
from collections.abc import AsyncIterator, Iterable
from typing import Final, NoReturn

import xarray
from zarr.abc.store import ByteRequest, OffsetByteRequest, RangeByteRequest, Store, SuffixByteRequest
from zarr.core.buffer import Buffer, BufferPrototype

from service.client.errors import NotFound, StoreUnreachable
from service.client.transport import Transport

_READ_ONLY: Final = "a job's store is read only"


def open_remote(transport: Transport, path: str, job_id: str) -> xarray.Dataset:
    """The store at `path`, its arrays read only where they are used. Raises StoreUnreachable."""
    try:
        store: xarray.Dataset = xarray.open_zarr(Remote(transport, path), consolidated=True, chunks=None)
    except (FileNotFoundError, ValueError) as error:
        raise StoreUnreachable(f"job {job_id} has no store yet: it has not begun") from error
    return store


class Remote(Store):
    """The keys and values under one address of the service."""

    def __init__(self, transport: Transport, path: str) -> None:
        super().__init__(read_only=True)
        self._transport, self._path = transport, path

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Remote) and (self._transport, self._path) == (other._transport, other._path)

    def __hash__(self) -> int:
        return hash((id(self._transport), self._path))

    def __str__(self) -> str:
        return f"{self._transport.url}{self._path}"

    async def get(
        self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        """What lies under a key; None if nothing does."""
        content = await asyncio.to_thread(self._read, key)
        return None if content is None else prototype.buffer.from_bytes(_part(content, byte_range))

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        """Parts of what lies under some keys."""
        return [await self.get(key, prototype, part) for key, part in key_ranges]

    async def exists(self, key: str) -> bool:
        """Whether something lies under a key."""
        return await asyncio.to_thread(self._read, key) is not None

    def _read(self, key: str) -> bytes | None:
        try:
            return self._transport.get(f"{self._path}/{key}").content
        except NotFound:
            return None

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


def _part(content: bytes, wanted: ByteRequest | None) -> bytes:
    if isinstance(wanted, RangeByteRequest):
        return content[wanted.start : wanted.end]
    if isinstance(wanted, OffsetByteRequest):
        return content[wanted.offset :]
    if isinstance(wanted, SuffixByteRequest):
        return content[-wanted.suffix :]
    return content
