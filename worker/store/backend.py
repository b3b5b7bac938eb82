"""Room: where a store is: a folder of this machine, or a prefix of an S3-compatible bucket.

The one place that knows what kinds of address there are. A folder is a path; a bucket is
s3://BUCKET/PREFIX, reached as the AWS_* variables of the environment say (region, endpoint,
keys), which service and workers must share.
"""

import shutil
from contextlib import suppress
from datetime import timedelta
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit
from uuid import uuid4

from zarr.abc.store import Store
from zarr.storage import LocalStore, ObjectStore

from worker.store.errors import PlaceUnusable

if TYPE_CHECKING:
    from obstore.store import S3Store

#: What is raised for a bucket that does not answer, or refuses.
UNREACHABLE: tuple[type[Exception], ...] = ()
with suppress(ImportError):  # an extra
    from obstore.exceptions import BaseError

    UNREACHABLE = (BaseError,)

_BUCKET: Final = "s3://"

#: How long a bucket that does not answer is asked again before that is an error.
_PATIENCE: Final = timedelta(seconds=15)


def in_bucket(url: str) -> bool:
    """Whether the address is in a bucket."""
    return url.startswith(_BUCKET)


def check_address(url: str) -> None:
    """Raise PlaceUnusable for an address that no store can have."""
    if not in_bucket(url):
        if "://" in url:
            raise PlaceUnusable(f"{url}: only folders and s3://BUCKET/PREFIX can hold stores")
        return
    if not urlsplit(url).netloc:
        raise PlaceUnusable(f"{url}: a place in a bucket reads s3://BUCKET/PREFIX")
    _obstore()


def open_store(url: str, *, read_only: bool) -> Store:
    """The keys and values under an address, for zarr. Raises PlaceUnusable."""
    check_address(url)
    if in_bucket(url):
        return ObjectStore(_bucket(url), read_only=read_only)
    return LocalStore(Path(url), read_only=read_only)


def read_key(url: str, key: str) -> bytes | None:
    """What lies under a key of a store; None if nothing does."""
    try:
        if in_bucket(url):
            return bytes(_bucket(url).get(key).bytes())
        return (Path(url) / key).read_bytes()
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return None


def delete(url: str, key: str) -> None:
    """Remove what lies under a key of a store; no harm if nothing does."""
    try:
        if in_bucket(url):
            _bucket(url).delete(key)
        else:
            (Path(url) / key).unlink()
    except FileNotFoundError:
        pass


def rename_for_deletion(url: str) -> str:
    """Make an address free at once, for its content to be removed where it is now; in a bucket, it stays."""
    if in_bucket(url) or not Path(url).exists():
        return url
    return str(Path(url).rename(f"{url}.deleted-{uuid4().hex}"))


def remove(url: str) -> None:
    """Remove everything under an address; no harm if there is nothing."""
    if in_bucket(url):
        bucket = _bucket(url)
        for found in bucket.list():
            bucket.delete([entry["path"] for entry in found])
    elif Path(url).exists():
        shutil.rmtree(url)


def put_mark(url: str) -> None:
    """Leave an empty file at an address; what is above it need not exist yet."""
    if in_bucket(url):
        above, name = url.rsplit("/", 1)
        _bucket(above).put(name, b"")
        return
    Path(url).parent.mkdir(parents=True, exist_ok=True)
    Path(url).touch()


def clear_mark(url: str) -> None:
    """Take the file away; no harm if there is none."""
    if not in_bucket(url):
        Path(url).unlink(missing_ok=True)
    elif has_mark(url):
        above, name = url.rsplit("/", 1)
        _bucket(above).delete(name)


def has_mark(url: str) -> bool:
    """Whether the file is there."""
    if not in_bucket(url):
        return Path(url).exists()
    above, name = url.rsplit("/", 1)
    try:
        _bucket(above).head(name)
    except FileNotFoundError:
        return False
    return True


@lru_cache(maxsize=256)
def _bucket(url: str) -> "S3Store":
    """A prefix of a bucket; the connections behind it are kept."""
    store: S3Store = _obstore().S3Store.from_url(url, retry_config={"retry_timeout": _PATIENCE})
    return store


def _obstore() -> Any:
    try:
        import obstore.store  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise PlaceUnusable('stores in a bucket need the extra s3: pip install -e ".[s3]"') from error
    return obstore.store
