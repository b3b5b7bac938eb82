"""The difference of two sweeps: cells with other modes, and by how much thresholds move."""

import math
from collections.abc import Sequence
from decimal import ROUND_CEILING, Context
from itertools import product
from typing import Annotated, Final

import numpy as np
import xarray
from numpy.typing import NDArray
from pydantic import Field

from kernel.params import Outcome
from service.pictures import SYMBOLS, Figure, draw_modes
from service.views import selection
from service.views.threshold import on_grid_of
from service.views.variables import coordinate, dataset, row, variables
from service.views.view import Estimate, Every, FirstDirection, Number, Query, View
from worker.spec.specification import JobId
from worker.study import Array
from worker.sweep import AXES, SweepSpec

_PLANE: Final = ("omega", "gamma")
_DIFFERS: Final = row(
    "differs", (), "|u1", "how the cell compares with the nearest one of the other sweep",
    flag_values=[0, 1, 2], flag_meanings="same_mode other_mode not_compared",
)  # fmt: skip
_MOVED: Final = tuple(
    row(
        f"{way}_moved", (), "<f8", f"how far the threshold {way} moves in Γ", comment="NaN: not found in both"
    )
    for way in ("up", "down")
)


#: The largest percentage of four digits below all, and rounding up to two digits: sentences must hold.
_LESS_THAN_ALL: Final = 99.99
_UPWARDS: Final = Context(prec=2, rounding=ROUND_CEILING)

_APART: Final = "No cell of this sweep is within the axes of the other."


def _other(array: Array) -> Array:
    attrs = array.attrs | {"long_name": f"{array.attrs['long_name']}, of the other sweep"}
    return array._replace(name=f"other_{array.name}", attrs=attrs)


_ROWS: Final = (_DIFFERS, *selection.MODES, *map(_other, selection.MODES), *_MOVED)


class DifferenceQuery(Query):
    """The plane of both sweeps at the nearest value of xi."""

    other: Annotated[JobId, Field(description="id of the sweep that this one is compared with")]
    xi: Number | None = None
    direction: FirstDirection = None
    every: Every = 1


def compute(study: selection.Stored[SweepSpec], query: DifferenceQuery) -> xarray.Dataset:
    """Where the modes of two sweeps differ.

    Each cell of this sweep is compared with the nearest one of the `other`, if it is within its axes: by
    outcome and mode, and by label where both have exponents. Thresholds are compared at the Ω of both. The
    attribute `sentence` says in how many cells modes are the same, and by how much thresholds move at most.
    """
    other = study.other
    assert other is not None
    xi = selection.nearest_index(study.spec, "xi", query.xi)
    other_xi = selection.nearest_index(
        other.spec, "xi", xi.value if len(other.spec.axis_values("xi")) > 1 else None, "the other sweep"
    )
    direction = selection.directions_of(study.spec, query.direction)[0]
    ways = other.spec.directions
    part = slice(None, None, query.every)
    own = _modes_at(study, direction, {"xi": xi.index, "omega": part, "gamma": part})
    near, inside = _nearest(study.spec, other.spec, query.every)
    way = direction if direction in ways else ways[0]
    theirs = _read_nearest(other, way, other_xi.index, near)
    common = np.logical_and.outer(*inside)
    both = common & (own["outcome"] != Outcome.MISSING) & (theirs["outcome"] != Outcome.MISSING)
    compared, same = _same(own, theirs)
    data = {"differs": np.where(both, ~same, 2)} | {name: own[name] for name in compared}
    data |= {f"other_{name}": theirs[name] for name in compared}
    moved, shared = _moved(study, other, xi.index, other_xi.index)
    xis = dict.fromkeys(f"{value:g}" for value in (xi.value, other_xi.value))
    several = len(xis) > 1 or len(study.spec.axis_values("xi")) > 1
    at = f"At ξ = {' against '.join(xis)}, " if several and both.any() else ""
    return dataset(
        variables(_ROWS, data, _PLANE)
        | variables(_ROWS, {name: values[part] for name, values in moved.items()}, ("omega",)),
        {"xi": coordinate("xi", xi.value), "direction": coordinate("direction", direction)}
        | {axis: coordinate(axis, study.spec.axis_values(axis)[part]) for axis in _PLANE},
        {
            "sentence": at + _sentence(same, both, moved, shared) if common.any() else _APART,
            "other": query.other, "other_direction": way, "other_xi": other_xi.value,
            "other_model": other.spec.model.kind, "every": query.every,
            "complete": bool(study.is_complete(own["outcome"]) and other.is_complete(theirs["outcome"])),
        },
    )  # fmt: skip


