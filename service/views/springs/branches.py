"""Branches, curves and events of cycles as variables of a result.

A branch or curve is a row along the first dimension, padded beyond its last point.
"""

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any, Final, TypeVar

import numpy as np
import xarray
from numpy.typing import NDArray

from kernel.cycles.events import Branch, Events, rows_of
from kernel.cycles.roots import stretches
from kernel.params import STATE_FIELDS
from service.errors import TooLarge
from service.pictures import IDEAL
from service.views import selection
from service.views.variables import ENERGY, coordinate, dataset, row, variable
from worker.orbits.schema import ARRAYS
from worker.study import Array
from worker.study.layout import COORDINATES
from worker.sweep import AXES

Record = TypeVar("Record", Branch, Events)

#: `violations` beyond the last point of a branch or curve.
MISSING_POINT: Final = 255
#: Variables of each branch, and of the energy balance of a cycle.
BRANCH: Final = ("branch_bounces", "branch_periods", "points")
BALANCE: Final = tuple(array.name for array in ENERGY)

#: Real and imaginary part of both multipliers.
_PARTS: Final = {"multiplier": 2, "part": 2}
#: Dimensions of the variables that have more than branch and point.
_MORE: Final[dict[str, dict[str, int]]] = {"multipliers": _PARTS, "cycle_state": {"state": len(STATE_FIELDS)}}


def _of_cycle(thing: str, what: str) -> tuple[Array, Array]:
    return (
        row(f"{thing}_bounces", (thing,), "<i4", f"bounces of the {what}"),
        row(f"{thing}_periods", (thing,), "<i4", f"plate periods of the {what}"),
    )


_STORED: Final = {array.name: array for array in ARRAYS}

#: The variables by name: those that a study of orbits stores, and others.
ROWS: Final[Mapping[str, Array]] = _STORED | {
    array.name: array
    for array in (
        _STORED["gamma"]._replace(attrs=COORDINATES["gamma"] | {"comment": "NaN: no point"}),
        _STORED["violations"]._replace(fill=MISSING_POINT, attrs=_STORED["violations"].attrs | {
            "comment": f"0: a cycle of the spring; {MISSING_POINT}: no point",
        }),
        row("multipliers", ("branch", "point", *_PARTS), "<f8", "Floquet multipliers, the larger first"),
        row("cycle_state", ("branch", "point", "state"), "<f8", "a state on the cycle",
            fields=" ".join(STATE_FIELDS)),
        row("flights", ("branch", "point"), "<i4", "flights of the cycle; `flight_time` is the longest",
            comment="0: no point"),
        *ENERGY,
        *_of_cycle("branch", "cycles"),
        row("points", ("branch",), "<i4", "points of the branch"),
        row("curve_kind", ("curve",), "U", "kind of event"),
        *_of_cycle("curve", "cycles"),
        *(Array(axis, ("curve", "point"), "<f8", 0, COORDINATES[axis]) for axis in ("omega", "xi")),
        row("event_kind", ("event",), "U", "kind of event"),
        *(Array(f"event_{axis}", ("event",), "<f8", 0, COORDINATES[axis]) for axis in AXES[::-1]),
        row("event_multipliers", ("event", *_PARTS), "<f8", "Floquet multipliers"),
        row("event_branch", ("event",), "<i4", "index of the branch that the event is on",
            comment="-1: no point of it is shown"),
        row("event_complete", ("event",), "?", "whether all of its kind were counted, with proof"),
        *(Array(f"skipped_{x}", ("skipped",), "<f8", 0, COORDINATES[x]) for x in ("gamma", "omega", "xi")),
        *_of_cycle("skipped", "cell from which no branch was followed"),
        row("skipped_reason", ("skipped",), "U", "why no branch was followed from the cell"),
    )
}  # fmt: skip
EVENT_FIELDS: Final = (
    "kind", "gamma", "omega", "xi", "bounces", "periods", "flight_time", "violations", "multipliers",
)  # fmt: skip
EVENTS: Final = tuple(ROWS[f"event_{name}"] for name in EVENT_FIELDS)


def padded(
    names: Sequence[str], records: Sequence[Any], dims: tuple[str, ...] = ("branch", "point")
) -> dict[str, xarray.Variable]:
    """Fields of all records as variables, padded to the longest record."""
    return {
        name: _padded(ROWS[name], [_field(record, name) for record in records], (*dims, *_MORE.get(name, ())))
        for name in names
    }  # fmt: skip


