"""The sweep specification: the contract between client, service and workers.

It imports pydantic, numpy, and modules of the kernel without numba, so that a client can build a
specification without loading kernels, Dask or zarr.
"""

import itertools
import math
from collections.abc import Iterator, Mapping
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from functools import lru_cache
from typing import Annotated, Any, ClassVar, Final, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from kernel.cycles.starts import stable_ranges, start_on_stable_cycle
from kernel.params import MAX_EXPONENTS, Cell, KernelInputError, Start
from worker.spec.axes import LARGEST, NUMBER, SMALLEST, WHOLE, Axis, within
from worker.spec.contact_models import (
    CONTACT_MODELS,
    MAX_PENETRATION,
    MAX_REST_LENGTH,
    MIN_PENETRATION,
    Auto,
    Contact,
    Soft,
    Stepped,
    penetration_of,
)
from worker.spec.errors import BrokenRuleError, describe, one_of
from worker.spec.refine import EarlierRefine, Refinement
from worker.spec.specification import JobId, Specification
from worker.spec.time_steps import check_steps, corners
from worker.sweep.protocols import Protocol, Ramp, Rest

#: The axes of a sweep in the order of the store's dimensions, slowest first.
AXES: Final = ("xi", "omega", "gamma")

MAX_PERIODS: Final = 10_000_000
MAX_KEEP: Final = 10_000

#: Limit on the lines of a ramp that starts on cycles; each cycle is sought on submission (5 ms).
MAX_STARTS: Final = 1_000

#: Roundings of the ends of a range into it.
_UP, _DOWN = (Context(7, rounding) for rounding in (ROUND_CEILING, ROUND_FLOOR))

#: With "settle": "auto", plate periods before the window of a cell that is not certified, and the default
#: limit for a settling one: 0.2 % of the cells of docs/specification.md's map still settle then.
SETTLE: Final = 200
UNTIL: Final = 5_000

#: Fields of earlier releases: their defaults, which have no effect, and what works instead of other values.
REMOVED: Final[dict[str, tuple[object, str]]] = {
    "settle_early": (True, "settle 'auto' ends a cell as soon as its cycle is certified"),
    "settle_tolerance": (0.0, "settle 'auto' ends a cell as soon as its cycle is certified"),
    "settle_until": (None, "until, with settle 'auto', gives settling cells more plate periods"),
}

Effort = Literal["draft", "standard", "thorough"]

#: The fields of each effort; docs/accuracy.md says what each costs and how much it shows wrong.
EFFORTS: Final[dict[str, dict[str, Any]]] = {
    "draft": {"settle": "auto", "observe": 30, "until": 260},
    "standard": {"settle": "auto", "observe": 100, "until": None},
    "thorough": {"settle": "auto", "observe": 1000, "until": None},
}

#: Contact models that can start on a cycle of the spring.
WITH_CYCLES: Final = ("rigid", "soft", "stepped")


Gamma = Annotated[
    Axis,
    AfterValidator(within(SMALLEST, LARGEST)),
    Field(description="Amplitude of the plate's acceleration over gravity (dimensionless)."),
]
Omega = Annotated[
    Axis,
    AfterValidator(within(SMALLEST, LARGEST)),
    Field(description="Angular frequency of the plate over that of the spring (dimensionless)."),
]
Xi = Annotated[
    Axis,
    AfterValidator(within(0.0, LARGEST)),
    Field(description="Damping ratio of the spring (dimensionless)."),
]
Settle = Annotated[int, Field(ge=0, le=MAX_PERIODS, description="Plate periods before the window."), WHOLE]
Observe = Annotated[int, Field(ge=1, le=MAX_PERIODS, description="Plate periods of the window."), WHOLE]
Keep = Annotated[int, Field(ge=1, le=MAX_KEEP, description="Number of last flights stored."), WHOLE]
MicroFlight = Annotated[
    float, Field(ge=0.0, description="Flights shorter than this are not counted as bounces (rad)."), NUMBER
]
Periods = Annotated[int, Field(ge=1, le=MAX_PERIODS), WHOLE]


def _auto(value: object) -> object:
    if isinstance(value, str) and value != "auto":
        rule = f"must be 'auto' or a whole number of plate periods, not {describe(value)}"
        raise BrokenRuleError("", rule, "type")
    return value


