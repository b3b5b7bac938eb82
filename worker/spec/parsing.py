"""Strict reading of specification files and request bodies.

Python's own readers accept more than a specification may contain: NaN, repeated keys, integers of any
length. These functions reject all of it with `SpecUnreadable`.
"""

import json
import re
import tomllib
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any, Final

import yaml
from yaml.constructor import ConstructorError

from worker.spec.errors import Problem, SpecInvalid, SpecUnreadable, describe

MAX_FILE_BYTES: Final = 4_000_000
MAX_SLOW_BYTES: Final = 1_000_000  # tomllib is slower than json by a factor of thirty, yaml by a thousand
MAX_DIGITS: Final = 400  # a double has at most 309 before the point
#: Names in one dotted key, such as `model.kind`; tomllib takes quadratic time for them.
MAX_KEY_PARTS: Final = 16

#: Tokens of TOML that matter for dotted keys: comments and strings, whose dots do not count, parts of
#: keys, dots, and blanks. An unclosed string reaches to the end of its line or of the text.
_TOML_TOKEN: Final = re.compile(
    r"""(?P<comment>\#[^\n]*)
    |(?P<part>"{3}(?:\\[\s\S]|[^\\])*?(?:"{3}|\Z) | '{3}[\s\S]*?(?:'{3}|\Z)
             |"(?:\\.|[^"\\\n])*(?:"|$) | '[^'\n]*(?:'|$) | [A-Za-z0-9_-]+)
    |(?P<dot>\.) | (?P<blank>[ \t]+) | (?P<other>[\s\S])""",
    re.VERBOSE | re.MULTILINE,
)


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
        raise _unreadable(_syntax("JSON", decoded, error.lineno, error.colno)) from None
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
    """Read and parse a .json, .toml, .yaml or .yml file. Raises `SpecUnreadable`, also for a missing file."""
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise _unreadable(f"{path}: a specification file ends in .json, .toml, .yaml or .yml")
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise _unreadable(f"{path}: must be at most {MAX_FILE_BYTES} bytes; give long axes as ranges")
        content = path.read_bytes()
    except OSError as error:
        raise _unreadable(f"{path}: {error.strerror or error}") from None
    return reader(content)


def _text(content: bytes, format: str) -> str:
    """The text of a file in a format whose reader is slow."""
    if len(content) > MAX_SLOW_BYTES:
        raise _unreadable(
            f"a {format} file must be at most {MAX_SLOW_BYTES} bytes; give long axes as ranges, or write JSON"
        )
    return _decoded(content)


def _read_toml(content: bytes) -> object:
    text = _text(content, "TOML")
    _check_keys(text)
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


def _check_keys(text: str) -> None:
    """Refuse long dotted keys before tomllib reads them. Takes linear time."""
    dots = 0
    for token in _TOML_TOKEN.finditer(text):
        dots = dots + 1 if token.lastgroup == "dot" else dots if token.lastgroup in ("part", "blank") else 0
        if dots >= MAX_KEY_PARTS:
            line = text.count("\n", 0, token.start()) + 1
            raise _unreadable(
                f"a key of more than {MAX_KEY_PARTS} parts at line {line}; a specification needs two, "
                "as model.kind"
            )


class _YamlLoader(yaml.SafeLoader):
    """Numbers, text, lists and mappings of YAML 1.2 only.

    PyYAML reads YAML 1.1, in which 1e-3 is text, 010 is eight and no is false; and it expands aliases, so
    that a short text can become a long list.
    """

    yaml_implicit_resolvers = {}  # noqa: RUF012 - as PyYAML has it

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """PyYAML's, without aliases."""
        if self.check_event(yaml.AliasEvent):
            where = self.get_mark()
            raise ConstructorError(None, None, "aliases are not read; write the value twice", where)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """PyYAML's, refusing repeated keys."""
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                twice = f"field {key.value!r:.80} is given twice; give it once"
                raise ConstructorError(None, None, twice, key.start_mark)
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)


for _name, _pattern, _first in (
    ("null", r"^(?:~|null|)$", ["~", "n", ""]),
    ("bool", r"^(?:true|false)$", ["t", "f"]),
    ("int", r"^[-+]?[0-9]+$", list("-+0123456789")),
    ("float", r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$", list("-+.0123456789")),
):
    _YamlLoader.add_implicit_resolver(f"tag:yaml.org,2002:{_name}", re.compile(_pattern), _first)
_YamlLoader.add_constructor("tag:yaml.org,2002:int", lambda loader, node: _whole(node.value))


def _read_yaml(content: bytes) -> object:
    try:
        return yaml.load(_text(content, "YAML"), _YamlLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        why = f": {error.problem}" if isinstance(error, ConstructorError) else ""
        raise _unreadable(f"the text is not YAML{where}{why}") from None
    except (RecursionError, ValueError) as error:
        raise _unreadable(f"the YAML cannot be read: {error}") from None


_READERS: Final[dict[str, Callable[[bytes], object]]] = {
    ".json": read_json, ".toml": _read_toml, ".yaml": _read_yaml, ".yml": _read_yaml,
}  # fmt: skip
