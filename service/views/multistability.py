"""The attractors of a stored study of multistability, matched over the plane at one xi.

Along gamma, two attractors of neighbouring cells are the same if each leads to the other. They form a branch.
In each cell, branches of neighbouring lines match if they have the same mode, and the nearest longest flights
within NEAR. Branches that match in most cells join first, unless an attractor would be twice in a cell.
Attractors are numbered from 1 by their number of cells.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final

import numpy as np
import xarray
from numpy.typing import NDArray
from pydantic import Field

from kernel.params import Outcome
from service import pictures
from service.errors import TooLarge
from service.views.selection import Stored, attractor_label, nearest_index, read_stored
from service.views.variables import coordinate, dataset, row, variables
from service.views.view import Estimate, Number, Query, View
from worker.basins.schema import MAX_FOLLOWED, OF_ATTRACTORS
from worker.basins.specification import MultistabilitySpec

#: Limit on the cells of an answer, and bytes of memory of each while they are matched.
MAX_CELLS: Final = 2**16
_PER_CELL: Final = 4096

#: Cycles of neighbouring lines match only if their longest flights differ by at most this, rad.
NEAR: Final = 1.0

_PLANE: Final = ("omega", "gamma")
_MODE: Final = ("attractor_outcome", "bounces", "periods")
_NAMES: Final = (
    "outcome", "attractor_count", *_MODE, "longest_flight", "fraction", "next_up", "next_down",
)  # fmt: skip
_OF_PLACES: Final = ("fraction", "longest_flight", "flight_time")

#: The variables. A place is that of an attractor in a cell.
_ROWS: Final = (
    row("count", (), "<i4", "attractors of the cell", comment="-1: not computed"),
    row("id", ("place",), "<i4", "attractor of the plane", comment="0: none"),
    row("label", ("place",), "U", "what the attractor does"),
    *(array._replace(dims=tuple("place" if dim == "id" else dim for dim in array.dims))
      for array in OF_ATTRACTORS if array.name in _OF_PLACES),
    row("attractor_label", ("attractor",), "U", "what the attractor does in most cells"),
    row("cells", ("attractor",), "<i4", "cells of the attractor"),
    row("event_kind", ("event",), "U", "birth, death or mode, with gamma growing"),
    row("event_attractor", ("event",), "<i4", "attractor of the event"),
    row("event_omega", ("event",), "<f8", "omega of the event"),
    row("event_gamma_below", ("event",), "<f8", "gamma of the cell below the event"),
    row("event_gamma_above", ("event",), "<f8", "gamma of the cell above the event"),
    row("event_below", ("event",), "U", "label of the attractor below", comment="empty: none"),
    row("event_above", ("event",), "U", "label of the attractor above", comment="empty: none"),
    row("event_leads_to", ("event",), "<i4", "attractor that takes the place of one born or dying",
        comment="0: none"),
)  # fmt: skip

_OF_EVENTS: Final = tuple(array.name for array in _ROWS if array.name.startswith("event_"))

_Arrays = Mapping[str, NDArray[Any]]


class MultistabilityQuery(Query):
    """The plane at the nearest xi, or a line of it along gamma. An axis with one value may be omitted."""

    xi: Number | None = None
    omega: Annotated[Number | None, Field(description="the nearest line along gamma alone")] = None


def compute(study: Stored[MultistabilitySpec], query: MultistabilityQuery) -> xarray.Dataset:
    """The attractors of every cell at one ξ.

    They are matched from cell to cell, with births, deaths and changes of mode as events. One attractor has
    one `id` in all cells; ids are numbered from 1 by the number of cells. `omega` selects the line along Γ
    nearest to it, with the flights of every attractor. The attribute `several` is the share of cells with two
    attractors or more, `several_by_drops` the same without attractors that no drop reaches.
    """
    spec, xi, rows = study.spec, nearest_index(study.spec, "xi", query.xi), slice(None)
    arrays = read_stored(study, _NAMES, {"xi": xi.index})
    if query.omega is not None:
        row = nearest_index(spec, "omega", query.omega).index
        rows = slice(row, row + 1)
    ids = _ids(arrays)
    labels, shown, exists = _labels(arrays, ids), ids[rows], ids[rows] > 0
    count = np.where(arrays["outcome"] == Outcome.MISSING, -1, arrays["attractor_count"])[rows]
    of_places: dict[str, NDArray[Any]] = {"id": shown, "label": labels[rows]}
    for name in ("fraction", "longest_flight"):
        of_places[name] = np.where(exists, arrays[name][rows], np.nan)
    if query.omega is not None:
        times = read_stored(study, ("flight_time",), {"xi": xi.index, "omega": rows})["flight_time"]
        of_places["flight_time"] = np.where(exists[..., np.newaxis], times, np.nan)
    places = max(1, int(np.count_nonzero(exists, axis=-1).max()))
    shown_places = {name: values[:, :, :places] for name, values in of_places.items()}
    numbers = np.unique(shown[exists])
    commonest = _commonest(ids, labels)
    columns: dict[str, Any] = {
        "attractor_label": [commonest[number] for number in numbers.tolist()],
        "cells": np.bincount(shown[exists])[numbers],
    }
    events = list(_events(spec, arrays, ids, labels, rows))
    columns |= {name: [event[i] for event in events] for i, name in enumerate(_OF_EVENTS)}
    data = variables(_ROWS, shown_places, _PLANE) | variables(_ROWS, columns)
    data |= variables(_ROWS, {"count": count}, _PLANE)
    coords = {
        "xi": coordinate("xi", xi.value),
        "omega": coordinate("omega", spec.axis_values("omega")[rows]),
        "gamma": coordinate("gamma", spec.axis_values("gamma")),
        "attractor": coordinate("attractor", numbers.astype(np.int32), long_name="attractor of the plane"),
    }
    reached = np.count_nonzero(of_places["fraction"] > 0.0, axis=-1)
    attrs = {
        "several": _share(count[count >= 0] >= 2), "several_by_drops": _share(reached[count >= 0] >= 2),
        "model": spec.model.kind, "complete": study.is_complete(arrays["outcome"]),
    }  # fmt: skip
    return dataset(data, coords, attrs)


def estimate(spec: MultistabilitySpec, query: MultistabilityQuery) -> Estimate:
    """The plane or the line. Raises InvalidRequest as `nearest_index`, and TooLarge above MAX_CELLS."""
    nearest_index(spec, "xi", query.xi)
    _, omegas, gammas = spec.shape
    if omegas * gammas > MAX_CELLS:
        raise TooLarge(
            f"the answer would hold up to {omegas * gammas:,} points ({omegas:,} by {gammas:,} cells); the "
            f"limit is {MAX_CELLS:,}: open the store itself, which has no such limit"
        )
    lengths = {"omega": omegas, "gamma": gammas, "place": MAX_FOLLOWED}
    if query.omega is not None:
        nearest_index(spec, "omega", query.omega)
        lengths |= {"omega": 1, "flight": spec.keep}
    return Estimate(lengths, reads=_PLANE, memory=omegas * gammas * _PER_CELL)


def _share(cells: NDArray[np.bool_]) -> float:
    """Share of the computed cells for which `cells` holds; NaN if none is computed."""
    return float(np.mean(cells)) if cells.size else np.nan


def _ids(arrays: _Arrays) -> NDArray[np.int64]:
    """The id of every stored attractor (omega, gamma, id); 0 where there is none."""
    branch = _branches(arrays)
    owner = _joined(branch, _votes(arrays, branch))
    exists = branch >= 0
    owners, index, cells = np.unique(owner[branch[exists]], return_inverse=True, return_counts=True)
    order = np.lexsort((owners, -cells))
    number = np.empty(len(owners), np.int64)
    number[order] = np.arange(1, len(owners) + 1)
    ids = np.zeros(branch.shape, np.int64)
    ids[exists] = number[index]
    return ids


def _joined(branch: NDArray[np.int64], votes: Mapping[tuple[int, int], int]) -> NDArray[np.int64]:
    """For each branch the first branch of its attractor. Pairs with most votes join first.

    Branches that share a cell do not join.
    """
    cells: list[set[int]] = [set() for _ in range(int(branch.max(initial=-1)) + 1)]
    members = [[number] for number in range(len(cells))]
    owner = np.arange(len(cells))
    for position, number in enumerate(branch.ravel().tolist()):
        if number >= 0:
            cells[number].add(position // MAX_FOLLOWED)
    for pair, _ in sorted(votes.items(), key=lambda vote: (-vote[1], vote[0])):
        first, second = sorted(int(owner[number]) for number in pair)
        if first != second and cells[first].isdisjoint(cells[second]):
            owner[members[second]] = first
            members[first] += members[second]
            cells[first] |= cells[second]
    return owner


def _branches(arrays: _Arrays) -> NDArray[np.int64]:
    """The branch of every stored attractor (omega, gamma, id), numbered line by line; -1: none."""
    places = np.arange(MAX_FOLLOWED)
    exists = places < arrays["attractor_count"][..., np.newaxis]
    before = np.maximum(arrays["next_down"].astype(np.int64) - 1, 0)
    goes_on = exists & (arrays["next_down"] > 0)
    goes_on[:, 0] = False
    goes_on[:, 1:] &= np.take_along_axis(arrays["next_up"][:, :-1], before[:, 1:], axis=2) == places + 1
    branch = np.where(exists, np.cumsum(exists & ~goes_on).reshape(exists.shape) - 1, -1)
    for j in range(1, exists.shape[1]):
        same = np.take_along_axis(branch[:, j - 1], before[:, j], axis=1)
        branch[:, j] = np.where(goes_on[:, j], same, branch[:, j])
    return branch


def _votes(arrays: _Arrays, branch: NDArray[np.int64]) -> Mapping[tuple[int, int], int]:
    """For pairs of branches of neighbouring lines, the number of cells in which they match."""
    votes: Counter[tuple[int, int]] = Counter()
    exists = branch >= 0
    for i in range(1, len(branch)):
        for j in range(branch.shape[1]):
            for k, before in _nearest(arrays, exists, i, j):
                votes[int(branch[i - 1, j, before]), int(branch[i, j, k])] += 1
    return votes


def _nearest(arrays: _Arrays, exists: NDArray[np.bool_], i: int, j: int) -> Iterator[tuple[int, int]]:
    """Matching attractors of the cells (i, j) and (i - 1, j): of the same mode, nearest flights first."""
    longest = arrays["longest_flight"]
    pairs = sorted(
        (abs(float(longest[i, j, k] - longest[i - 1, j, before])), k, before)
        for k in np.flatnonzero(exists[i, j]).tolist()
        for before in np.flatnonzero(exists[i - 1, j]).tolist()
        if all(arrays[name][i, j, k] == arrays[name][i - 1, j, before] for name in _MODE)
    )
    taken, taken_before = set[int](), set[int]()
    for difference, k, before in pairs:
        near = difference <= NEAR or arrays["attractor_outcome"][i, j, k] == Outcome.APERIODIC
        if near and k not in taken and before not in taken_before:
            taken.add(k)
            taken_before.add(before)
            yield k, before


def _labels(arrays: _Arrays, ids: NDArray[np.int64]) -> NDArray[np.object_]:
    """The label of every stored attractor; empty where there is none."""
    labels, exists = np.full(ids.shape, "", object), ids > 0
    modes = zip(*(arrays[name][exists].tolist() for name in _MODE), strict=True)
    labels[exists] = [attractor_label(*mode) for mode in modes]
    return labels


def _commonest(ids: NDArray[np.int64], labels: NDArray[np.object_]) -> dict[int, str]:
    counts = Counter(zip(ids[ids > 0].tolist(), labels[ids > 0].tolist(), strict=True))
    ranked = sorted(counts, key=lambda pair: (-counts[pair], pair[1]))
    return dict(reversed(ranked))


def _events(
    spec: MultistabilitySpec, arrays: _Arrays, ids: NDArray[np.int64], labels: Any, rows: slice
) -> Iterator[tuple[Any, ...]]:
    """Births, deaths and changes of mode between decided cells of the lines `rows`, as _OF_EVENTS."""
    decided = np.any(ids, axis=-1)
    omega, gamma = (spec.axis_values(axis).tolist() for axis in _PLANE)
    for i in range(len(omega))[rows]:
        for j in np.flatnonzero(decided[i, :-1] & decided[i, 1:]).tolist():
            below, above = (
                {n: label for n, label in zip(ids[i, k].tolist(), labels[i, k], strict=True) if n}
                for k in (j, j + 1)
            )
            for number in sorted(below.keys() | above.keys()):
                before, after = below.get(number, ""), above.get(number, "")
                if before == after:
                    continue
                kind, leads_to = "mode", 0
                if not before or not after:
                    kind, cell, other = ("death", j, j + 1) if before else ("birth", j + 1, j)
                    leads = arrays["next_up" if before else "next_down"][i, cell]
                    reached = int(leads[ids[i, cell] == number][0])
                    leads_to = int(ids[i, other, reached - 1]) if reached > 0 else 0
                yield kind, number, omega[i], gamma[j], gamma[j + 1], before, after, leads_to


#: Colours of cells by their number of attractors.
COUNTS: Final[dict[str, str]] = dict(
    zip(
        ("not computed", "undecided", "one attractor", "two", "three", "four or more"),
        pictures.PALETTE["attractor_counts"], strict=True,
    )
)  # fmt: skip

#: Colours by id: for none, for the attractors with most cells, and for all others.
_BY_ID: Final = (pictures.UNDECIDED, *pictures.ATTRACTORS, pictures.OTHER_ATTRACTORS)


def draw(result: xarray.Dataset, figure: pictures.Figure) -> None:
    """Draw two maps, the number of attractors and the one that most drops reach; or the flights of a line."""
    if "flight_time" in result:
        _draw_line(result, figure.subplots())
        return
    left, right = figure.subplots(1, 2, sharey=True)
    number = np.clip(result["count"].values + 1, 0, len(COUNTS) - 1)
    sides = pictures.edges(result.gamma.values), pictures.edges(result.omega.values)  # the grid may be uneven
    pictures.draw_cells(left, *sides, number, COUNTS.values())
    pictures.legend_beside(left, pictures.entries(number, COUNTS))
    first = result.id.values[:, :, 0]
    pictures.draw_cells(right, *sides, np.minimum(first, len(_BY_ID) - 1), _BY_ID)
    _name_attractors(right, result.isel(attractor=np.isin(result.attractor, first)))
    several = result.attrs["several"]
    share = "" if np.isnan(several) else f": several in {100.0 * several:.1f} %"
    for axes in (left, right):
        pictures.mark_single(axes, result.gamma.values, result.omega.values)
    left.set(xlabel=pictures.SYMBOLS["gamma"], ylabel=pictures.SYMBOLS["omega"])
    right.set_xlabel(pictures.SYMBOLS["gamma"])
    left.set_title(f"attractors of a cell{share}", fontsize=11)
    right.set_title("the attractor that most drops reach", fontsize=11)
    figure.suptitle(f"{pictures.values_at(result, ['xi'])}  ({result.attrs['model']})", fontsize=11)


def _draw_line(result: xarray.Dataset, axes: pictures.Axes) -> None:
    """Draw the flights of each attractor in its colour; an attractor at rest has a point at 0."""
    ids, times = result.id.values[0], result.flight_time.values[0].copy()
    times[~np.isfinite(times).any(axis=-1), 0] = 0.0
    gamma = np.broadcast_to(result.gamma.values[:, np.newaxis, np.newaxis], times.shape)
    size = 2.0 * pictures.dot_of(len(gamma))
    for number in np.unique(ids[ids > 0])[::-1].tolist():
        shown = (ids == number)[..., np.newaxis] & np.isfinite(times)
        colour = _BY_ID[min(number, len(_BY_ID) - 1)]
        axes.plot(gamma[shown], times[shown], ".", color=colour, markersize=size, markeredgewidth=0.0)
    axes.set(xlabel=pictures.SYMBOLS["gamma"], ylabel=pictures.FLIGHT)
    values = pictures.values_at(result, ("omega", "xi"))
    axes.set_title(f"coexisting attractors, {values}  ({result.attrs['model']})", fontsize=11)
    _name_attractors(axes, result)


def _name_attractors(axes: pictures.Axes, result: xarray.Dataset) -> None:
    from matplotlib.patches import Patch

    named = zip(result.attractor.values.tolist(), result.attractor_label.values.tolist(), strict=True)
    entries = [
        Patch(color=_BY_ID[number], label=f"{number}: mostly {label}")
        for number, label in named
        if number < len(_BY_ID) - 1
    ]
    if others := result.sizes["attractor"] - len(entries):
        entries.append(Patch(color=_BY_ID[-1], label=f"{others} more"))
    pictures.legend_beside(axes, entries)


VIEW: Final = View(
    "multistability", "Attractors over a grid", MultistabilitySpec, MultistabilityQuery, compute, estimate,
    variables=_ROWS, rows="fraction", finer_rows="flight_time", printed=("cells",),
    draw=draw, size=(10.0, 4.2),
)  # fmt: skip
