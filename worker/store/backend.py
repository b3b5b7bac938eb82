"""Addresses of stores: a folder of this machine, or a prefix of an S3-compatible bucket.

A folder is a path; a bucket is s3://BUCKET/PREFIX. Region, endpoint and keys of a bucket come from the
environment's AWS_* variables, which must be the same for the service and its workers. Only this module
distinguishes the two kinds of address.
"""

import errno
import os
import re
import shutil
import stat
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import timedelta
from functools import cache, lru_cache
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, BinaryIO, Final
from urllib.parse import urlsplit
from uuid import uuid4

from worker.files import make_folder, replacing, sync, synced
from worker.spec.errors import BounceError

if TYPE_CHECKING:
    from obstore.store import S3Store

#: Position of a chunk in the grid of chunks, one index per cell dimension.
ChunkCoords = tuple[int, ...]

_BUCKET: Final = "s3://"
#: Key of a store's root metadata, written last when the store is created.
ROOT: Final = "zarr.json"
#: Ends the name of a folder that is being removed.
DELETED: Final = ".deleted"
#: The folder, in a store, of files that are being written.
PARTIAL: Final = ".partial"

#: Maximum bytes of a file in a store; chunks have up to 96 MiB before compression.
MAX_FILE_BYTES: Final = 2**30
#: Errors of opening something that is no file: nothing, a link, a socket.
_NO_FILE: Final = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENXIO)

#: Concurrent syncs and requests, which wait for the disk or the network, not for the processor.
_THREADS: Final = 8
#: Requests to a bucket that does not respond are retried for this long before they fail.
_RETRY_TIMEOUT: Final = timedelta(seconds=15)


class StoreError(Exception):
    """Base class of a store's errors; itself: the address cannot hold a store."""


class Unreachable(BounceError):
    """A bucket does not respond, is missing, or denies access; the reason in one line."""


class StoreMissing(StoreError):
    """There is no store at the address, or its creation was interrupted."""


class StoreConflict(StoreError):
    """The store holds another job, or has chunks of another shape."""


class StoreDamaged(StoreError):
    """Stored bytes are missing or cannot be decoded; `chunks`: the damaged chunks, if any."""

    def __init__(self, message: str, chunks: tuple[ChunkCoords, ...] = ()) -> None:
        super().__init__(message)
        self.chunks = chunks


def in_bucket(url: str) -> bool:
    """Whether the address is in a bucket."""
    return url.startswith(_BUCKET)


def check_address(url: str) -> None:
    """Raise StoreError for an invalid address of a store, or a bucket without the extra `s3`."""
    if not in_bucket(url):
        if "://" in url:
            raise StoreError(f"{url}: only folders and s3://BUCKET/PREFIX can hold stores")
        return
    if not urlsplit(url).netloc:
        raise StoreError(f"{url}: an address in a bucket must be s3://BUCKET/PREFIX")
    _obstore()


def read_key(url: str, key: str) -> bytes | None:
    """The bytes under a key of a store; None if there are none. Raises Unreachable.

    Links, pipes, devices, and files above MAX_FILE_BYTES count as missing.
    """
    if not in_bucket(url):
        with _opened(url, key) as file:
            return None if file is None else file.read()
    try:
        with _bucket(url) as bucket:
            answer = bucket.get(key)
            return bytes(answer.bytes()) if answer.meta["size"] <= MAX_FILE_BYTES else None
    except FileNotFoundError:
        return None


@contextmanager
def _opened(url: str, key: str) -> Iterator[BinaryIO | None]:
    """The file under a key of a folder, unbuffered; None for one that `read_key` counts as missing."""
    path = Path(url, key)
    try:
        # Without O_NONBLOCK opening a pipe waits until something writes to it.
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError as error:
        if error.errno not in _NO_FILE:
            raise
        yield None
        return
    try:
        status = os.fstat(descriptor)
        linked = _link(path, key.count("/")) is not None
        is_ours = stat.S_ISREG(status.st_mode) and status.st_size <= MAX_FILE_BYTES and not linked
        yield open(descriptor, "rb", buffering=0, closefd=False) if is_ours else None  # noqa: SIM115
    finally:
        os.close(descriptor)


def _link(path: Path, above: int) -> Path | None:
    """The first symbolic link among the `above` folders over a path; None without one."""
    return next((folder for folder in path.parents[:above] if folder.is_symlink()), None)


def refuse_links(url: str, key: str) -> None:
    """Raise OSError if the folder of a store, or one in it, over a key is a symbolic link."""
    if not in_bucket(url) and (link := _link(Path(url, key), key.count("/") + 1)):
        raise OSError(errno.ELOOP, "nothing is written through a symbolic link", str(link))


def read_parts(url: str, key: str, spans: Sequence[tuple[int, int]]) -> list[bytes] | None:
    """Parts of the bytes under a key, given by offset and length; None if there is nothing.

    A negative offset counts from the end. Parts beyond the end are shorter.
    """
    if not in_bucket(url):
        with _opened(url, key) as file:
            if file is None:
                return None
            size = os.fstat(file.fileno()).st_size
            return [
                os.pread(file.fileno(), n, offset if offset >= 0 else max(size + offset, 0))
                for offset, n in spans
            ]
    try:
        with _bucket(url) as bucket:
            if spans[0][0] < 0:
                return [bytes(bucket.get(key, options={"range": {"suffix": -spans[0][0]}}).bytes())]
            starts, lengths = zip(*spans, strict=True)
            return [bytes(part) for part in bucket.get_ranges(key, starts=starts, lengths=lengths)]
    except FileNotFoundError:
        return None