#: Tagged, so that errors name the rule of one of the two.
AutoSettle = Annotated[
    Annotated[Literal["auto"], Tag("<auto>")] | Annotated[Settle, Tag("<periods>")],
    Discriminator(lambda value: "<auto>" if value == "auto" else "<periods>"),
    BeforeValidator(_auto),
    Field(
        description="Plate periods before the window; auto: a cell ends once its cycle is certified, or "
        f"after {SETTLE} + observe, and one that still settles goes on."
    ),
]
Exponents = Annotated[
    int, Field(ge=0, le=MAX_EXPONENTS, description="Lyapunov exponents computed, per plate period."), WHOLE
]


class SweepSpec(Specification):
    """A parameter sweep: its cells, protocol, contact model, and the length of its records.

    `settle`, `observe` and `until` are in plate periods, `keep` in flights, `micro_flight` in rad.
    `parent` is a label: the job in whose map this sweep is a window. Raises `SpecInvalid`, which names each
    field and rule.
    """

    AXES: ClassVar = AXES

    gamma: Gamma
    omega: Omega
    xi: Xi
    protocol: Annotated[Protocol, Field(description="Whether cells start from rest, or along a ramp.")] = (
        Rest()
    )
    model: Annotated[Contact, Field(description="The contact of the lower mass with the plate.")] = Soft()
    effort: Annotated[
        Effort | None,
        Field(exclude=True, description="Sets settle, observe and until, which are stored in its place."),
    ] = None
    settle: AutoSettle = "auto"
    observe: Observe = 100
    until: Annotated[
        Periods | None,
        Field(
            description="Cells that still settle go on, up to this many plate periods, with settle auto; "
            f"left out: {UNTIL:,}."
        ),
    ] = None
    keep: Keep = 64
    micro_flight: MicroFlight = 0.05
    exponents: Exponents = 0
    refine: Annotated[
        Refinement, Field(description="Compute only where the map changes; left out: every cell.")
    ] = None
    parent: Annotated[JobId | None, Field(description="The job in whose map this sweep is a window.")] = None

    @model_validator(mode="before")
    @classmethod
    def _of_today(cls, fields: Any) -> Any:
        """Leave out removed fields; refuse values that had an effect, and say what works instead."""
        if not isinstance(fields, dict) or not REMOVED.keys().isdisjoint(cls.model_fields):
            return fields
        for name in removed_from(fields):
            raise BrokenRuleError(name, f"was removed; {REMOVED[name][1]}", "unknown")
        return {name: value for name, value in fields.items() if name not in REMOVED}

    @model_validator(mode="before")
    @classmethod
    def _resolved(cls, fields: Any) -> Any:
        """Replace an effort by its fields."""
        effort = fields.get("effort") if isinstance(fields, dict) else None
        if not isinstance(effort, str) or effort not in EFFORTS:
            return fields
        for name in EFFORTS[effort].keys() & fields.keys():
            raise BrokenRuleError(name, f"is set by effort {effort!r}: leave out one of the two")
        return EFFORTS[effort] | {**fields, "effort": None}

    @model_validator(mode="after")
    def _rules(self) -> Self:
        if isinstance(self.protocol, Ramp) and len(self.axis_values(self.protocol.axis)) < 2:
            longer = [axis for axis in AXES if len(self.axis_values(axis)) > 1]
            remedy = f"ramp along {one_of(longer)}" if longer else f"give {self.protocol.axis} a range"
            rule = f"must name an axis of at least 2 values, and {self.protocol.axis} has 1; {remedy}"
            raise BrokenRuleError("protocol.axis", rule)
        self._check_until()
        if self.refine is not None and not isinstance(self.protocol, Rest):
            rule = f"needs protocol.kind 'rest', not {self.protocol.kind!r}, which computes every cell"
            raise BrokenRuleError("refine", f"{rule}; leave it out")
        self._check_exponents()
        self._check_depth()
        self._check_start()
        if isinstance(self.model, Stepped):
            check_steps(self.model, corners(self), max(sum(self.window), self.settles_until or 0))
        return self

    def _check_until(self) -> None:
        """Check that `until` is used with auto, and allows another window after the first."""
        if self.until is None:
            return
        if self.settle != "auto":
            rule = f"must be left out where settle is {self.settle}: its windows are fixed; 'auto' works"
            raise BrokenRuleError("until", rule)
        effective = SETTLE + 2 * self.observe
        if self.until < effective:
            needed = f"must be at least {SETTLE} + 2 × observe, {effective:,}, to have an effect"
            raise BrokenRuleError("until", f"{needed}; leave it out for {UNTIL:,}")

    def _check_exponents(self) -> None:
        most = self.model.exponents
        if self.exponents <= most:
            return
        if most == 0:
            having = one_of(kind for kind, row in CONTACT_MODELS.items() if row.fields(kind=kind).exponents)
            rule = f"must be 0 where model.kind is {self.model.kind!r}; {having} has exponents"
        else:
            why = " with restitution 0" if self.model.kind == "rigid" else ""
            rule = f"must be at most {most} where model.kind is {self.model.kind!r}{why}; {most} works"
        raise BrokenRuleError("exponents", rule)

    def _check_depth(self) -> None:
        """Check the contact depths of all cells, which differ with a rest length."""
        rest_length = getattr(self.model, "rest_length", None)
        if rest_length is None:
            return
        gamma, omega = self.axis_values("gamma"), self.axis_values("omega")
        ends = gamma[[-1, 0]], omega[[0, -1]]
        shallow, deep = penetration_of(self.model, *ends)
        if not (shallow >= MIN_PENETRATION and deep <= MAX_PENETRATION):
            unit = self.model.model_copy(update={"rest_length": 1.0})  # a subnormal one has depths of 0
            low, high = np.array([MIN_PENETRATION, MAX_PENETRATION]) / penetration_of(unit, *ends)
            depths = f"gives contacts {shallow:.3g} to {deep:.3g} plate amplitudes deep"
            allowed = f"allowed are {MIN_PENETRATION:g} to {MAX_PENETRATION:g}"
            low, high = 1.001 * low, 0.999 * min(high, MAX_REST_LENGTH)  # rounded, inside the limits
            remedy = f"{low:.4g} to {high:.4g} works" if low <= high else "narrow gamma or omega"
            rule = f"{depths}, {allowed}; {remedy}"
            raise BrokenRuleError("model.rest_length", rule)

    def _check_start(self) -> None:
        """Check that the first cell of every line has the cycle on which a ramp starts."""
        ramp = self.protocol
        if not isinstance(ramp, Ramp) or ramp.start is None:
            return
        start = ramp.start
        if self.model.kind not in WITH_CYCLES:
            rule = f"needs a spring, and model.kind is {self.model.kind!r}; {one_of(WITH_CYCLES)} works"
            raise BrokenRuleError("protocol.start", rule)
        if self.lines > MAX_STARTS:
            rule = f"is possible for at most {MAX_STARTS:,} lines, and this sweep has {self.lines:,}"
            raise BrokenRuleError("protocol.start", rule)
        for cell in self.first_cells():
            if start_of(cell, start.periods) is None:
                rule = f"{no_cycle(cell, start.periods)}; every line of the ramp begins on one"
                raise BrokenRuleError("protocol.start", rule)

    def cell_at(self, xi: int, omega: int, gamma: int) -> Cell:
        """The cell at these indices on its axes."""
        indices = {"gamma": gamma, "omega": omega, "xi": xi}
        return Cell(**{axis: float(self.axis_values(axis)[i]) for axis, i in indices.items()})

    def first_cells(self) -> Iterator[Cell]:
        """The first cell of each line of a ramp."""
        axis = self.ramp_axis
        if axis is None:
            return
        last = -1 if self.directions[0] == "down" else 0
        values = [self.axis_values(name) for name in AXES]
        values[AXES.index(axis)] = values[AXES.index(axis)][[last]]
        for xi, omega, gamma in itertools.product(*(along.tolist() for along in values)):
            yield Cell(gamma, omega, xi)

    @property
    def directions(self) -> tuple[str, ...]:
        """Values of the store's first dimension: ("rest",), ("up",), ("down",) or ("up", "down")."""
        if isinstance(self.protocol, Rest):
            return ("rest",)
        return ("up", "down") if self.protocol.direction == "both" else (self.protocol.direction,)

    @property
    def window(self) -> tuple[int, int]:
        """Plate periods before the window, and of the window, of a cell that is not certified."""
        return (SETTLE if self.settle == "auto" else self.settle), self.observe

    @property
    def settles_until(self) -> int | None:
        """Limit on all plate periods of a cell that still settles; None: its window is fixed."""
        if self.settle != "auto":
            return None
        return self.until or max(UNTIL, sum(self.window))

    @property
    def certifies(self) -> bool:
        """Whether cells end once their cycle is certified. Exponents need the tangents for themselves."""
        return self.settle == "auto" and not self.exponents and self.model.certifies

    @property
    def fills_in(self) -> bool:
        """Whether the sweep is an adaptive map."""
        return self.refine is not None

    @property
    def ramp_axis(self) -> str | None:
        """The axis a ramp moves along; None from rest."""
        return self.protocol.axis if isinstance(self.protocol, Ramp) else None

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along (direction, xi, omega, gamma)."""
        return len(self.directions), *super().shape

    @property
    def lines(self) -> int:
        """Lines of a ramp, both directions counted once; from rest every cell is one."""
        along = 1 if self.ramp_axis is None else len(self.axis_values(self.ramp_axis))
        return math.prod(self.shape[1:]) // along

    def left_out(self) -> set[str]:
        """The labels, and newer fields at their defaults."""
        defaults = {"settle": ("auto",), "until": (None, UNTIL), "exponents": (0,), "refine": (None,)}
        unset = {field for field, default in defaults.items() if getattr(self, field) in default}
        return super().left_out() | unset | {"parent"}


class EarlierSweep(SweepSpec):
    """A sweep of an earlier release, with the fields of REMOVED and the id that it had."""

    settle: Settle = 200
    settle_tolerance: float = 0.0
    settle_until: Periods | None = None
    settle_early: bool = True
    refine: EarlierRefine | None = None

    def today(self) -> SweepSpec:
        """The sweep of this release that computes it anew; with certificates if settling cells went on."""
        fields = {name: value for name, value in self.as_submitted().items() if name not in REMOVED}
        if self.settle_until is not None:
            goes_on = self.settle_until >= SETTLE + 2 * self.observe
            fields |= {"settle": "auto", "until": self.settle_until if goes_on else None}
        if self.refine is not None:
            fields["refine"] = self.refine.today().model_dump()
        return SweepSpec.parse(fields)

    def left_out(self) -> set[str]:
        """Also the removed fields that were off or had no effect."""
        off = {name for name in ("settle_tolerance", "settle_until") if not getattr(self, name)}
        had_effect = isinstance(self.protocol, Rest) and not self.exponents
        if self.settle_early or not had_effect or getattr(self.model, "events", "located") == "plain":
            off.add("settle_early")
        return super().left_out() | off


def removed_from(fields: Mapping[str, object]) -> list[str]:
    """The removed fields among these with another value than their default."""
    return [name for name, (default, _) in REMOVED.items() if fields.get(name, default) != default]


def is_earlier(fields: Mapping[str, object]) -> bool:
    """Whether a stored sweep has fields that sweeps no longer have."""
    refine = fields.get("refine")
    return bool(removed_from(fields)) or (isinstance(refine, dict) and refine.get("margin") is True)


def is_open(spec: object) -> bool:
    """Whether a specification is a sweep with the model `auto`."""
    return isinstance(spec, SweepSpec) and isinstance(spec.model, Auto)


@lru_cache(maxsize=2 * MAX_STARTS)
def start_of(cell: Cell, periods: int) -> Start | None:
    """The start of a ramp on the stable cycle (1, periods) of its first cell; None if there is none."""
    try:
        start = start_on_stable_cycle(cell, periods)
    except KernelInputError:
        return None
    return start.start if start else None


def no_cycle(cell: Cell, periods: int) -> str:
    """The rule that a cell without a stable cycle breaks, with the ranges of Gamma that have one."""
    where = f"gamma {cell.gamma:g}, omega {cell.omega:g}, xi {cell.xi:g}"
    rule = f"there is no stable cycle (1, {periods}) at {where}"
    try:
        ranges = sorted(stable_ranges(cell.omega, cell.xi, periods, exact=True))
    except KernelInputError as error:
        return f"{rule} ({error})"
    if not ranges:
        return f"{rule}, nor at any other gamma"
    known = " and ".join(f"{_UP.create_decimal(low)} to {_DOWN.create_decimal(high)}" for low, high in ranges)
    return f"{rule}; there is one from gamma {known}"
