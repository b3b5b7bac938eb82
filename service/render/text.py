"""Diagrams and mode maps as JSON and as tables."""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from kernel.params import Outcome
from service.results.diagram import Diagram
from service.results.mode_map import Plane

#: The columns of the table, with units where there are any. One row is one flight.
COLUMNS: Final = (
    "direction",
    "gamma",
    "omega",
    "xi",
    "flight",
    "flight_time_rad",
    "takeoff_phase_rad",
    "outcome",
    "bounces",
    "periods",
)

#: A value as JSON, ten times as fast as the standard library does it; null for NaN, which JSON has not.
to_json: Final = TypeAdapter(Any).dump_json

#: Cells written as JSON at a time; other threads get their turn in between.
CELLS: Final = 4096


def as_json(diagram: Diagram) -> bytes:
    """The diagram as a JSON document; every list of flights is as long as there are flights to show."""
    whole = {"along": diagram.along, "fixed": diagram.fixed, "direction": diagram.direction}
    members = {name: to_json(value) for name, value in whole.items()}
    members |= {
        "values": _list(diagram.values),
        "flight_time": _lists(diagram.flight_time, diagram.shown),
        "takeoff_phase": _lists(diagram.takeoff_phase, diagram.shown),
    }
    members |= {name: _list(getattr(diagram, name)) for name in ("flights", "outcome", "bounces", "periods")}
    return _object(members, diagram.complete, diagram.every)


def modes_as_json(plane: Plane) -> bytes:
    """A mode map as a JSON document; arrays as lists of rows, one for each Ω."""
    members = {
        "xi": to_json(plane.xi),
        "direction": to_json(plane.direction),
        "omega": _list(plane.omega),
        "gamma": _list(plane.gamma),
        **{name: _list(array) for name, array in plane.arrays.items()},
    }
    return _object(members, plane.complete, plane.every)


def as_csv(diagrams: Sequence[Diagram]) -> bytes:
    """A table with a header and one row a flight; cells without flights have none."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for diagram in diagrams:
        table.writerows(_rows(diagram))
    return text.getvalue().encode()


def _object(members: Mapping[str, bytes], complete: bool, every: int) -> bytes:
    """A JSON object; that the cells are not all of them is said only where it is so."""
    ends = {"complete": to_json(complete)} | ({"every": to_json(every)} if every > 1 else {})
    return (
        b"{"
        + b",".join(b'"%s":%s' % (name.encode(), text) for name, text in {**members, **ends}.items())
        + b"}"
    )


def _list(array: NDArray[Any]) -> bytes:
    """A JSON list, of lists where the array has rows."""
    step = max(1, CELLS // max(1, array[:1].size))
    parts = (to_json(array[low : low + step].tolist())[1:-1] for low in range(0, len(array), step))
    return b"[" + b",".join(parts) + b"]"


def _lists(values: NDArray[np.float64], shown: NDArray[np.bool_]) -> bytes:
    """A list for every cell, of the values that are shown."""
    parts = []
    step = max(1, CELLS // max(1, values.shape[1]))
    for low in range(0, len(values), step):
        rows = zip(values[low : low + step], shown[low : low + step], strict=True)
        parts.append(to_json([row[mask].tolist() for row, mask in rows])[1:-1])
    return b"[" + b",".join(parts) + b"]"


def _rows(diagram: Diagram) -> Iterator[list[Any]]:
    outcomes = {int(outcome): outcome.name.lower() for outcome in Outcome}
    for cell, value in enumerate(diagram.values.tolist()):
        point = {**diagram.fixed, diagram.along: value}
        place = [diagram.direction, point["gamma"], point["omega"], point["xi"]]
        what = [outcomes[int(diagram.outcome[cell])], int(diagram.bounces[cell]), int(diagram.periods[cell])]
        times, phases = diagram.flight_time[cell].tolist(), diagram.takeoff_phase[cell].tolist()
        for flight in np.flatnonzero(diagram.shown[cell]).tolist():
            yield [*place, flight, times[flight], phases[flight], *what]
