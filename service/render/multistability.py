"""Attractors over a plane or along a line as JSON, CSV and as a picture."""

import csv
import io
from dataclasses import asdict
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from service.formats import PictureFormat
from service.render.style import COLOURS, FONT, SYMBOLS, TEXT, UNDECIDED, Origin, encode
from service.render.text import to_json
from service.results.multistability import Attractor, Place, Plane

#: Inches: of the plane, and of a line.
PLANE_SIZE: Final = (10.0, 4.2)
LINE_SIZE: Final = (7.6, 4.4)

#: Colours of cells by their number of attractors: not computed, none, 1, 2, 3, 4 and more.
COUNTS: Final = (UNDECIDED, "#bbbbbb", "#e8edf2", "#56b4e9", "#d55e00", "#000000")

#: Attractors with a colour of their own, by id; all others are grey.
COLOURED: Final = len(COLOURS) - 1
OTHERS: Final = "#999999"


#: The columns of a table of a plane, one row for each attractor of a cell; of a line, one for each flight.
COLUMNS: Final = ("gamma", "omega", "xi", "attractor", "label", "fraction", "longest_flight_rad")
LINE_COLUMNS: Final = (*COLUMNS[:6], "flight", "flight_time_rad")


def multistability_json(plane: Plane, flights: NDArray[np.float64] | None = None) -> bytes:
    """The plane as a JSON document; `flights` (gamma, attractor, flight) of a line, rad, if it is one."""
    return to_json(
        {
            "xi": plane.xi,
            "omega": plane.omega.tolist(),
            "gamma": plane.gamma.tolist(),
            "count": [[None if n < 0 else n for n in line] for line in plane.count.tolist()],
            "cells": [
                [[_place(plane, place, j, k, flights) for k, place in enumerate(cell)]
                 for j, cell in enumerate(line)]
                for line in plane.cells
            ],
            "attractors": [asdict(attractor) for attractor in plane.attractors],
            "events": [asdict(event) for event in plane.events],
            "several": plane.several,
            "several_by_drops": plane.several_by_drops,
            "complete": plane.complete,
        }
    )  # fmt: skip


def _place(plane: Plane, place: Place, j: int, k: int, flights: NDArray[np.float64] | None) -> dict[str, Any]:
    times = {} if flights is None else {"flight_time": _counted(plane, flights[j, k]).tolist()}
    return place._asdict() | times


