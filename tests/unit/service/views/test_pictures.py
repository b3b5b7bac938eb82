"""Pictures of the service and of the client, drawn from small data and read back from their artists.

What is drawn has to be what tests/golden/pictures.json says;
`python tests/unit/service/views/test_pictures.py` writes that file anew, after a look at the pictures.
"""

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure
from matplotlib.patches import Patch

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[3] / "support"), str(Path(__file__).parents[4])]

from artists import difference, read_back
from paths import GOLDEN, ROOT
from tables import for_each

from kernel.labels import LABELS
from kernel.params import Outcome
from kernel.threshold import threshold as threshold_of
from service.figures import tradeoff
from service.pictures import (
    CLASSES,
    DPI,
    STYLE,
    draw_branches,
    draw_diagram,
    draw_modes,
    draw_thresholds,
    legend_beside,
)
from service.views import diagram, modes, multistability, threshold
from service.views.encode import picture
from service.views.selection import LABEL, Stored
from worker.sweep import SweepSpec

DRAWN = GOLDEN / "pictures.json"
NAN = float("nan")
CELL: dict[str, Any] = {"gamma": [1.1, 1.2, 1.4], "omega": [0.5, 0.6], "xi": 0.26, "model": {"kind": "rigid"}}

PLANE = ("omega", "gamma")
AT_REST = {"outcome": int(Outcome.AT_REST), "periods": 0, "bounces": 0}

Draw = Callable[[Figure], object]


def plane(number: int = 12) -> xarray.Dataset:
    """Cells of 2 frequencies, of 0 to 5 of `number` attractors; one is not computed."""
    ids = np.zeros((2, 3, 5), int)
    cells = {(0, 0): (1,), (0, 1): (2, 1), (0, 2): (3, 1, 12), (1, 1): (9, 8, 7, 5), (1, 2): (12, 1, 2, 3, 4)}
    for cell, there in cells.items():
        ids[cell][: len(there)] = there
    return _attractors(ids, [[1, 2, 3], [-1, 4, 5]], [1.1, 1.2, 1.4], number, 0.8)


def line() -> xarray.Dataset:
    """The first frequency alone, with two flights of its attractors, very short ones of the second."""
    times = np.full((1, 3, 5, 2), NAN)
    times[0, :, :3] = np.arange(1.0, 19.0).reshape(3, 3, 2)
    times[0, :, 1] = 1e-9
    times[0, 0, 0, 1] = NAN
    return plane().isel(omega=[0]).assign(flight_time=(("omega", "gamma", "place", "flight"), times))


def empty_plane() -> xarray.Dataset:
    return _attractors(np.zeros((2, 1, 1), int), [[-1], [-1]], [1.1], 0, NAN)


def _attractors(ids: Any, count: Any, gamma: Any, number: int, several: float) -> xarray.Dataset:
    numbers = np.arange(1, number + 1)
    return xarray.Dataset(
        {"id": ((*PLANE, "place"), ids), "count": (PLANE, np.array(count)),
         "attractor_label": ("attractor", [f"({n},1)" for n in numbers])},
        {"omega": [0.5, 0.6], "gamma": gamma, "attractor": numbers, "xi": 0.26},
        {"several": several, "model": "rigid"},
    )  # fmt: skip


def diagrams(cells: int, directions: list[str], **attrs: Any) -> Draw:
    """Flights over gamma: none, then up to three, some of them long."""
    number = np.arange(cells) % 4
    times = 1.0 + np.arange(3.0 * cells).reshape(cells, 3) % 31
    times[np.arange(3) >= number[:, None]] = NAN
    outcome = np.array([Outcome.AT_REST, Outcome.PERIODIC, Outcome.APERIODIC, Outcome.UNRESOLVED], np.uint8)
    labels = np.array([LABELS.index(name) for name in ("at_rest", "periodic", "chaotic", "unresolved")])
    found = xarray.Dataset(
        {"flight_time": (("gamma", "flight"), times), "outcome": ("gamma", outcome[number]),
         LABEL.name: ("gamma", labels[number].astype(np.uint8)),
         "bounces": ("gamma", number == 1), "periods": ("gamma", number)},
        {"gamma": np.linspace(0.5, 3.5, cells), "omega": 0.5, "xi": 0.26},
        {"along": "gamma", "min_flight": 0.0, "every": 1, "complete": True, **attrs},
    )  # fmt: skip
    spec = SweepSpec(**CELL | {"gamma": [0.5, 3.5], "omega": 0.5})
    both = xarray.concat([found] * len(directions), xarray.Variable("direction", directions))
    found = both.assign_coords(found.coords) if len(directions) > 1 else both.isel(direction=0)
    found.attrs["caption"] = diagram._caption(spec, found)
    return lambda figure: diagram.draw(found, figure)


def contacts(figure: Figure) -> None:
    columns = json.loads((GOLDEN / "tradeoff_rows.json").read_text())["variables"]
    numbers = {name: ("setting", np.array(columns[name], float)) for name in ("cost", "error", "error_95")}
    tradeoff.draw(xarray.Dataset(numbers), figure)


