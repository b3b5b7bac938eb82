"""The specifications of basins and of multistability: a plane of starts in each cell of a grid."""

import math
from typing import Annotated, Any, ClassVar, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from worker.spec.axes import NUMBER, WHOLE, Strict
from worker.spec.contact_models import Auto, Ball, Contact, Soft, Stepped
from worker.spec.errors import BrokenRuleError, SpecError
from worker.spec.specification import Specification
from worker.spec.time_steps import check_steps, corners
from worker.sweep import AXES, SweepSpec
from worker.sweep.specification import (
    Exponents,
    Gamma,
    Keep,
    MicroFlight,
    Observe,
    Omega,
    Periods,
    Settle,
    Xi,
)

#: Maximum starts of a cell, which are computed and stored together, and maximum rows or columns.
MAX_STARTS: Final = 512 * 512
MAX_SIDE: Final = 4096
MAX_HEIGHT: Final = 1e6
#: Maximum drops of a cell in a multistability study.
MAX_DROPS: Final = 1024

#: Maximum plate periods of a start if `settle_until` is null, in multiples of the window.
UNTIL: Final = 10


Side = Annotated[int, Field(ge=1, le=MAX_SIDE), WHOLE]
SideOfDrops = Annotated[int, Field(ge=1, le=MAX_DROPS), WHOLE]


class Plane(Strict):
    """A plane of starts; the protocol's `kind` selects the study.

    drop: rows are heights above the plate, columns the plate's phases at release, relaxed
    and at rest in the laboratory. contact: the states of a spring that sticks at phase 0; rows are its
    elongation beyond the static one, columns the velocity of the elongation times omega, each up to `height`
    in both directions.
    """

    MAX_STARTS: ClassVar[int]

    kind: str
    plane: Literal["drop", "contact"] = "drop"
    rows: Side
    columns: Side
    height: Annotated[
        float,
        Field(gt=0.0, le=MAX_HEIGHT, description="The largest of the starts, in plate amplitudes."),
        NUMBER,
    ] = 10.0

    @model_validator(mode="after")
    def _size(self) -> Self:
        if self.rows * self.columns > self.MAX_STARTS:
            fitting = self.MAX_STARTS // self.columns
            rule = f"must be at most {fitting} with {self.columns} columns, not {self.rows}"
            raise BrokenRuleError("rows", f"{rule}: a cell has at most {self.MAX_STARTS:,} starts")
        return self

    @property
    def row_values(self) -> NDArray[np.float64]:
        """(rows,) heights above the plate, or elongations beyond the static one, in plate amplitudes."""
        middles = (np.arange(self.rows) + 0.5) * (self.height / self.rows)
        return np.asarray(middles if self.plane == "drop" else 2.0 * middles - self.height)

    @property
    def column_values(self) -> NDArray[np.float64]:
        """(columns,) phases in rad, or velocities of the elongation times omega in plate amplitudes."""
        if self.plane == "drop":
            return np.asarray(2.0 * math.pi * np.arange(self.columns) / self.columns)
        middles = (2.0 * np.arange(self.columns) + 1.0) * (self.height / self.columns)
        return np.asarray(middles - self.height)


class Basin(Plane):
    """The protocol of basins: which attractor each start of the plane reaches."""

    MAX_STARTS: ClassVar = MAX_STARTS

    kind: Literal["basin"]
    rows: Side = 128
    columns: Side = 128


class Multistability(Plane):
    """The protocol of multistability: attractors that drops find, followed through the grid."""

    MAX_STARTS: ClassVar = MAX_DROPS

    kind: Literal["multistability"]
    plane: Literal["drop"] = "drop"
    rows: SideOfDrops = 4
    columns: SideOfDrops = 6


class GridSpec(Specification):
    """A grid of cells, the plane of starts, and the window of each start. Fields as in a `SweepSpec`."""

    AXES: ClassVar = AXES

    gamma: Gamma
    omega: Omega
    xi: Xi
    protocol: Plane
    model: Contact = Soft()
    settle: Settle
    observe: Observe
    keep: Keep = 64
    micro_flight: MicroFlight = 0.05
    settle_until: Annotated[
        Periods | None,
        Field(
            description="Starts that still settle go on, up to this many plate periods; left out: "
            f"{UNTIL} windows, or more where what is transient needs it."
        ),
    ] = None

    @model_validator(mode="after")
    def _rules(self) -> Self:
        if isinstance(self.model, Auto):
            study = self.protocol.kind
            rule = f"must be 'soft', 'stepped', 'rigid' or 'ball' for {study}: no model is chosen for it"
            raise BrokenRuleError("model.kind", rule)
        if isinstance(self.model, Ball) and self.protocol.plane == "contact":
            rule = "must be 'drop' where model.kind is 'ball': it has no spring"
            raise BrokenRuleError("protocol.plane", rule)
        self._check_until()
        try:
            self.sweep()
        except SpecError as error:
            raise BrokenRuleError(*error.problems[0]) from error
        return self

    def _check_until(self) -> None:
        """Raise BrokenRuleError unless `settle_until` allows another window after the first."""
        effective = self.settle + 2 * self.observe
        if self.settle_until is not None and self.settle_until < effective:
            needed = f"must be at least settle + 2 × observe, {effective:,}, to have an effect"
            raise BrokenRuleError("settle_until", f"{needed}; or leave it out")
        if isinstance(self.model, Stepped) and self.settle_until is not None:
            check_steps(self.model, corners(self), self.until)

    @property
    def until(self) -> int:
        """Maximum plate periods of a start."""
        return self.settle_until or UNTIL * (self.settle + self.observe)

    def sweep(self) -> SweepSpec:
        """The sweep of these cells with this window, from rest, every cycle computed. Raises SpecInvalid."""
        fields: dict[str, Any] = {
            name: getattr(self, name)
            for name in type(self).model_fields
            if name not in ("name", "protocol", "settle_until")
        }
        return SweepSpec(**fields)


class BasinSpec(GridSpec):
    """Basins: `keep` flights of each attractor are stored."""

    protocol: Basin
    settle: Settle = 500
    observe: Observe = 60
    exponents: Exponents = 0


class MultistabilitySpec(GridSpec):
    """Multistability: `keep` flights of each attractor are stored."""

    protocol: Multistability
    settle: Settle = 800
    observe: Observe = 150
    keep: Keep = 16
