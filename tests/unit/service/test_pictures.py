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
from service.render import multistability, work_precision
from service.render.style import DPI
from service.results.multistability import Attractor, Place, Plane
from service.views import diagram
from worker.analysis.work_precision import Measurement
from worker.basins.spec import MultistabilitySpec

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


def diagram_both_ways(figure: Figure) -> None:
    """Flights over gamma, the same up and down: none, then up to three, some of them long."""
    number = np.arange(40) % 4
    times = 1.0 + np.arange(120.0).reshape(40, 3) % 31
    times[np.arange(3) >= number[:, None]] = NAN
    found = xarray.Dataset(
        {"flight_time": (("direction", "gamma", "flight"), [times, times]), "outcome": ("gamma", number + 1)},
        {"direction": ["up", "down"], "gamma": np.linspace(0.5, 3.5, 40), "omega": 0.5, "xi": 0.26},
        {"along": "gamma", "complete": False, "caption": "rigid contact, 10 of 40 cells unresolved"},
    )
    diagram.draw(found, figure)


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
    "diagram": (diagram.SIZE, diagram_both_ways),
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
