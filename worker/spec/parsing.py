"""Strict reading of specification files and request bodies.

Python's own readers accept more than a specification may contain: NaN, repeated keys, integers of any
length. These functions reject all of it with `SpecUnreadable`.
"""

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from worker.spec.errors import Problem, SpecInvalid, SpecUnreadable, describe

MAX_FILE_BYTES: Final = 4_000_000
MAX_TOML_BYTES: Final = 1_000_000  # tomllib is slower than json by a factor of thirty
MAX_DIGITS: Final = 400  # a double has at most 309 before the point


def _unreadable(rule: str) -> SpecUnreadable:
    return SpecUnreadable([Problem("", rule)])


def _decoded(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _unreadable(f"the text is not UTF-8 at byte {error.start}") from None


def _reject_constant(word: str) -> object:
    raise _unreadable(f"{word} is not a number in JSON; leave the value out or give a finite one")


def _whole(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise _unreadable(f"a number of {len(digits)} digits is too long; {MAX_DIGITS} is the most")
    return int(digits)


def _reject_repeated_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for key, value in pairs:
        if key in fields:
            raise _unreadable(f"field {key!r:.80} is given twice; give it once")
        fields[key] = value
    return fields


def read_json(text: str | bytes) -> object:
    """Parse JSON text. Raises `SpecUnreadable` with the line and column of a syntax error."""
    decoded = text if isinstance(text, str) else _decoded(text)
    try:
        return json.loads(
            decoded, parse_constant=_reject_constant, parse_int=_whole,
            object_pairs_hook=_reject_repeated_keys,
        )  # fmt: skip
    except json.JSONDecodeError as error:
        if not decoded.strip():
            raise _unreadable("the text is empty") from None
        rule = "" if decoded.lstrip()[:1] == "{" else "; JSON begins with {; TOML is read by bounce submit"
        raise _unreadable(_syntax("JSON", decoded, error.lineno, error.colno) + rule) from None
    except RecursionError:
        raise _unreadable("the JSON is nested too deeply; a specification needs two levels") from None


def _syntax(format: str, text: str, line: int, column: int) -> str:
    """The message for a syntax error at this line and column, counted from 1."""
    around = text.split("\n")[line - 1][max(column - 3, 0) : column + 1]
    rule = ": a number has a decimal point, no comma" if re.search(r"\d,\d", around) else ""
    return f"the text is not {format} at line {line}, column {column}{rule}"


def fields_of(data: object, what: str) -> dict[str, Any]:
    """The fields of an object, called `what` in errors. Raises `SpecInvalid`."""
    if not isinstance(data, dict):
        raise SpecInvalid([Problem("", f"{what} must be a group of fields, not {describe(data)}")])
    wrong = [key for key in data if not isinstance(key, str) or not key.isprintable()]
    if wrong:
        raise SpecInvalid([Problem("", f"field names must be printable text, not {describe(wrong[0])}")])
    return data


def read_file(path: Path) -> object:
    """Read and parse a .json or .toml file. Raises `SpecUnreadable`, also for a missing file."""
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise _unreadable(f"{path}: a specification file ends in .json or .toml")
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise _unreadable(f"{path}: must be at most {MAX_FILE_BYTES:,} bytes; give long axes as ranges")
        content = path.read_bytes()
    except OSError as error:
        raise _unreadable(f"{path}: {error.strerror or error}") from None
    return reader(content)


def _read_toml(content: bytes) -> object:
    if len(content) > MAX_TOML_BYTES:
        rule = f"a TOML file must be at most {MAX_TOML_BYTES:,} bytes"
        raise _unreadable(f"{rule}; give long axes as ranges, or write JSON")
    text = _decoded(content)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = re.search(r"line (\d+), column (\d+)", str(error))
        lines = text.split("\n")  # an error without a place is at the end
        line, column = (int(place[1]), int(place[2])) if place else (len(lines), len(lines[-1]) + 1)
        if re.search("overwrite|twice|[Dd]uplicate", str(error)):
            raise _unreadable(f"a field is given twice, at line {line}; give it once") from None
        raise _unreadable(_syntax("TOML", text, line, column)) from None
    except (RecursionError, ValueError) as error:
        raise _unreadable(f"the TOML cannot be read: {error}") from None


_READERS: Final[dict[str, Callable[[bytes], object]]] = {".json": read_json, ".toml": _read_toml}