def client_diagram(figure: Figure) -> None:
    axes = figure.subplots()
    times = np.array([[NAN, NAN], [4.0, NAN], [3.0, 6.0]])
    dataset = xarray.Dataset({"flight_time": (("direction", "gamma", "flight"), np.stack([times, times]))})
    fixed = {"omega": 0.5, "xi": 0.26, "direction": ["up", "down"]}
    draw_diagram(axes, dataset.assign_coords(gamma=[1.1, 1.2, 1.4], **fixed))
    shape = ("branch", "point")
    branches = xarray.Dataset(
        {
            "flight_time": (shape, np.arange(8.0).reshape(2, 4)),
            "stable": (shape, np.array([[1, 1, 0, 0], [0, 1, 1, 1]])),
            "violations": (shape, np.array([[0, 2, 0, 3], [0, 0, 0, 1]])),
            "gamma": (shape, 1.0 + np.arange(8.0).reshape(2, 4) / 20),
        }
    )
    draw_branches(axes, branches)


def client_map(figure: Figure) -> None:
    """Every label, cycles of 1 to 6 plate periods; without labels, the outcomes."""
    left, right = figure.subplots(1, 2)
    codes = np.array([*range(len(LABELS)), *[LABELS.index("periodic")] * 5, 0], np.uint8)[:12].reshape(2, 6)
    cells = xarray.Dataset(
        {
            "outcome": (("omega", "gamma"), np.minimum(codes, int(Outcome.UNRESOLVED))),
            "periods": (("omega", "gamma"), np.array([[0, 1, 0, 0, 0, 0], [0, 2, 3, 4, 5, 6]])),
            "bounces": (("omega", "gamma"), np.array([[0, 1, 0, 0, 0, 0], [0, 1, 4, 4, 7, 1]])),
        }
    ).assign_coords(omega=[0.5, 0.6], gamma=[1.0, 1.1, 1.2, 1.3, 1.4, 1.5], xi=0.26)
    draw_modes(left, cells)
    draw_modes(right, cells.assign(label=(("omega", "gamma"), codes)))


def client_thresholds(figure: Figure) -> None:
    """On the left up and down, on the right up alone."""
    values = {"analytic": [1.0, 1.1, 1.3], "predicted_down": [0.8, NAN, 1.0], "up": [1.0, 1.1, 1.31]}
    for axes, down in zip(figure.subplots(1, 2), ([0.8, 0.9, 1.01], [NAN] * 3), strict=True):
        columns = {name: ("omega", column) for name, column in (values | {"down": down}).items()}
        draw_thresholds(axes, xarray.Dataset(columns).assign_coords(omega=[0.5, 0.6, 0.8], xi=0.26))


#: Size in inches, and what draws.
PICTURES: dict[str, tuple[tuple[float, float], Draw]] = {
    "multistability": (multistability.VIEW.size, lambda figure: multistability.draw(plane(), figure)),
    "multistability, not computed": (
        multistability.VIEW.size, lambda figure: multistability.draw(empty_plane(), figure)
    ),
    "multistability, a line": (
        multistability.VIEW.size, lambda figure: multistability.draw(line(), figure)
    ),
    "diagram": (diagram.SIZE, diagrams(40, ["up", "down"], complete=False)),
    "diagram, dense": (diagram.SIZE, diagrams(80_000, ["rest"])),
    "tradeoff": (tradeoff.VIEW.size, contacts),
    "client's diagram": ((6.4, 4.8), client_diagram),
    "client's map": ((12.8, 4.8), client_map),
    "client's thresholds": ((12.8, 4.8), client_thresholds),
}  # fmt: skip


def drawn(name: str) -> list[str]:
    size, draw = PICTURES[name]
    with mpl.rc_context(mpl.rcParamsDefault), mpl.rc_context({} if name.startswith("client") else STYLE):
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


def test_a_legend_of_thresholds_has_what_is_drawn():
    """Of one omega, which has no line, without predictions."""
    columns = {"analytic": [1.0], "predicted_down": [NAN], "up": [NAN], "down": [1.1]}
    axes = Figure().subplots()
    data = {name: ("omega", column) for name, column in columns.items()}
    draw_thresholds(axes, xarray.Dataset(data, {"omega": [0.5], "xi": 0.26}))
    drawn = [(line.get_label(), line.get_marker()) for line in axes.lines]
    assert drawn == [("Eq. 25", "_"), ("computed, down", "v")]


def test_a_map_of_one_row_shows_its_cells():
    """Of one omega, around which there is no distance to the next; the title has the direction of a ramp."""
    cells = {"outcome": [[1, 2, 3]], "periods": [[1, 0, 0]], "bounces": [[1, 0, 0]]}
    data = {name: (("omega", "gamma"), np.array(values)) for name, values in cells.items()}
    axes = Figure().subplots()
    found = xarray.Dataset(data, {"omega": [0.5], "gamma": [1.0, 9.0, 81.0], "xi": 0.2, "direction": "down"})
    draw_modes(axes, found)
    assert (axes.get_title()[-11:], axes.get_xscale(), axes.get_xlim()[0] > 0.3) == (
        ", ramp down",
        "log",
        True,
    )
    assert axes.collections[0].get_datalim(axes.transData).height > 0.0


