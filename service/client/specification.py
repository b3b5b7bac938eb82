"""Turns what `Client.submit` accepts into the JSON body of the request.

The service validates specifications. The client rejects only what it cannot read or write as JSON.
"""

import json
import math
from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from service.client.errors import InvalidSpecification
from worker.spec.errors import Problem as FieldProblem

if TYPE_CHECKING:
    from worker.spec.specification import Specification as Model

#: A mapping, a file's path, or a model such as `SweepSpec`.
Specification: TypeAlias = "Mapping[str, Any] | str | PathLike[str] | Model"


def body(spec: Specification) -> bytes:
    """The JSON body of a specification: a mapping (numpy values allowed), a `SweepSpec`, or a file's path.

    Raises InvalidSpecification naming the field for a number that is not finite or a value that JSON cannot
    express, and naming the file if it cannot be read as JSON or TOML.
    """
    try:
        return json.dumps(_json_value(_content(spec), "")).encode()
    except RecursionError:
        raise InvalidSpecification.before_sending("the specification is nested too deeply") from None
    except ValueError as error:  # an integer of thousands of digits
        message = f"the specification cannot be written as JSON: {error}"
        raise InvalidSpecification.before_sending(message) from error


def read(source: Path | bytes) -> Mapping[str, Any]:
    """The object in a JSON or TOML file, or in JSON text. Raises InvalidSpecification."""
    from worker.spec import errors, parsing

    prefix = "" if isinstance(source, bytes) else f"{source}: "
    try:
        content = parsing.read_json(source) if isinstance(source, bytes) else parsing.read_file(source)
    except errors.SpecUnreadable as error:
        raise InvalidSpecification.before_sending(prefix + str(error).removeprefix(prefix)) from error
    if not isinstance(content, Mapping):
        kind = errors.describe(content)
        raise InvalidSpecification.before_sending(
            f"{prefix}a specification must be a group of fields, not {kind}"
        )
    return content


def _content(spec: Specification) -> object:
    if isinstance(spec, Mapping):
        return spec
    if isinstance(spec, str | PathLike):
        return read(Path(fspath(spec)))
    if hasattr(spec, "model_dump"):
        return spec.model_dump(mode="json")
    raise InvalidSpecification.before_sending(
        f"a specification is a mapping, a SweepSpec or a file's path, not {type(spec).__name__}"
    )


def _json_value(value: object, field: str) -> object:
    """The value in JSON's own types; `field` is its path, such as `gamma.start`."""
    if hasattr(value, "model_dump") and not isinstance(value, type):  # a Range, a contact
        value = value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return {str(name): _json_value(item, f"{field}.{name}".lstrip(".")) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(item, f"{field}[{index}]") for index, item in enumerate(value)]
    if hasattr(value, "tolist"):  # numpy's arrays and scalars
        return _json_value(value.tolist(), field)
    if isinstance(value, float) and not math.isfinite(value):
        raise _invalid(field, f"must be finite, not {value}")
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise _invalid(field, f"must be a number, a list or a mapping, not {type(value).__name__}")


def _invalid(field: str, rule: str) -> InvalidSpecification:
    return InvalidSpecification.before_sending(f"{field}: {rule}", (FieldProblem(field, rule),))
