"""Errors of a specification, one line per problem: the field, the rule, and the nearest valid value."""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

if TYPE_CHECKING:
    from pydantic import ValidationError

#: Problems listed in one error; the others are only counted.
MAX_PROBLEMS: Final = 20


#: Kind of a broken rule, for programs: the field is missing, unknown, or of another type; else "rule".
Code = Literal["missing", "unknown", "type", "rule"]


class Problem(NamedTuple):
    """One broken rule. `field` is a path such as `gamma.num` or `gamma[3]`; empty for the specification."""

    field: str
    rule: str
    code: Code = "rule"

    def __str__(self) -> str:
        return f"{self.field}: {self.rule}" if self.field else self.rule


class BounceError(Exception):
    """Root of the exceptions raised on purpose by client and service; the message is fit for users."""

    def __reduce__(self) -> tuple[Any, ...]:  # by default Python repeats the call with other arguments
        return type(self).__new__, (type(self),), self.__dict__ | {"args": self.args}


class SpecError(BounceError, ValueError):
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
    """The study has more cells, stored bytes or core-seconds than allowed."""


class BrokenRuleError(ValueError):
    """Raised inside a validator, converted to SpecInvalid; `field` is relative to the validated value."""

    def __init__(self, field: str, rule: str, code: Code = "rule") -> None:
        super().__init__(rule)
        self.field = field
        self.rule = rule
        self.code = code


def describe(value: object) -> str:
    """A short printable description of an invalid value, for error messages."""
    match value:
        case None | True | False:
            text = {None: "nothing", True: "true", False: "false"}[value]
        case int() if value.bit_length() > 128:
            text = f"a whole number of about {round(value.bit_length() * 0.30103)} digits"
        case int():
            text = repr(value)
        case float():
            text = f"{value:g}" if float(f"{value:g}") == value else repr(value)
        case str():
            text = f"text {_shorten(repr(value))}"
        case dict():
            text = "a group of fields"
        case list() | tuple():
            text = f"a list of {len(value)}"
        case _:
            text = _shorten(f"a value of type {type(value).__name__}")
    return text


def one_of(names: Iterable[str]) -> str:
    """`'a', 'b' or 'c'`."""
    quoted = [f"'{name}'" for name in names]
    return " or ".join(filter(None, [", ".join(quoted[:-1]), quoted[-1]]))


#: Fields by other words for them.
_MEANT: Final = {"γ": "gamma", "ω": "omega", "ξ": "xi", "step": "num"}


def did_you_mean(wrong: object, names: Iterable[str]) -> str:
    """`; did you mean 'name'?` with the name closest to `wrong`; empty if none is close."""
    if not isinstance(wrong, str):
        return ""
    names, meant = list(names), _MEANT.get(wrong.lower(), "")
    close = [meant] if meant in names else difflib.get_close_matches(wrong.lower(), names, n=1)
    return f"; did you mean '{close[0]}'?" if close else ""


def problems_of(error: "ValidationError", fields: Mapping[str, Sequence[str]]) -> list[Problem]:
    """Convert pydantic's errors to at most MAX_PROBLEMS problems and one that counts the others.

    fields: the field names of every object by its tag or name; `""` is the specification itself. Tags of
    unions look like `<range>` and are not part of a field's path.
    """
    # a default that depends on a wrong field is not a second problem
    entries = [entry for entry in error.errors(include_url=False) if "default_factory" not in entry["type"]]
    problems = [_problem(entry, fields) for entry in entries[:MAX_PROBLEMS]]
    if len(entries) > MAX_PROBLEMS:
        problems.append(Problem("", f"and {len(entries) - MAX_PROBLEMS} more problems"))
    return problems


def _shorten(text: str, limit: int = 40) -> str:
    return text if len(text) <= limit else text[: limit - 3] + "..."