def _padded(about: Array, values: Sequence[NDArray[Any]], dims: tuple[str, ...]) -> xarray.Variable:
    """Arrays as the rows of a variable. Raises TooLarge."""
    lengths = [
        max((x.shape[i] for x in values), default=_MORE.get(about.name, {}).get(dim, 0))
        for i, dim in enumerate(dims[1:])
    ]
    if (size := prod((len(values), *lengths))) > selection.MAX_READ:
        raise TooLarge(
            f"{len(values):,} of them, as long as the longest, hold {size:,} numbers; the limit is "
            f"{selection.MAX_READ:,}: take a shorter range, or fewer kinds or modes"
        )
    table = np.full((len(values), *lengths), np.nan if about.dtype == "<f8" else about.fill, about.dtype)
    for line, value in zip(table, values, strict=True):
        line[tuple(map(slice, value.shape))] = value
    return xarray.Variable(dims, table, dict(about.attrs))


def columns(thing: str, fields: Mapping[str, Any]) -> dict[str, xarray.Variable]:
    """Fields of a list of events, branches, curves or cells as variables."""
    names = {field: f"{thing}_{field}" for field in fields}
    return {name: variable((), fields[field], ROWS[name]) for field, name in names.items()}


def event_columns(events: Events) -> dict[str, xarray.Variable]:
    """Events as the variables EVENTS."""
    return columns("event", {name: _field(events, name) for name in EVENT_FIELDS})


def _field(record: Any, name: str) -> NDArray[Any]:
    if name == "multipliers":
        return np.stack([record.multiplier.real, record.multiplier.imag], axis=-1)
    return np.asarray(getattr(record, name))


def of_branches(records: Sequence[Branch]) -> dict[str, xarray.Variable]:
    """Mode and number of points of each branch; the median where bounces change along it."""
    bounces = [int(np.median(x.bounces)) for x in records]
    lengths = {"bounces": bounces, "periods": [x.periods for x in records]}
    points = variable((), [len(x.gamma) for x in records], ROWS["points"])
    return {**columns("branch", lengths), "points": points}


def cycle_result(
    data: Mapping[str, xarray.Variable], coords: Mapping[str, xarray.Variable], complete: bool = True,
    model: str = IDEAL, along: str = "gamma", **attrs: Any,
) -> xarray.Dataset:  # fmt: skip
    """The Dataset of branches or curves, with the attributes that all of these have."""
    part = coordinate("part", ["real", "imaginary"], long_name="part of a complex number")
    varies = {} if along == "gamma" else {"along": along}
    return dataset(data, {**coords, "part": part}, {"model": model, **varies, **attrs, "complete": complete})


OF_POINT: Final = (
    "gamma", "flight_time", "takeoff_phase", "elongation", "elongation_velocity", "impact_velocity",
    "multipliers", "stable", "violations",
)  # fmt: skip


OF_CELLS: Final = (*(name for name in OF_POINT if name != "flight_time"), "flights")


def with_flights(branches: Sequence[Branch]) -> dict[str, xarray.Variable]:
    """The points of branches, with all flights in `flight_time`."""
    flights = padded(("flight_time",), branches, ("branch", "point", "flight"))
    return padded((*OF_CELLS, "cycle_state"), branches) | flights


def below(record: Record, gamma_max: float) -> list[Record]:
    """The connected parts of a branch or curve up to `gamma_max`."""
    return [rows_of(record, slice(*part)) for part in stretches(record.gamma <= gamma_max)]


def pieces_below(
    branches: Sequence[Branch],
    events: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
    gamma_max: float,
) -> tuple[list[Branch], dict[str, xarray.Variable]]:
    """The parts of branches up to `gamma_max`, and which of them each event is on.

    events: gamma (n,) and flight time (n,) of those on each branch.
    """
    pieces: list[Branch] = []
    on: list[int] = []
    for branch, own in zip(branches, events, strict=True):
        parts = below(branch, gamma_max)
        longest = [part.flight_time.reshape(len(part.gamma), -1)[:, 0] for part in parts]
        for gamma, time in zip(*own, strict=True):
            away = [np.hypot(x.gamma - gamma, t - time).min() for x, t in zip(parts, longest, strict=True)]
            on.append(len(pieces) + int(np.argmin(away)) if parts else -1)
        pieces += parts
    return pieces, columns("event", {"branch": np.array(on, int)})
