"""Room: the sweep specification, the contract between client, service and workers.

Imports pydantic, numpy, what of the kernel needs no numba, and its neighbours in worker only: a
client that holds a specification loads no kernel, no cluster and no store.
"""

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Final, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    Field,
    ValidationError,
    model_validator,
)

from worker.spec import parsing
from worker.spec.axes import NUMBER, WHOLE, Axis, AxisValue, Range, Strict, values_of, within
from worker.spec.contact_models import (
    MAX_PENETRATION,
    MIN_PENETRATION,
    Contact,
    Soft,
    Stepped,
    model_fields,
    penetration_of,
)
from worker.spec.errors import BrokenRuleError, Problem, SpecInvalid, describe, one_of, problems_of
from worker.spec.protocols import Protocol, Ramp, Rest
from worker.spec.time_steps import check_steps, corners

#: The sweep's axes in the order the store keeps them, slowest first.
AXES: Final = ("xi", "omega", "gamma")

#: Far beyond what physics asks for, well inside what double precision carries.
SMALLEST: Final = 1e-6
LARGEST: Final = 1e6
MAX_PERIODS: Final = 10_000_000
MAX_KEEP: Final = 10_000


def _label(name: str) -> str:
    if not name.isprintable():
        raise BrokenRuleError("", "must be one line of printable characters")
    return name


