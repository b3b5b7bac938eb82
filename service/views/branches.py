"""What the results on cycles in closed form share: variables, parameters, and records made into variables.

A branch or curve is a row along the first dimension, padded beyond its last point.
"""

from collections.abc import Mapping, Sequence
from math import prod
from typing import Annotated, Any, Final, TypeVar

import numpy as np
import xarray
from numpy.typing import NDArray
from pydantic import Field

from kernel.branches.events import Branch, Events, flight_times
from kernel.branches.words import WordBranch
from kernel.params import KernelInputError
from service.errors import InvalidRequest, TooLarge
from service.results.selection import MAX_READ
from service.views.variables import ENERGY, row, variable
from service.views.view import Number
from worker import orbits, schema
from worker.orbits import MAX_GRID, Mode, check_modes, read_mode
from worker.schema import Array
from worker.spec.errors import BrokenRuleError

Modes = Annotated[str, Field(max_length=200, description="bounces-periods, as 1-1,1-2; cycles of one bounce")]
GammaMax = Annotated[Number, Field(gt=0, le=1e6, description="branches and curves are cut above this Γ")]
WithEnergy = Annotated[bool, Field(description="the energy balance of every point as well")]

Record = TypeVar("Record", Branch, Events)

#: The contact of every closed form.
MODEL: Final = "rigid, restitution 0"
#: `admissible` beyond the last point of a branch or curve.
MISSING_POINT: Final = 255
#: Of each branch, and the energy balance of a cycle.
BRANCH: Final = ("branch_bounces", "branch_periods", "points")
BALANCE: Final = tuple(each.name for each in ENERGY)

#: Real and imaginary part of both multipliers.
_PARTS: Final = {"multiplier": 2, "part": 2}


def _of_cycle(thing: str, what: str) -> tuple[Array, Array]:
    return (
        row(f"{thing}_bounces", (thing,), "<i4", f"bounces of the {what}"),
        row(f"{thing}_periods", (thing,), "<i4", f"plate periods of the {what}"),
    )


_STORED: Final = {each.name: each for each in orbits.ARRAYS}
_AXES: Final = {each.name: each.attrs for each in schema.COORDINATES}

#: The variables by name: those that the study `orbits` stores, and others.
ROWS: Final[Mapping[str, Array]] = _STORED | {
    each.name: each
    for each in (
        _STORED["gamma"]._replace(attrs=_AXES["gamma"] | {"comment": "NaN: no point"}),
        _STORED["admissible"]._replace(fill=MISSING_POINT, attrs=_STORED["admissible"].attrs | {
            "comment": f"0: a cycle of the spring; {MISSING_POINT}: no point",
        }),
        row("multipliers", ("branch", "point", *_PARTS), "<f8", "Floquet multipliers, the larger first"),
        *ENERGY,
        *_of_cycle("branch", "cycles"),
        row("points", ("branch",), "<i4", "points of the branch"),
        row("word", ("branch",), "U", "landings of the cycle: s sticks, z takes off again at once"),
        row("curve_kind", ("curve",), "U", "kind of event"),
        *_of_cycle("curve", "cycles"),
        *(Array(axis, ("curve", "point"), "<f8", 0, _AXES[axis]) for axis in ("omega", "xi")),
        row("event_kind", ("event",), "U", "kind of event"),
        *(Array(f"event_{axis}", ("event",), "<f8", 0, _AXES[axis]) for axis in ("gamma", "omega", "xi")),
        row("event_multipliers", ("event", *_PARTS), "<f8", "Floquet multipliers"),
        row("event_branch", ("event",), "<i4", "index of the branch that the event is on"),
        Array("skipped_gamma", ("skipped",), "<f8", 0, _AXES["gamma"]),
        *_of_cycle("skipped", "cell from which no branch was followed"),
        row("skipped_reason", ("skipped",), "U", "why no branch was followed from the cell"),
    )
}  # fmt: skip
_EVENT: Final = (
    "kind", "gamma", "omega", "xi", "bounces", "periods", "flight_time", "admissible", "multipliers",
)  # fmt: skip
EVENTS: Final = tuple(ROWS[f"event_{name}"] for name in _EVENT)


