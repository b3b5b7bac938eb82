"""Pictures of the service and of the client, drawn from small data and read back from their artists.

What is drawn has to be what tests/golden/pictures.json says; `python tests/unit/service/test_pictures.py`
writes that file anew, after a look at the pictures.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[2] / "support"), str(Path(__file__).parents[3])]

from artists import difference, read_back
from paths import GOLDEN, ROOT

from kernel.labels import LABELS
from kernel.params import Outcome
from service.client import plots
from service.render import basins, bifurcation, multistability, work_precision
from service.render.style import DPI
from service.results.basins import Attractor as BasinAttractor
from service.results.basins import BasinCell
from service.results.counting import LABEL
from service.results.diagram import Diagram
from service.results.multistability import Attractor, Place, Plane
from worker.analysis.work_precision import Measurement
from worker.basins.spec import BasinSpec, MultistabilitySpec
from worker.spec import SweepSpec

DRAWN = GOLDEN / "pictures.json"
NAN = float("nan")
CELL: dict[str, Any] = {"gamma": [1.1, 1.2, 1.4], "omega": [0.5, 0.6], "xi": 0.26, "model": {"kind": "rigid"}}

Draw = Callable[[Figure], object]


def plane(number: int = 12, **changes: Any) -> Plane:
    """Cells of 2 frequencies, of 0 to 5 of `number` attractors; one is not computed."""
    ids = [[(1,), (2, 1), (3, 1, 12)], [(), (9, 8, 7, 5), (12, 1, 2, 3, 4)]]
    cells = tuple(
        tuple(tuple(Place(n, f"({n},1)", 0.5 / n, 1.5 * n) for n in cell) for cell in line) for line in ids
    )
    count = np.array([[len(cell) for cell in line] for line in ids])
    count[1, 0] = -1
    attractors = tuple(
        Attractor(n, f"({n},1)", 13 - n, (1.1, 1.4), (0.5, 0.6), (1.5 * n, 2.0 * n))
        for n in range(1, number + 1)
    )
    fields: dict[str, Any] = {
        "spec": MultistabilitySpec(**CELL, protocol={"kind": "multistability"}),
        "xi": 0.26,
        "omega": np.array([0.5, 0.6]),
        "gamma": np.array([1.1, 1.2, 1.4]),
        "count": count,
        "cells": cells,
        "attractors": attractors,
        "events": (),
        "complete": True,
    }
    return Plane(**(fields | changes))


def line() -> Plane:
    """The first frequency alone, the flights of its attractors, one of them at rest."""
    return plane(omega=np.array([0.5]), count=plane().count[:1], cells=plane().cells[:1])


def flights() -> np.ndarray:
    """(gamma, attractor, flight): two flights of each attractor; the second's are too short to count."""
    times = np.arange(1.0, 19.0).reshape(3, 3, 2)
    times[:, 1] = 1e-9
    times[0, 0, 1] = NAN
    return times


def empty_plane() -> Plane:
    count = np.full((2, 1), -1)
    return plane(0, gamma=np.array([1.1]), count=count, cells=(((),), ((),)))


def basin(count: int, **changes: Any) -> BasinCell:
    attractors = tuple(
        BasinAttractor(
            id=n, fraction=0.75 / n**2, outcome=int(Outcome.PERIODIC), label=f"({n},1)", bounces=n, periods=1,
            longest_flight=0.0 if n == 2 else 1.5 * n, lifetime=float("inf"), state=np.zeros(4),
            flight_time=np.array([1.5 * n]), takeoff_phase=np.array([0.5]), lyapunov=None,
        )
        for n in range(1, count + 1)
    )  # fmt: skip
    rows, columns = 2, 4
    fields: dict[str, Any] = {
        "gamma": 1.1,
        "omega": 0.5,
        "xi": 0.26,
        "spec": BasinSpec(**CELL, protocol={"kind": "basin", "rows": rows, "columns": columns}),
        "map": np.arange(rows * columns, dtype=np.uint8).reshape(rows, columns) % (count + 1),
        "attractors": attractors,
        "numbers": {"undecided": 0.125} if count else {},
        "complete": True,
    }
    return BasinCell(**(fields | changes))