class SweepSpec(Strict):
    """A parameter study: which cells, started how, computed by which model, recorded how long.

    `SweepSpec(gamma=..., omega=..., xi=...)` raises `SpecInvalid`, which names each field
    and rule. Periods are plate periods; `keep` counts flights; `micro_flight` and
    `settle_tolerance` are in rad.
    """

    name: Annotated[str, Field(max_length=200), AfterValidator(_label)] = ""
    gamma: Annotated[Axis, AfterValidator(within(SMALLEST, LARGEST))]
    omega: Annotated[Axis, AfterValidator(within(SMALLEST, LARGEST))]
    xi: Annotated[Axis, AfterValidator(within(0.0, LARGEST))]
    protocol: Protocol = Rest()
    model: Contact = Soft()
    settle: Annotated[int, Field(ge=0, le=MAX_PERIODS), WHOLE] = 200
    observe: Annotated[int, Field(ge=1, le=MAX_PERIODS), WHOLE] = 100
    keep: Annotated[int, Field(ge=1, le=MAX_KEEP), WHOLE] = 64
    micro_flight: Annotated[float, Field(ge=0.0), NUMBER] = 0.0
    settle_tolerance: Annotated[float, Field(ge=0.0), NUMBER] = 0.0

    def __init__(self, /, **data: object) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise SpecInvalid(problems_of(error, _fields())) from None

    @model_validator(mode="after")
    def _rules(self) -> Self:
        if isinstance(self.protocol, Ramp) and len(self.axis_values(self.protocol.axis)) < 2:
            longer = [axis for axis in AXES if len(self.axis_values(axis)) > 1]
            way_out = f"ramp along {one_of(longer)}" if longer else f"give {self.protocol.axis} a range"
            rule = f"must name an axis of at least 2 values, and {self.protocol.axis} has 1; {way_out}"
            raise BrokenRuleError("protocol.axis", rule)
        self._check_depth()
        if isinstance(self.model, Stepped):
            axes = (self.axis_values(axis) for axis in ("gamma", "omega", "xi"))
            check_steps(self.model, corners(*axes), self.settle + self.observe)
        return self

    def _check_depth(self) -> None:
        """A rest length gives every cell its own contact depth: all of them must be computable."""
        rest_length = getattr(self.model, "rest_length", None)
        if rest_length is None:
            return
        gamma, omega = self.axis_values("gamma"), self.axis_values("omega")
        extremes = penetration_of(self.model, gamma[[-1, 0]], omega[[0, -1]])
        with np.errstate(all="ignore"):  # a subnormal length gives contacts of no depth at all
            low = rest_length * MIN_PENETRATION / extremes[0]
            high = rest_length * MAX_PENETRATION / extremes[1]
        if not low <= rest_length <= high:
            given = f"gives contacts {extremes[0]:.3g} to {extremes[1]:.3g} plate amplitudes deep"
            allowed = f"allowed are {MIN_PENETRATION:g} to {MAX_PENETRATION:g}"
            way_out = f"{low:.3g} to {high:.3g} works" if low <= high else "narrow gamma or omega"
            rule = f"{given}, {allowed}; {way_out}"
            raise BrokenRuleError("model.rest_length", rule)

    @classmethod
    def parse(cls, data: object) -> Self:
        """A specification from plain values (what JSON or TOML hold).

        Raises `SpecInvalid` with every broken rule found.
        """
        if isinstance(data, cls):
            return data
        if not isinstance(data, dict):
            raise SpecInvalid([Problem("", f"a specification must be an object, not {describe(data)}")])
        odd = [key for key in data if not isinstance(key, str) or not key.isprintable()]
        if odd:
            raise SpecInvalid([Problem("", f"field names must be printable text, not {describe(odd[0])}")])
        return cls(**data)

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """A specification from JSON text. Raises `SpecUnreadable` or `SpecInvalid`."""
        return cls.parse(parsing.read_json(text))

    @classmethod
    def from_file(cls, path: str | Path) -> Self:
        """A specification from a .json or .toml file. Raises `SpecUnreadable` or `SpecInvalid`."""
        return cls.parse(parsing.read_file(Path(path)))

    def axis_values(self, axis: str) -> NDArray[np.float64]:
        """The values of "gamma", "omega" or "xi", (n,), strictly increasing."""
        values: AxisValue = getattr(self, axis)
        return values_of(values)

    @property
    def directions(self) -> tuple[str, ...]:
        """The store's first axis: ("rest",), ("up",), ("down",) or ("up", "down")."""
        if isinstance(self.protocol, Rest):
            return ("rest",)
        return ("up", "down") if self.protocol.direction == "both" else (self.protocol.direction,)

    @property
    def ramp_axis(self) -> str | None:
        """The axis a ramp moves along; None from rest."""
        return self.protocol.axis if isinstance(self.protocol, Ramp) else None

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(directions, xi, omega, gamma), computed without computing any value."""
        xi, omega, gamma = (_length(getattr(self, axis)) for axis in AXES)
        return len(self.directions), xi, omega, gamma

    def canonical(self) -> dict[str, Any]:
        """Plain JSON values that decide every stored number: axes spelled out, defaults
        filled in, the label left out; and settling that is not cut short, which older ones never named."""
        unused = set() if self.settle_tolerance > 0.0 else {"settle_tolerance"}
        plain = self.model_dump(exclude={"name", *AXES, *unused})
        return {axis: self.axis_values(axis).tolist() for axis in AXES} | plain

    def as_submitted(self) -> dict[str, Any]:
        """Plain JSON values for people and attributes: ranges stay ranges, the label stays."""
        return self.model_dump(mode="json")

    def job_id(self, kernel_version: str) -> str:
        """32 hex digits: the same canonical specification and kernel version, the same job."""
        text = json.dumps(self.canonical(), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(f"{kernel_version}\n{text}".encode()).hexdigest()[:32]


def _length(axis: AxisValue) -> int:
    if isinstance(axis, Range):
        return axis.num
    return len(axis) if isinstance(axis, tuple) else 1


def _fields() -> dict[str, tuple[str, ...]]:
    """The field names of every object of a specification by its tag, for `errors.problems_of`."""
    return {
        "": tuple(SweepSpec.model_fields),
        "<range>": tuple(Range.model_fields),
        "<rest>": tuple(Rest.model_fields),
        "<ramp>": tuple(Ramp.model_fields),
        **model_fields(),
    }