def test_the_threshold_of_one_row_or_column_is_what_it_is_there():
    """Around one value the axis goes on, but not the cells."""
    row, column = (wide_map(0.5, 1.5).isel({axis: [10]}) for axis in ("omega", "gamma"))
    lines = []
    for cells in (row, column):
        axes = Figure().subplots()
        draw_modes(axes, cells)
        lines.append(axes.lines[-1])
    np.testing.assert_array_equal(lines[0].get_xdata(), threshold_of(row.omega.values, 0.1).repeat(2))
    crossed = np.asarray(lines[1].get_ydata(), float)
    assert len(crossed) > 0
    np.testing.assert_allclose(threshold_of(crossed, 0.1), column.gamma.item(), rtol=0.01)
    gamma = column.gamma.item() + 1e-9 * np.arange(20)  # passed through between two points of the curve
    narrow = wide_map(0.5, 1.5).assign_coords(gamma=gamma)
    for cells, crosses in ((column.assign_coords(gamma=[1e-3]), False), (narrow, True)):
        draw_modes(axes := Figure().subplots(), cells)
        legend = axes.get_legend()
        assert legend is not None
        assert crosses == ("Eq. 25" in " ".join(text.get_text() for text in legend.get_texts()))


def test_an_axis_of_one_value_has_one_tick():
    figure = Figure()
    multistability.draw(plane().isel(omega=[0]), figure)
    assert [axes.get_yticks().tolist() for axes in figure.axes] == [[0.5], [0.5]]


def test_a_legend_of_many_classes_stays_within_the_picture():
    figure = Figure(figsize=modes.VIEW.size, layout="constrained")
    axes = figure.subplots()
    legend_beside(axes, [Patch(label=name) for name in CLASSES])
    figure.draw_without_rendering()
    assert axes.get_legend().get_window_extent().y0 > 0.0


def wide_map(low: float, high: float) -> xarray.Dataset:
    """Cells at rest over this range of Γ and Ω, in equal ratios."""
    values = np.geomspace(low, high, 20)
    data = {name: (PLANE, np.full((20, 20), code)) for name, code in AT_REST.items()}
    return xarray.Dataset(data, {"omega": values, "gamma": values, "xi": 0.1})


@for_each(("low", "high"), [(0.1, 100.0), (0.01, 100.0), (1e-4, 1e5), (1e-6, 1e6)])
def test_a_logarithmic_map_has_numbers_and_its_threshold_all_over(low: float, high: float):
    """The white rim and the dashes of the threshold; the numbers, of the left of two maps, lie apart."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=modes.VIEW.size, layout="constrained")
        for axes in figure.subplots(1, 2):
            draw_modes(axes, wide_map(low, high))
        figure.draw_without_rendering()
    axes = figure.axes[0]
    for line in axes.lines:
        np.testing.assert_allclose(np.asarray(line.get_ydata())[[0, -1]], axes.get_ylim())
    for axis, side in ((axes.xaxis, 0), (axes.yaxis, 1)):
        begins, ends = axis.get_view_interval()
        shown = [tick.label1 for tick in axis.get_major_ticks() if begins <= tick.get_loc() <= ends]
        places = np.array([label.get_window_extent().get_points()[:, side] for label in shown])
        assert len(places) >= 4
        assert (places[1:, 0] - places[:-1, 1] > 2).all()


def test_a_ball_has_no_threshold_of_a_spring(tmp_path: Path):
    """Thresholds of a sweep that has not begun, a map, and a diagram."""
    lines = []
    for kind in ("rigid", "ball"):
        study = Stored(SweepSpec(**CELL | {"model": {"kind": kind}}), str(tmp_path / "none"))
        figure, (_, middle, right) = Figure(), Figure().subplots(1, 3)
        found = threshold.compute(study, threshold.ThresholdQuery())
        threshold.draw(found, figure)
        (axes,) = figure.axes
        assert [text.get_text() for text in axes.texts] == ["incomplete: cells are not computed yet"]
        draw_modes(middle, wide_map(0.1, 10.0).assign_attrs(model=kind))
        times = wide_map(0.1, 10.0).isel(omega=0).assign(flight_time=(("gamma", "flight"), np.ones((20, 1))))
        draw_diagram(right, times.assign_coords(direction="rest").assign_attrs(model=kind))
        lines.append([len(each.lines) for each in (axes, middle, right)])
    assert lines == [[2, 2, 2], [0, 0, 1]]


def test_an_svg_names_fonts_for_viewers_without_the_first():
    lines = "Γ\n$x$ (a formula)"
    svg = picture((2.0, 2.0), lambda figure: figure.text(0.5, 0.5, lines), "svg", {"release": ""}).decode()
    named = set(re.findall('font-family: ([^;"]*)', svg))
    others = "'STIX Two Text', 'Times New Roman', 'Liberation Serif', 'DejaVu Serif Condensed', serif"
    assert named == {f"'STIXGeneral', {others}"}