def diagram(direction: str, cells: int, **changes: Any) -> Diagram:
    """Flights over gamma: none, then up to three, some of them long."""
    number = np.arange(cells) % 4
    times = 1.0 + np.arange(3.0 * cells).reshape(cells, 3) % 31
    times[np.arange(3) >= number[:, None]] = NAN
    outcome = np.array([Outcome.AT_REST, Outcome.PERIODIC, Outcome.APERIODIC, Outcome.UNRESOLVED], np.uint8)
    labels = np.array([LABELS.index(name) for name in ("at_rest", "periodic", "chaotic", "unresolved")])
    fields: dict[str, Any] = {
        "along": "gamma",
        "fixed": {"omega": 0.5, "xi": 0.26},
        "direction": direction,
        "values": np.linspace(0.5, 3.5, cells),
        "arrays": {
            "flight_time": times,
            "flights": number.astype(np.int32),
            "outcome": outcome[number],
            LABEL.name: labels[number].astype(np.uint8),
        },
    }
    return Diagram(**(fields | changes))


def diagrams(*drawn: Diagram) -> Draw:
    spec = SweepSpec(**CELL | {"gamma": [0.5, 3.5], "omega": 0.5})
    return lambda figure: bifurcation._draw(figure.subplots(), drawn, spec)


def tradeoff(figure: Figure) -> None:
    rows = json.loads((GOLDEN / "tradeoff_rows.json").read_text())["rows"]
    work_precision.compose(figure, [Measurement.model_validate(row) for row in rows])


def client_diagram(figure: Figure) -> None:
    axes = figure.subplots()
    for direction in ("rest", "up", "down"):
        times = np.array([[NAN, NAN], [4.0, NAN], [3.0, 6.0]])
        fixed = {"omega": 0.5, "xi": 0.26, "direction": direction}
        dataset = xarray.Dataset({"flight_time": (("gamma", "flight"), times)})
        plots.draw_diagram(axes, dataset.assign_coords(gamma=[1.1, 1.2, 1.4], **fixed))
    shape = ("branch", "point")
    branches = xarray.Dataset(
        {
            "flight_time": (shape, np.arange(8.0).reshape(2, 4)),
            "stable": (shape, np.array([[1, 1, 0, 0], [0, 1, 1, 1]])),
            "admissible": (shape, np.array([[0, 2, 0, 3], [0, 0, 0, 1]])),
            "gamma": (shape, 1.0 + np.arange(8.0).reshape(2, 4) / 20),
        }
    )
    plots.draw_branches(axes, branches)


def client_map(figure: Figure) -> None:
    """Every label, cycles of 1 to 6 plate periods; without labels, the outcomes."""
    left, right = figure.subplots(1, 2)
    codes = np.array([*range(len(LABELS)), *[LABELS.index("periodic")] * 5, 0], np.uint8)[:12].reshape(2, 6)
    modes = xarray.Dataset(
        {
            "outcome": (("omega", "gamma"), np.minimum(codes, int(Outcome.UNRESOLVED))),
            "periods": (("omega", "gamma"), np.array([[0, 1, 0, 0, 0, 0], [0, 2, 3, 4, 5, 6]])),
        }
    ).assign_coords(omega=[0.5, 0.6], gamma=[1.0, 1.1, 1.2, 1.3, 1.4, 1.5], xi=0.26)
    plots.draw_modes(left, modes)
    plots.draw_modes(right, modes.assign(label=(("omega", "gamma"), codes)))