def put(url: str, key: str, content: bytes) -> None:
    """Write a key of a store, whole or not at all, and sync it; its folder must exist."""
    if in_bucket(url):
        with _bucket(url, FileNotFoundError) as bucket:  # it is the bucket that is not found
            bucket.put(key, content)
        return
    with replacing(Path(url, key)) as file:
        file.write(content)
        if Path(url, key).is_dir():
            clear(Path(url, key))


def write_partial(url: str, content: bytes) -> Path:
    """Write and sync a file in a store's folder of partial files, for `place`. Raises FileNotFoundError.

    A file that cannot be written whole is removed.
    """
    path = Path(url, PARTIAL, f"{uuid4().hex}.partial")
    refuse_links(url, f"{PARTIAL}/{path.name}")
    _make_folder(path.parent)  # not the store itself: if missing, it is being removed
    try:
        with synced(path) as file:
            file.write(content)
    except OSError:
        path.unlink(missing_ok=True)
        raise
    return path


def place(url: str, partial: Path, key: str) -> None:
    """Give a partial file its key, replacing anything; creates missing folders below the store's."""
    path = Path(url, key)
    refuse_links(url, key)
    try:
        partial.replace(path)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        for folder in reversed(path.parents[: key.count("/")]):
            _make_folder(folder)
        if path.is_dir():
            clear(path)
        partial.replace(path)


def _make_folder(folder: Path) -> None:
    """Create a folder of a store, also in the place of a file."""
    if not folder.is_dir():
        with suppress(OSError):  # without the file, or if another thread was first
            folder.unlink()
        folder.mkdir(exist_ok=True)


def clear(path: Path) -> None:
    """Remove a file, a link, or a folder with all in it, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def make_place(url: str) -> None:
    """Create the folder at an address and its parents; a bucket needs none."""
    if not in_bucket(url):
        make_folder(Path(url))


def write_fault(url: str) -> str | None:
    """Why this process cannot create a file in the folder at an address; None if it can.

    Tries it, in the closest folder that exists: an ext4 that met an error refuses files, though it is still
    mounted for writing. Does not report a full disk, and tries nothing in a bucket.
    """
    if in_bucket(url):
        return None
    path = Path(url).absolute()
    try:
        with TemporaryFile(dir=next(folder for folder in (path, *path.parents) if folder.exists())):
            return None
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            return error.strerror or type(error).__name__
        return None


def delete(url: str, key: str) -> None:
    """Remove a key of a store, if it exists."""
    with suppress(FileNotFoundError, NotADirectoryError):
        if in_bucket(url):
            with _bucket(url) as bucket:
                bucket.delete(key)
        elif _link(Path(url, key), key.count("/")) is None:
            clear(Path(url, key))


def names_in(url: str) -> list[str]:
    """Sorted names directly in a folder, or under a prefix of a bucket; none if it is missing."""
    if in_bucket(url):
        with _bucket(url) as bucket:
            listed = bucket.list_with_delimiter()
        paths = [*listed["common_prefixes"], *(entry["path"] for entry in listed["objects"])]
        return sorted(path.rstrip("/").rsplit("/", 1)[-1] for path in paths)
    try:
        return sorted(path.name for path in Path(url).iterdir())
    except FileNotFoundError:
        return []


def remove(url: str) -> None:
    """Remove everything under an address, if it exists; a folder goes at once, by renaming it."""
    if in_bucket(url):
        with _bucket(url) as bucket:
            for entries in bucket.list():
                bucket.delete([entry["path"] for entry in entries])
        return
    renamed = Path(f"{url}{DELETED}")
    if Path(url).is_symlink():
        Path(url).unlink()  # what it leads to is another's
    clear(renamed)  # of an interrupted removal
    with suppress(FileNotFoundError):
        Path(url).rename(renamed)
        sync(renamed.parent)
        clear(renamed)


@contextmanager
def _bucket(url: str, *further: type[Exception]) -> Iterator["S3Store"]:
    """The client of a bucket's prefix. Raises Unreachable for the client's errors and `further` ones."""
    errors: tuple[type[Exception], ...] = (_obstore().exceptions.BaseError, *further)
    try:
        yield _client(url)
    except errors as error:
        line = re.sub(r"\s*(?:<\?xml.*?<Message>(.*?)</Message>|<\?xml|\n).*", r" \1", str(error), flags=re.S)
        raise Unreachable(line.rstrip(" :")) from None


@lru_cache(maxsize=256)
def _client(url: str) -> "S3Store":
    """Client of a bucket's prefix, cached with its connections."""
    store: S3Store = _obstore().store.S3Store.from_url(url, retry_config={"retry_timeout": _RETRY_TIMEOUT})
    return store


def _obstore() -> Any:
    try:
        import obstore.exceptions  # noqa: PLC0415 - comes with the extra `s3`
        import obstore.store  # noqa: PLC0415
    except ImportError as error:
        raise StoreError('stores in a bucket need the extra s3: pip install -e ".[s3]"') from error
    return obstore


@cache
def pool() -> ThreadPoolExecutor:
    """Threads for syncs and requests."""
    return ThreadPoolExecutor(_THREADS, thread_name_prefix="store")
