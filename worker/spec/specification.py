"""The base of every specification: named fields read strictly, axes, and an id from its numbers."""

import hashlib
import json
import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Self
from unicodedata import category

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field

from worker.spec import parsing
from worker.spec.axes import Strict, length_of, values_of
from worker.spec.errors import BrokenRuleError, describe

#: Most combining marks on one letter of a name. No script needs more, and they cover the lines around.
MAX_MARKS: Final = 4

#: Zero-width joiners and non-joiners of words: emoji, Persian and Indic scripts need them.
_JOINERS: Final = re.compile(r"(?<=[^\s\u200c\u200d])[\u200c\u200d]")


def _label(name: str) -> str:
    text, marks = _JOINERS.sub("", name), 0
    if not text.isprintable():
        raise BrokenRuleError("", "must be one line of printable characters")
    for character in text:
        marks = marks + 1 if category(character) in ("Mn", "Me") else 0
        if marks > MAX_MARKS:
            raise BrokenRuleError("", f"must have at most {MAX_MARKS} combining marks in a row")
    return name


#: The name of a study: not part of its identity.
Label = Annotated[str, Field(max_length=200, description="A label for lists."), AfterValidator(_label)]


def _hex(text: object) -> object:
    if isinstance(text, str) and not re.fullmatch("[0-9a-f]{32}", text):
        raise BrokenRuleError("", f"must be the id of a job, 32 hex digits, not {describe(text)}")
    return text


#: The id of a job.
JobId = Annotated[str, Field(pattern="^[0-9a-f]{32}$"), BeforeValidator(_hex)]


class Document(Strict):
    """An object of its own in JSON."""

    #: What errors call it.
    WHAT: ClassVar = "a specification"

    @classmethod
    def parse(cls, data: object) -> Self:
        """From the plain values of JSON or TOML. Raises `SpecInvalid`, which lists every broken rule."""
        return data if isinstance(data, cls) else cls(**parsing.fields_of(data, cls.WHAT))

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """From JSON text. Raises `SpecUnreadable` or `SpecInvalid`."""
        return cls.parse(parsing.read_json(text))


class Specification(Document):
    """The fields of a study; a subclass adds them."""

    #: Names of the fields that are axes, in the order of the store's dimensions, slowest first.
    AXES: ClassVar[tuple[str, ...]]

    name: Label = ""

    @classmethod
    def from_file(cls, path: str | Path) -> Self:
        """A specification from a JSON or TOML file. Raises `SpecUnreadable` or `SpecInvalid`."""
        return cls.parse(parsing.read_file(Path(path)))

    def axis_values(self, axis: str) -> NDArray[np.float64]:
        """The values of an axis by its name, (n,), strictly increasing."""
        return values_of(getattr(self, axis))

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along AXES; allocates no axis values."""
        return tuple(length_of(getattr(self, axis)) for axis in self.AXES)

    @property
    def fills_in(self) -> bool:
        """Whether only some cells are computed, and the others are filled in (`layout.COMPUTED`)."""
        return False

    def left_out(self) -> set[str]:
        """Fields that do not determine the stored numbers, or that are newer and off.

        Job ids made before these fields existed must not change.
        """
        return {"name"}

    def canonical(self) -> dict[str, Any]:
        """Plain JSON values of everything that determines the stored numbers.

        Axes are lists of their values and defaults are filled in.
        """
        plain = self.model_dump(mode="json", exclude={*self.AXES, *self.left_out()})
        return {axis: self.axis_values(axis).tolist() for axis in self.AXES} | plain

    def as_submitted(self) -> dict[str, Any]:
        """Plain JSON values as submitted: ranges stay ranges, and the label is included."""
        return self.model_dump(mode="json")

    def job_id(self, kernel_version: str) -> str:
        """32 hex digits of a hash of the canonical specification and the kernel version."""
        text = json.dumps(self.canonical(), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(f"{kernel_version}\n{text}".encode()).hexdigest()[:32]