def padded(
    names: Sequence[str], records: Sequence[Any], dims: tuple[str, ...] = ("branch", "point")
) -> dict[str, xarray.Variable]:
    """These fields of every record, of the length of the longest."""
    return {
        name: _padded(ROWS[name], [_field(record, name) for record in records],
                      (*dims, *_PARTS) if name == "multipliers" else dims)
        for name in names
    }  # fmt: skip


def _padded(about: Array, values: Sequence[NDArray[Any]], dims: tuple[str, ...]) -> xarray.Variable:
    lengths = [
        max((each.shape[i] for each in values), default=_PARTS.get(dim, 0)) for i, dim in enumerate(dims[1:])
    ]
    if (size := prod((len(values), *lengths))) > MAX_READ:
        raise TooLarge(
            f"{len(values):,} of them, as long as the longest, hold {size:,} numbers; the limit is "
            f"{MAX_READ:,}: take a shorter range, or fewer kinds or modes"
        )
    table = np.full((len(values), *lengths), np.nan if about.dtype == "<f8" else about.fill, about.dtype)
    for line, each in zip(table, values, strict=True):
        line[tuple(map(slice, each.shape))] = each
    return xarray.Variable(dims, table, dict(about.attrs))


def columns(thing: str, fields: Mapping[str, Any]) -> dict[str, xarray.Variable]:
    """The fields of a list of events, branches, curves or cells."""
    names = {field: f"{thing}_{field}" for field in fields}
    return {name: variable((), fields[field], ROWS[name]) for field, name in names.items()}


def event_columns(events: Events) -> dict[str, xarray.Variable]:
    """The variables of EVENTS."""
    return columns("event", {name: _field(events, name) for name in _EVENT})


def _field(record: Any, name: str) -> NDArray[Any]:
    if name == "multipliers":
        return np.stack([record.multiplier.real, record.multiplier.imag], axis=-1)
    return np.asarray(getattr(record, name))


def of_branches(records: Sequence[Branch | WordBranch]) -> dict[str, xarray.Variable]:
    """Mode and length of each branch."""
    bounces = [len(x.word) if isinstance(x, WordBranch) else x.bounces for x in records]
    lengths = {"bounces": bounces, "periods": [x.periods for x in records]}
    points = variable((), [len(x.gamma) for x in records], ROWS["points"])
    return {**columns("branch", lengths), "points": points}


def dataset(
    data: Mapping[str, xarray.Variable],
    coords: Mapping[str, xarray.Variable],
    complete: bool = True,
    **attrs: Any,
) -> xarray.Dataset:
    """A result with the attributes of all of them."""
    part = xarray.Variable(("part",), np.array(["real", "imaginary"]))
    return xarray.Dataset(data, {**coords, "part": part}, {"model": MODEL, **attrs, "complete": complete})


def parse_modes(text: str) -> tuple[Mode, ...]:
    """Modes written as `1-1,1-2`: bounces and plate periods, of one bounce each. Raises InvalidRequest."""
    try:
        modes = [read_mode(part.strip()) for part in text.split(",")]
        check_modes(modes)
    except BrokenRuleError as error:
        raise InvalidRequest.of("modes", error.rule) from error
    return tuple(sorted(modes))


def grid_length(omega: float, xi: float, periods: int, points: int = 1) -> int:
    """Flight times of a branch. Raises InvalidRequest above MAX_GRID, and for a spring without branches."""
    try:
        needed = len(flight_times(omega, xi, periods, points))
    except KernelInputError as error:
        raise InvalidRequest.of(error.argument, error.rule) from error
    if needed > MAX_GRID:
        rule = (
            f"1-{periods} at omega {omega:g} takes a branch of {needed:,} points; the limit is "
            f"{MAX_GRID:,}: ask for fewer periods, or take a larger omega"
        )
        raise InvalidRequest.of("modes", rule)
    return needed


def below(record: Record, gamma_max: float) -> list[Record]:
    """The connected parts of a branch or curve up to `gamma_max`."""
    inside = np.concatenate([[False], record.gamma <= gamma_max, [False]])
    edges = np.flatnonzero(np.diff(inside)).reshape(-1, 2).tolist()
    return [rows_of(record, slice(low, high)) for low, high in edges]


def rows_of(record: Record, rows: slice | NDArray[np.bool_]) -> Record:
    """A record of these rows of its arrays."""
    arrays: dict[str, Any] = {
        name: x[rows] for name, x in record._asdict().items() if isinstance(x, np.ndarray)
    }
    return record._replace(**arrays)
