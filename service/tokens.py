"""Access tokens, files of named tokens, and the address and token of a user's own service.

A service records its address in a file of its data folder, where commands of the same user find it. It locks
the file, so that one left by a killed service does not count. With `token=auto` its token is beside it.
Imports only the standard library, because clients do, and every command may look for a service.
"""

import fcntl
import json
import os
import re
import secrets
import stat
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from typing import IO, Final
from urllib.parse import urlsplit

from worker.files import complete_file

#: Stands for a token that the service creates and its clients look up.
AUTO: Final = "auto"

#: Fewest characters of an access token; a shorter one could be guessed.
MIN_LENGTH: Final = 16
RULE: Final = f"must be at least {MIN_LENGTH} ASCII characters without spaces"

#: Files of the data folder with the token that the service created, and with its address.
FILE_NAME: Final = "token.json"
ADDRESS_FILE: Final = "service.json"

#: The address of a service by default.
DEFAULT_URL: Final = "http://127.0.0.1:8000"
#: Addresses that stand for every interface, and the local address of such a service.
_EVERY: Final = {"http://0.0.0.0:": "http://127.0.0.1:", "http://[::]:": "http://[::1]:"}

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,63}")
_OTHERS: Final = 0o077
_MAX_BYTES: Final = 1_000_000


class TokenFileUnusable(Exception):
    """A file of tokens breaks a rule; the text names the file and the line, and shows no token."""


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach the address `host`."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def is_valid(token: str) -> bool:
    """Whether a text follows the rule of access tokens."""
    return len(token) >= MIN_LENGTH and token.isascii() and token.isprintable() and " " not in token


def read_tokens(path: Path, *, private: bool) -> dict[str, str]:
    """The tokens of a file by name. Each line is `NAME: TOKEN`; empty lines and `#` comments are ignored.

    `private`: the file must be closed to other users. Raises TokenFileUnusable.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # does not wait for the writer of a pipe
        os.set_blocking(descriptor, True)
        with open(descriptor, "rb") as file:  # noqa: PTH123 - a descriptor, not a path
            status, content = os.fstat(file.fileno()), file.read(_MAX_BYTES)
        lines = content.decode("ascii").splitlines()
    except OSError as error:
        raise TokenFileUnusable(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise TokenFileUnusable(f"{path} must be ASCII text") from None
    if private and status.st_mode & _OTHERS:
        mode = stat.S_IMODE(status.st_mode)
        raise TokenFileUnusable(
            f"{path} is open to other users (mode {mode:04o}): close it with `chmod 600 {path}`"
        )
    tokens: dict[str, str] = {}
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        name, token = (part.strip() for part in (*line.split(":", 1), "")[:2])
        if problem := _problem(name, token, tokens):
            raise TokenFileUnusable(f"{path}, line {number}: {problem}")
        tokens[name] = token
    if not tokens:
        raise TokenFileUnusable(f"{path} holds no token: add a line NAME: TOKEN")
    return tokens


def _problem(name: str, token: str, tokens: dict[str, str]) -> str | None:
    """The rule that a line breaks, or None. Quotes the name, which is no secret, unless it may be a token."""
    if not token:
        return "must be NAME: TOKEN"
    if not _NAME.fullmatch(name):
        return "the name must be at most 64 letters, digits or ._@- and begin with a letter or digit"
    if not is_valid(token):
        return f"the token of {name} {RULE}"
    if name in tokens:
        return f"the name {name} is given twice"
    if token in tokens.values():
        return f"the token of {name} is that of another name too"
    return None


def own_token(folder: Path) -> str:
    """The token that the service of a data folder has created, or a new one. Raises OSError.

    Only this user can read its file.
    """
    token = _read_text(folder / FILE_NAME, "token")
    if token is not None and is_valid(token):
        return token
    token = secrets.token_urlsafe(32)
    with complete_file(folder / FILE_NAME, private=True) as file:
        file.write(json.dumps({"token": token}).encode())
    return token


def find_token(port: int, folder: Path | None = None) -> str | None:
    """The token of this user's own service on `port` of this machine; None if there is no such service.

    Looks in the data folder, by default BOUNCE_DATA or ./bounce-data. A token is sent to no other service,
    and another user's file is ignored.
    """
    folder = folder or data_folder()
    url = find_service(folder)
    if url is None or urlsplit(url).port != port:
        return None
    token = _read_text(folder / FILE_NAME, "token")
    return token if token is not None and is_valid(token) else None


def data_folder() -> Path:
    """The folder where clients look for a service: BOUNCE_DATA, by default ./bounce-data."""
    return Path(os.environ.get("BOUNCE_DATA") or "bounce-data")


@contextmanager
def recorder(folder: Path) -> Iterator[Callable[[str], None]]:
    """A function that records the address of this process's service on `folder`. The block's end removes it.

    If the address cannot be written, commands do not find the service.
    """
    path = folder / ADDRESS_FILE
    with ExitStack() as recorded:

        def record(url: str) -> None:
            for wildcard, local in _EVERY.items():
                if url.startswith(wildcard):
                    url = local + url.removeprefix(wildcard)
            with suppress(OSError), complete_file(path, private=True) as file:
                file.write(json.dumps({"url": url}).encode())
                file.flush()
                opened = recorded.enter_context(open(file.name, encoding="ascii"))  # noqa: PTH123
                fcntl.flock(opened, fcntl.LOCK_EX)
                recorded.callback(forget, opened)

        def forget(opened: IO[str]) -> None:
            with suppress(OSError):  # another service may have taken the folder
                if os.path.samestat(path.stat(), os.fstat(opened.fileno())):
                    path.unlink()

        yield record


def find_service(folder: Path) -> str | None:
    """The address of this user's running service on `folder`; None if there is none."""
    return _read_text(folder / ADDRESS_FILE, "url", locked=True)


def default_url() -> str:
    """The address of clients: BOUNCE_URL, else that of the service on the data folder, else the usual one."""
    return os.environ.get("BOUNCE_URL") or find_service(data_folder()) or DEFAULT_URL


def _read_text(path: Path, name: str, *, locked: bool = False) -> str | None:
    """A text in a private file of JSON; None if it is not this user's, or, with `locked`, not locked."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        # does not block on a pipe in its place
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
        with open(descriptor, encoding="ascii") as file:  # noqa: PTH123 - a descriptor, not a path
            status = os.fstat(descriptor)
            if status.st_uid != os.geteuid() or status.st_mode & _OTHERS or (locked and not _is_locked(file)):
                return None
            text = json.loads(file.read(_MAX_BYTES))[name]
            return text if isinstance(text, str) else None
    return None


def _is_locked(file: IO[str]) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:  # by a running service
        return True
    return False
