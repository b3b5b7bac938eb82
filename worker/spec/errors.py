"""Errors of a specification, one line per problem: the field, the rule, and the nearest valid value.

ValueError
├── SpecError               a specification cannot be used; `problems` lists why
│   ├── SpecUnreadable      the text is not JSON or TOML
│   ├── SpecInvalid         a field breaks a rule
│   └── SpecTooLarge        the sweep has more cells or bytes than allowed
└── BrokenRuleError         raised by validators; converted to SpecInvalid
"""

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple

from pydantic import ValidationError

#: One entry of `ValidationError.errors()`: type, loc, msg, input, ctx.
_Entry = Mapping[str, Any]

#: Problems listed in one error; the others are only counted.
MAX_PROBLEMS: Final = 20


_DESCRIPTIONS: Final[tuple[tuple[type, Callable[[Any], str]], ...]] = (
    (type(None), lambda _: "null"),
    (bool, lambda value: "true" if value else "false"),
    (int, repr),
    (float, repr),
    (str, lambda value: f"text {_shorten(ascii(value))}"),
    (dict, lambda _: "an object"),
    (list, lambda value: f"a list of {len(value)}"),
    (tuple, lambda value: f"a list of {len(value)}"),
)


#: Kind of a broken rule, for programs: the field is missing, unknown, or of another type; else "rule".
Code = Literal["missing", "unknown", "type", "rule"]


class Problem(NamedTuple):
    """One broken rule. `field` is a path such as `gamma.num` or `gamma[3]`; empty for the specification."""

    field: str
    rule: str
    code: Code = "rule"

    def __str__(self) -> str:
        return f"{self.field}: {self.rule}" if self.field else self.rule


class SpecError(ValueError):
    """A specification that cannot be used; `problems` lists the broken rules."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__(self.problems)

    def __str__(self) -> str:
        return "\n".join(map(str, self.problems))


class SpecUnreadable(SpecError):
    """The text is not JSON or TOML."""


class SpecInvalid(SpecError):
    """A field breaks a rule."""


class SpecTooLarge(SpecError):
    """The sweep has more cells or stored bytes than allowed."""


class BrokenRuleError(ValueError):
    """Raised inside a validator; `field` is relative to the validated value."""

    def __init__(self, field: str, rule: str, code: Code = "rule") -> None:
        super().__init__(rule)
        self.field = field
        self.rule = rule
        self.code = code


def describe(value: object) -> str:
    """A short printable description of an invalid value, for error messages."""
    if isinstance(value, int) and value.bit_length() > 128:
        return f"a whole number of about {round(value.bit_length() * 0.30103)} digits"
    for kind, description in _DESCRIPTIONS:
        if isinstance(value, kind):
            return description(value)
    return _shorten(f"a value of type {type(value).__name__}")


def one_of(names: Iterable[str]) -> str:
    """`'a', 'b' or 'c'`."""
    quoted = [f"'{name}'" for name in names]
    return " or ".join(filter(None, [", ".join(quoted[:-1]), quoted[-1]]))


def did_you_mean(wrong: object, names: Iterable[str]) -> str:
    """`; did you mean 'name'?` with the name closest to `wrong`; empty if none is close."""
    close = difflib.get_close_matches(wrong.lower(), list(names), n=1) if isinstance(wrong, str) else []
    return f"; did you mean '{close[0]}'?" if close else ""


def problems_of(error: ValidationError, fields: Mapping[str, Sequence[str]]) -> list[Problem]:
    """Convert pydantic's errors to at most MAX_PROBLEMS problems and one that counts the others.

    fields: the field names of every object by its tag or name; `""` is the specification itself. Tags of
    unions look like `<range>` and are not part of a field's path.
    """
    entries = error.errors(include_url=False)
    problems = [_problem(entry, fields) for entry in entries[:MAX_PROBLEMS]]
    if len(entries) > MAX_PROBLEMS:
        problems.append(Problem("", f"and {len(entries) - MAX_PROBLEMS} more problems"))
    return problems


def _shorten(text: str, limit: int = 40) -> str:
    return text if len(text) <= limit else text[: limit - 3] + "..."


def _is_tag(part: object) -> bool:
    return isinstance(part, str) and part.startswith("<")


def _path(parts: Iterable[int | str]) -> str:
    path = ""
    for part in parts:
        if isinstance(part, int):
            path += f"[{part}]"
        elif not _is_tag(part):
            name = part if part.isidentifier() and len(part) <= 40 else _shorten(ascii(part))
            path += f".{name}" if path else name
    return path


def _problem(entry: _Entry, fields: Mapping[str, Sequence[str]]) -> Problem:
    location = list(entry["loc"])
    cause = entry.get("ctx", {}).get("error")
    if isinstance(cause, BrokenRuleError):
        return Problem(_path([*location, *filter(None, cause.field.split("."))]), cause.rule, cause.code)
    if entry["type"] == "extra_forbidden":
        owner = next((part for part in reversed(location[:-1]) if part in fields), "")
        return Problem(_path(location), _unknown(location[-1], fields[str(owner)]), "unknown")
    rule = _RULES.get(entry["type"])
    text = rule(entry) if rule else _shorten(str(entry["msg"]), 200)
    return Problem(_path(location), text, code_of(entry["type"]))


def code_of(kind: str) -> Code:
    """The code of a pydantic error type."""
    if kind.endswith(("_type", "_parsing")):
        return "type"
    codes: dict[str, Code] = {"missing": "missing", "extra_forbidden": "unknown"}
    return codes.get(kind, "rule")


def _unknown(name: object, known: Sequence[str]) -> str:
    return f"is not a field here{did_you_mean(name, known) or ';'} the fields are {', '.join(known)}"


def _literal(entry: _Entry) -> str:
    expected, value = entry["ctx"]["expected"], entry["input"]
    hint = did_you_mean(value, expected.split("'")[1::2])
    return f"must be {expected}, not {describe(value)}{hint}"


def _bound(phrase: str, key: str) -> Callable[[_Entry], str]:
    return lambda entry: f"must be {phrase} {entry['ctx'][key]:g}, not {describe(entry['input'])}"


_RULES: Final[dict[str, Callable[[_Entry], str]]] = {
    "missing": lambda _: "is required",
    "float_type": lambda e: f"must be a number, not {describe(e['input'])}",
    "int_type": lambda e: f"must be a whole number, not {describe(e['input'])}",
    "bool_type": lambda e: f"must be true or false, not {describe(e['input'])}",
    "string_type": lambda e: f"must be text, not {describe(e['input'])}",
    "string_unicode": lambda _: "must be text that UTF-8 can write, without lone surrogates",
    "string_too_long": lambda e: (
        f"must have at most {e['ctx']['max_length']} characters, not {len(e['input'])}"
    ),
    "string_pattern_mismatch": lambda e: f"must match {e['ctx']['pattern']}, not {describe(e['input'])}",
    "model_type": lambda e: f"must be an object, not {describe(e['input'])}",
    "finite_number": lambda e: f"must be finite, not {describe(e['input'])}",
    "literal_error": _literal,
    "greater_than": _bound("above", "gt"),
    "greater_than_equal": _bound("at least", "ge"),
    "less_than": _bound("below", "lt"),
    "less_than_equal": _bound("at most", "le"),
}
