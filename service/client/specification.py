"""What `Client.submit` accepts, turned into the JSON body the service takes.

The service is the judge of a specification; here only what cannot be read or written as JSON is refused.
"""

import json
import math
from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Protocol, TypeAlias, runtime_checkable

from service.client.errors import FieldProblem, InvalidSpecification


@runtime_checkable
class Dumpable(Protocol):
    """A pydantic model, such as `worker.spec.SweepSpec`, without importing either."""

    def model_dump(self, *, mode: str) -> dict[str, Any]:
        """The model as plain JSON values."""


Specification: TypeAlias = Mapping[str, Any] | str | PathLike[str] | Dumpable


def body(spec: Specification) -> bytes:
    """The specification as a JSON body: a mapping (numpy values allowed), a `SweepSpec`, or a file's path.

    Raises InvalidSpecification naming the field for a number that is not finite or a value JSON has no
    form for, and naming the file if it cannot be read as .json or .toml.
    """
    try:
        return json.dumps(_plain(_given(spec), "")).encode()
    except RecursionError:
        raise InvalidSpecification.local("the specification is nested too deeply") from None
    except ValueError as error:  # an integer of thousands of digits
        raise InvalidSpecification.local(f"the specification cannot be written as JSON: {error}") from error


def read(source: Path | bytes) -> Mapping[str, Any]:
    """The object in a .json or .toml file, or in JSON text. Raises InvalidSpecification."""
    from worker.spec import errors, parsing

    where = "" if isinstance(source, bytes) else f"{source}: "
    try:
        content = parsing.read_json(source) if isinstance(source, bytes) else parsing.read_file(source)
    except errors.SpecUnreadable as error:
        raise InvalidSpecification.local(where + str(error).removeprefix(where)) from error
    if not isinstance(content, Mapping):
        found = errors.describe(content)
        raise InvalidSpecification.local(f"{where}a specification must be an object, not {found}")
    return content


def _given(spec: Specification) -> object:
    if isinstance(spec, Mapping):
        return spec
    if isinstance(spec, Dumpable):
        return spec.model_dump(mode="json")
    if isinstance(spec, str | PathLike):
        return read(Path(fspath(spec)))
    raise InvalidSpecification.local(
        f"a specification is a mapping, a SweepSpec or a file's path, not {type(spec).__name__}"
    )


def _plain(value: object, field: str) -> object:
    """The value in JSON's own types; `field` is its path, such as `gamma.start`."""
    if isinstance(value, Mapping):
        return {str(name): _plain(item, f"{field}.{name}".lstrip(".")) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, f"{field}[{index}]") for index, item in enumerate(value)]
    if hasattr(value, "tolist"):  # numpy's arrays and scalars
        return _plain(value.tolist(), field)
    if isinstance(value, float) and not math.isfinite(value):
        raise _refused(field, f"must be finite, not {value}")
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise _refused(field, f"must be a number, text, a list or a mapping, not {type(value).__name__}")


def _refused(field: str, rule: str) -> InvalidSpecification:
    return InvalidSpecification.local(f"{field}: {rule}", (FieldProblem(field, rule),))