def _path(parts: Iterable[int | str]) -> str:
    path = ""
    for part in parts:
        if isinstance(part, int):
            path += f"[{part}]"
        elif not part.startswith("<"):  # a tag
            name = part if part.isidentifier() and len(part) <= 40 else _shorten(repr(part))
            path += f".{name}" if path else name
    return path


def _problem(entry: Mapping[str, Any], fields: Mapping[str, Sequence[str]]) -> Problem:
    location = list(entry["loc"])
    cause = entry.get("ctx", {}).get("error")
    if isinstance(cause, BrokenRuleError):
        return Problem(_path([*location, *filter(None, cause.field.split("."))]), cause.rule, cause.code)
    if entry["type"] == "extra_forbidden":
        known = fields[next((str(part) for part in reversed(location[:-1]) if part in fields), "")]
        hint = did_you_mean(location[-1], known) or ";"
        text = f"is not a field here{hint} the fields are {', '.join(known)}"
        return Problem(_path(location), text, "unknown")
    return Problem(_path(location), rule_of(entry), code_of(entry["type"]))


def rule_of(entry: Mapping[str, Any]) -> str:
    """The rule that an entry of pydantic's errors says is broken, in this project's words."""
    kind, value, context = entry["type"], entry.get("input"), entry.get("ctx", {})
    cause = context.get("error")
    if isinstance(cause, ValueError):
        return str(cause)
    rule = next((text for ends, text in _RULES.items() if kind.endswith(ends)), "is not allowed: {value}")
    length = len(value) if isinstance(value, str) else 0
    # a number of a query is text; in a specification, which is read strictly, text breaks a rule as text
    is_text = kind.endswith(("_type", "literal_error")) or not length or not is_number(str(value))
    shown = describe(value) if is_text else value
    formats = {float: "g", int: ","}
    limits = {name: format(limit, formats.get(type(limit), "")) for name, limit in context.items()}
    text = rule.format(value=shown, length=length, **limits)
    if kind == "literal_error":
        text += did_you_mean(value, context["expected"].split("'")[1::2])
    return text


def is_number(text: str) -> bool:
    """Whether a text is a number of at most 40 characters."""
    try:
        return len(text) <= 40 and float(text) is not None
    except ValueError:
        return False


def code_of(kind: str) -> Code:
    """The code of a pydantic error type."""
    if kind.endswith(("_type", "_parsing")):
        return "type"
    codes: dict[str, Code] = {"missing": "missing", "extra_forbidden": "unknown"}
    return codes.get(kind, "rule")


#: The texts for people, by the endings of pydantic's error types; for fields, queries and settings alike.
_RULES: Final[dict[tuple[str, ...], str]] = {
    ("missing",): "is required",
    ("extra_forbidden",): "is not a parameter here",
    ("float_type", "float_parsing"): "must be a number, not {value}",
    ("int_type", "int_parsing", "int_from_float"): "must be a whole number, not {value}",
    ("bool_type", "bool_parsing"): "must be true or false, not {value}",
    ("date_parsing", "datetime_parsing"): "must be a day such as 2026-11-25, not {value}",
    ("string_type",): "must be text, not {value}",
    ("string_too_short",): "must have at least {min_length} characters, not {length}",
    ("string_unicode",): "must be text that UTF-8 can write, without lone surrogates",
    ("string_too_long",): "must have at most {max_length} characters, not {length}",
    ("string_pattern_mismatch",): "must match {pattern}, not {value}",
    ("list_type", "tuple_type"): "must be a list, not {value}",
    ("path_not_file",): "must be a file that is there, not {value}",
    ("model_type",): "must be a group of fields, not {value}",
    ("finite_number",): "must be finite, not {value}",
    ("literal_error", "enum"): "must be {expected}, not {value}",
    ("greater_than",): "must be above {gt}, not {value}",
    ("greater_than_equal",): "must be at least {ge}, not {value}",
    ("less_than",): "must be below {lt}, not {value}",
    ("less_than_equal",): "must be at most {le}, not {value}",
}