def changed(study: selection.Stored[SweepSpec], other: selection.Stored[SweepSpec]) -> float | None:
    """The share of a complete sweep's cells with another mode than the nearest cell of the other one.

    Of a sweep and a coarser one of the same axes it is how much of the coarser one's picture is wrong. None
    if a plane is too large to be read.
    """
    spec, plane = study.spec, math.prod(study.spec.shape[2:])
    if plane > selection.MAX_READ:
        return None
    [near_xi, *near], _ = _nearest(spec, other.spec, axes=AXES)
    differs, at_once = 0, selection.MAX_READ // plane  # planes: a chunk holds several
    for direction, first in product(spec.directions, range(0, len(near_xi), at_once)):
        xi = near_xi[first : first + at_once]
        own = _modes_at(study, direction, {"xi": slice(first, first + len(xi))})
        theirs = _modes_at(other, direction, {"xi": slice(int(xi[0]), int(xi[-1]) + 1)})
        _, same = _same(own, {name: values[np.ix_(xi - xi[0], *near)] for name, values in theirs.items()})
        differs += int(np.count_nonzero(~same))
    return differs / math.prod(spec.shape)


def _modes_at(
    study: selection.Stored[SweepSpec], direction: str, indices: selection.Indices
) -> selection.Arrays:
    """The `recounted` arrays of some cells."""
    names = selection.arrays_of_modes(study.spec, None)
    return selection.recounted(study.spec, selection.read_direction(study, names, direction, indices), None)


def _same(own: selection.Arrays, theirs: selection.Arrays) -> tuple[list[str], NDArray[np.bool_]]:
    """The arrays of modes that both sweeps have, and the cells in which all of them are equal."""
    compared = [array.name for array in selection.MODES if array.name in own and array.name in theirs]
    return compared, np.logical_and.reduce([own[name] == theirs[name] for name in compared])


def _nearest(
    spec: SweepSpec, other: SweepSpec, every: int = 1, axes: Sequence[str] = _PLANE
) -> tuple[list[NDArray[np.intp]], list[NDArray[np.bool_]]]:
    """Indices of the other sweep's nearest values of each axis, and which of them are within its axes."""
    near, inside = [], []
    for axis in axes:
        values, theirs = spec.axis_values(axis)[::every], other.axis_values(axis)
        right = np.clip(np.searchsorted(theirs, values), 1, max(len(theirs) - 1, 1))
        left, right = right - 1, np.minimum(right, len(theirs) - 1)
        near.append(np.where(values - theirs[left] <= theirs[right] - values, left, right))
        slack = selection.ROUNDING * max(abs(theirs[0]), abs(theirs[-1]))
        inside.append((values >= theirs[0] - slack) & (values <= theirs[-1] + slack))
    return near, inside


def _read_nearest(
    study: selection.Stored[SweepSpec], direction: str, xi: int, near: list[NDArray[np.intp]]
) -> selection.Arrays:
    """The `recounted` arrays at these rows and columns of a plane, read some rows at a time."""
    rows, columns = near
    at_once = max(1, selection.MAX_READ // (4 * len(study.spec.axis_values("gamma"))))
    parts, first = [], 0
    while first < len(rows):
        last = int(np.searchsorted(rows, rows[first] + at_once))
        low, high = int(rows[first]), int(rows[last - 1]) + 1
        block = _modes_at(study, direction, {"xi": xi, "omega": slice(low, high)})
        parts.append({name: values[rows[first:last] - low][:, columns] for name, values in block.items()})
        first = last
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _moved(
    study: selection.Stored[SweepSpec], other: selection.Stored[SweepSpec], xi: int, other_xi: int
) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.bool_]]:
    """How far thresholds move at each omega of the first sweep, and which omegas the other has too.

    Empty if one of the sweeps has no thresholds in gamma.
    """
    if not {study.spec.ramp_axis, other.spec.ramp_axis} <= {None, "gamma"}:
        return {}, np.array([], bool)
    own, theirs = on_grid_of(study, xi)[0], on_grid_of(other, other_xi)[0]
    [near, _], _ = _nearest(study.spec, other.spec)
    omega = study.spec.axis_values("omega")
    shared = np.isclose(omega, other.spec.axis_values("omega")[near], rtol=selection.ROUNDING, atol=0.0)
    moved = {
        f"{way}_moved": np.where(shared, _away(own[way], theirs[way][near]), np.nan) for way in ("up", "down")
    }
    return moved, shared


