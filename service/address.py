"""The address of a data folder's service, in a file that commands of the same user read.

The service holds a lock on the file, so one left by a killed service does not count. Imports only the
standard library, because every command may look for a service.
"""

import fcntl
import json
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Final

from service.tokens import opened_private, write_private

#: The file of the data folder that holds the address of the service that runs on it.
FILE_NAME: Final = "service.json"

#: Addresses that mean every interface, and the local address of such a service.
_EVERY: Final = {"http://0.0.0.0:": "http://127.0.0.1:", "http://[::]:": "http://[::1]:"}
_MAX_BYTES: Final = 10_000


@contextmanager
def recorder(folder: Path) -> Iterator[Callable[[str], None]]:
    """A function that records the address of this process's service on `folder`; removed after the block.

    If it cannot be written, commands do not find the service.
    """
    with ExitStack() as recorded:

        def record(url: str) -> None:
            with suppress(OSError):
                recorded.enter_context(_recorded(folder / FILE_NAME, url))

        yield record


@contextmanager
def _recorded(path: Path, url: str) -> Iterator[None]:
    for wildcard, local in _EVERY.items():
        if url.startswith(wildcard):
            url = local + url.removeprefix(wildcard)
    held: list[IO[str]] = []
    write_private(path, json.dumps({"url": url}), before_replace=lambda file: held.append(_locked(file)))
    with held[0] as file:
        try:
            yield
        finally:
            with suppress(OSError):  # another service may have taken the folder meanwhile
                if os.path.samestat(path.stat(), os.fstat(file.fileno())):
                    path.unlink()


def _locked(file: Path) -> IO[str]:
    """The file, locked until it is closed."""
    opened = file.open(encoding="ascii")
    fcntl.flock(opened, fcntl.LOCK_EX)
    return opened


def find(folder: Path) -> str | None:
    """The address of this user's running service on `folder`; None if there is none."""
    with suppress(OSError, ValueError, KeyError, TypeError), opened_private(folder / FILE_NAME) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:  # its service runs
            url = json.loads(file.read(_MAX_BYTES))["url"]
            return url if isinstance(url, str) else None
    return None