def client_thresholds(figure: Figure) -> None:
    """On the left up and down, on the right up alone."""
    values = {"analytic": [1.0, 1.1, 1.3], "predicted_down": [0.8, NAN, 1.0], "up": [1.0, 1.1, 1.31]}
    for axes, down in zip(figure.subplots(1, 2), ([0.8, 0.9, 1.01], [NAN] * 3), strict=True):
        columns = {name: ("omega", column) for name, column in (values | {"down": down}).items()}
        plots.draw_thresholds(axes, xarray.Dataset(columns).assign_coords(omega=[0.5, 0.6, 0.8], xi=0.26))


#: Size in inches, and what draws.
PICTURES: dict[str, tuple[tuple[float, float], Draw]] = {
    "multistability": (multistability.PLANE_SIZE, lambda figure: multistability._draw(figure, plane())),
    "multistability, not computed": (
        multistability.PLANE_SIZE, lambda figure: multistability._draw(figure, empty_plane())
    ),
    "multistability, a line": (
        multistability.LINE_SIZE, lambda figure: multistability._draw_line(figure, line(), flights())
    ),
    "basin": (basins.SIZE, lambda figure: basins._draw(figure, basin(3))),
    "basin, many attractors": (basins.SIZE, lambda figure: basins._draw(figure, basin(20))),
    "basin, some attractors": (basins.SIZE, lambda figure: basins._draw(figure, basin(basins.ROOMY))),
    "basin, not computed": (basins.SIZE, lambda figure: basins._draw(figure, basin(0))),
    "diagram": (bifurcation.SIZE, diagrams(diagram("up", 40), diagram("down", 40, repairing=True))),
    "diagram, dense": (bifurcation.SIZE, diagrams(diagram("rest", 80_000))),
    "tradeoff": (work_precision.SIZE, tradeoff),
    "client's diagram": ((6.4, 4.8), client_diagram),
    "client's map": ((12.8, 4.8), client_map),
    "client's thresholds": ((12.8, 4.8), client_thresholds),
}  # fmt: skip


def drawn(name: str) -> list[str]:
    size, draw = PICTURES[name]
    with mpl.rc_context(mpl.rcParamsDefault):
        figure = Figure(figsize=size, dpi=DPI, layout="constrained")
        draw(figure)
        return read_back(figure)


def test_an_attractor_without_flights_is_a_point_on_the_axis_at_each_of_its_cells():
    figure = Figure()
    multistability._draw_line(figure, line(), np.full((3, 3, 2), NAN))
    (axes,) = figure.axes
    points = sorted(tuple(point) for drawn in axes.lines for point in drawn.get_xydata())
    assert points == [(1.1, 0.0), (1.2, 0.0), (1.2, 0.0), (1.4, 0.0), (1.4, 0.0), (1.4, 0.0)]


def test_what_was_not_measured_is_not_drawn():
    """No cost where all steps are refused, no error where it is infinite."""
    rows = json.loads((GOLDEN / "tradeoff_rows.json").read_text())["rows"]
    measured = [Measurement.model_validate(row) for row in rows if row["purpose"] == "adhesive"]
    lacking = [
        measured[-1].model_copy(update=dict(zip(("error", "cost"), numbers, strict=True)))
        for numbers in ((None, None), (None, 3.0), (1e-3, None))
    ]

    def lines(rows: list[Measurement]) -> int:
        figure = Figure(figsize=work_precision.SIZE)
        work_precision.compose(figure, rows)
        return sum(len(axes.lines) for axes in figure.axes)

    assert lines([*measured, *lacking]) == lines(measured)


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_draws_what_it_did(name: str):
    assert difference(drawn(name), json.loads(DRAWN.read_text())["pictures"][name]) == ""


def write() -> None:
    """Write what each picture draws, as it is now."""
    source = f"what the artists of each picture draw, read back by python {Path(__file__).relative_to(ROOT)}"
    pictures = {name: drawn(name) for name in PICTURES}
    DRAWN.write_text(
        json.dumps({"source": source, "pictures": pictures}, indent=1, ensure_ascii=False) + "\n"
    )


if __name__ == "__main__":
    write()