def _away(own: NDArray[np.float64], theirs: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far two thresholds are apart: 0 if only the rounding of their grids differs."""
    same = np.isclose(own, theirs, rtol=selection.ROUNDING, atol=0.0)
    return np.where(same, 0.0, np.abs(own - theirs))


def _sentence(
    same: NDArray[np.bool_], both: NDArray[np.bool_], moved: dict[str, NDArray[np.float64]],
    shared: NDArray[np.bool_],
) -> str:  # fmt: skip
    """In words: the share of cells with the same mode, and the most that thresholds move.

    both: cells that are computed in both. shared: omegas that both have.
    """
    if not both.any():
        return "No cell is computed in both yet."
    away = np.concatenate([*moved.values(), []])
    most = np.max(away, where=np.isfinite(away), initial=-1.0)
    bound = _UPWARDS.create_decimal(f"{most:.9g}").normalize()  # without the rounding of a difference
    threshold = "no threshold in both moves" + (f" by more than {bound:f}" if most > 0.0 else "")
    threshold = threshold if most >= 0.0 else "there is no threshold in both"
    if not shared.any():
        threshold = "no frequency is in both"
    elif not shared.all():
        threshold += f" at the {shared.sum()} of {shared.size} frequencies that both have"
    cells = "the cells" if both.all() else f"the cells that both have ({both.sum():,} of {both.size:,})"
    share = 100.0 if same[both].all() else min(100.0 * same[both].mean(), _LESS_THAN_ALL)
    return f"{share:.4g} % of {cells} have the same mode; {threshold}."


def estimate(spec: SweepSpec, query: DifferenceQuery) -> Estimate:
    """All cells of the plane. Raises InvalidRequest if the sweep lacks the plane."""
    selection.nearest_index(spec, "xi", query.xi)
    selection.directions_of(spec, query.direction)
    lengths = {axis: len(spec.axis_values(axis)) for axis in _PLANE}
    return Estimate(lengths, _PLANE, query.every, reads=_PLANE, memory=32 * selection.MAX_READ, small=False)


def draw(result: xarray.Dataset, figure: Figure) -> None:
    """Draw the cells that differ, with the modes of the other sweep."""
    axes = figure.subplots()
    names = [str(name) for name in result.data_vars if str(name).startswith("other_")]
    shown = result[names].rename({name: name.removeprefix("other_") for name in names})
    attrs = {"hide": "same", "model": result.attrs["other_model"]}
    draw_modes(axes, shown.where(result.differs == 1, 0).assign_attrs(attrs))
    xi = " and ".join(f"{value:g}" for value in sorted({result.xi.item(), result.attrs["other_xi"]}))
    ways = " and ".join(dict.fromkeys([result.direction.item(), result.attrs["other_direction"]]))
    place = f"{SYMBOLS['xi']} = {xi}, {ways}, where modes differ: those of the other sweep"
    sentence = result.attrs["sentence"].replace("; ", ";\n")  # which is wider than the picture
    axes.set_title("")
    axes.set_title(f"{place}\n{sentence}", loc="left", fontsize=10)


VIEW: Final = View(
    "difference", "Difference of two sweeps", SweepSpec, DifferenceQuery, compute, estimate,
    variables=_ROWS, rows="differs", printed=("up_moved",), draw=draw, size=(8.0, 4.2),
)  # fmt: skip