def _counted(plane: Plane, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """The flights that count: those longer than `micro_flight`, unless none is."""
    stored = times[np.isfinite(times)]
    longer = stored[stored > plane.spec.micro_flight]
    return longer if len(longer) else stored


def multistability_csv(plane: Plane, flights: NDArray[np.float64] | None = None) -> bytes:
    """The plane as a table of COLUMNS, or with the flights of a line as one of LINE_COLUMNS."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS if flights is None else LINE_COLUMNS)
    for omega, line in zip(plane.omega.tolist(), plane.cells, strict=True):
        for j, (gamma, cell) in enumerate(zip(plane.gamma.tolist(), line, strict=True)):
            for k, place in enumerate(cell):
                row = (gamma, omega, plane.xi, place.id, place.label, place.fraction)
                if flights is None:
                    table.writerow((*row, place.longest_flight))
                    continue
                times = _counted(plane, flights[j, k]).tolist()
                table.writerows((*row, n, flight) for n, flight in enumerate(times))
    return text.getvalue().encode()


def draw(plane: Plane, format: PictureFormat, origin: Origin) -> bytes:
    """A picture of two maps: the number of attractors, and the one that most drops reach."""
    return encode(PLANE_SIZE, lambda figure: _draw(figure, plane), format, origin)


def draw_line(plane: Plane, flights: NDArray[np.float64], format: PictureFormat, origin: Origin) -> bytes:
    """A picture of the flights (gamma, attractor, flight) of one line, each attractor in its colour."""
    return encode(LINE_SIZE, lambda figure: _draw_line(figure, plane, flights), format, origin)


def _colour(number: int) -> str:
    return COLOURS[number - 1] if number <= COLOURED else OTHERS


def _draw(figure: Figure, plane: Plane) -> None:
    left, right = figure.subplots(1, 2, sharey=True)
    number = np.clip(plane.count + 1, 0, len(COUNTS) - 1)
    _map(left, plane, number, COUNTS)
    names = ("not computed", "undecided", "one attractor", "two", "three", "four or more")
    _legend(left, [Patch(facecolor=COUNTS[n], edgecolor="black", linewidth=0.5, label=names[n])
                   for n in np.unique(number).tolist()])  # fmt: skip
    first = np.array([[cell[0].id if cell else 0 for cell in line] for line in plane.cells])
    _map(right, plane, np.minimum(first, COLOURED + 1), (UNDECIDED, *COLOURS[:COLOURED], OTHERS))
    _attractors(right, [a for a in plane.attractors if a.id in set(first.ravel().tolist())])
    left.set_ylabel(SYMBOLS["omega"], **TEXT)
    share = "" if np.isnan(plane.several) else f": several in {100.0 * plane.several:.1f} %"
    left.set_title(f"attractors of a cell{share}", fontsize=11, **TEXT)
    right.set_title("the attractor that most drops reach", fontsize=11, **TEXT)
    figure.suptitle(f"{SYMBOLS['xi']} = {plane.xi:g}  ({plane.spec.model.kind})", fontsize=11, **TEXT)


def _map(axes: Axes, plane: Plane, values: NDArray[np.int64], colours: tuple[str, ...]) -> None:
    """Cells in the colours of their values; the grid may be uneven."""
    axes.pcolormesh(
        _edges(plane.gamma), _edges(plane.omega), values, cmap=ListedColormap(list(colours)),
        vmin=-0.5, vmax=len(colours) - 0.5, rasterized=True,
    )  # fmt: skip
    axes.set_xlabel(SYMBOLS["gamma"], **TEXT)
    for tick in (*axes.get_xticklabels(), *axes.get_yticklabels()):
        tick.set(**TEXT)


def _edges(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ends of the cells around increasing values."""
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middle = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([[2.0 * values[0] - middle[0]], middle, [2.0 * values[-1] - middle[-1]]])


def _draw_line(figure: Figure, plane: Plane, flights: NDArray[np.float64]) -> None:
    axes = figure.subplots()
    points: dict[int, list[tuple[float, NDArray[np.float64]]]] = {}
    for j, cell in enumerate(plane.cells[0]):
        for k, place in enumerate(cell):
            times = _counted(plane, flights[j, k])
            points.setdefault(place.id, []).append(
                (float(plane.gamma[j]), times if len(times) else np.zeros(1))
            )
    for number in sorted(points, reverse=True):
        x = np.concatenate([np.full(len(times), gamma) for gamma, times in points[number]])
        y = np.concatenate([times for _, times in points[number]])
        axes.plot(x, y, ".", color=_colour(number), markersize=2.5, markeredgewidth=0.0)
    axes.set_xlabel(SYMBOLS["gamma"], **TEXT)
    axes.set_ylabel("flight time (rad)", **TEXT)
    for tick in (*axes.get_xticklabels(), *axes.get_yticklabels()):
        tick.set(**TEXT)
    values = f"{SYMBOLS['omega']} = {plane.omega[0]:g}, {SYMBOLS['xi']} = {plane.xi:g}"
    axes.set_title(f"coexisting attractors, {values}  ({plane.spec.model.kind})", fontsize=11, **TEXT)
    _attractors(axes, list(plane.attractors))


def _attractors(axes: Axes, attractors: list[Attractor]) -> None:
    entries = [
        Patch(color=_colour(a.id), label=f"{a.id}: mostly {a.label}") for a in attractors if a.id <= COLOURED
    ]
    others = sum(a.id > COLOURED for a in attractors)
    if others:
        entries.append(Patch(color=OTHERS, label=f"{others} more"))
    _legend(axes, entries)


def _legend(axes: Axes, entries: list[Patch]) -> None:
    axes.legend(
        handles=entries, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False,
        prop={"family": FONT, "size": 10},
    )  # fmt: skip
