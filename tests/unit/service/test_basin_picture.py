"""What a basin's picture draws, read back from its artists."""

from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from tables import for_each

from kernel.params import Outcome
from service.render import basins
from service.render.style import SYMBOLS
from service.results.basins import Attractor, BasinCell
from worker.basins.spec import BasinSpec

SPEC: dict[str, Any] = {
    "gamma": 1.27, "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"},
    "protocol": {"kind": "basin", "rows": 2, "columns": 4},
}  # fmt: skip


def attractor(number: int, fraction: float, longest: float = 4.0) -> Attractor:
    return Attractor(
        id=number, fraction=fraction, outcome=int(Outcome.PERIODIC), label=f"({number},1)", bounces=number,
        periods=1, longest_flight=longest, lifetime=float("inf"), state=np.zeros(4),
        flight_time=np.array([longest]), takeoff_phase=np.array([0.5]), lyapunov=None,
    )  # fmt: skip


def cell(count: int = 2, undecided: float = 0.25, **changes: Any) -> BasinCell:
    """Eight starts of two rows, by default of two attractors and two undecided starts."""
    protocol = SPEC["protocol"] | changes.pop("protocol", {})
    fields: dict[str, Any] = {
        "gamma": 1.27,
        "omega": 0.5,
        "xi": 0.26,
        "spec": BasinSpec(**SPEC | {"protocol": protocol}),
        "map": np.array([[0, 1, 1, 2], [2, 2, 1, 0]], np.uint8),
        "attractors": tuple(attractor(i + 1, 0.375) for i in range(count)),
        "numbers": {"undecided": undecided},
        "complete": True,
    }
    return BasinCell(**(fields | changes))


def drawn(shown: BasinCell) -> Axes:
    figure = Figure(figsize=basins.SIZE)
    basins._draw(figure, shown)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    return axes


def legend(shown: BasinCell) -> list[tuple[str, str]]:
    """Colour and text of every entry."""
    entries = drawn(shown).get_legend()
    assert entries is not None
    texts = [text.get_text() for text in entries.get_texts()]
    return [(to_hex(p.get_facecolor()), t) for p, t in zip(entries.get_patches(), texts, strict=True)]


def test_every_start_has_the_colour_of_its_attractor():
    shown = cell()
    (picture,) = drawn(shown).images
    assert picture.origin == "lower"
    ids = np.asarray(picture.get_array())
    assert np.array_equal(ids, shown.map)
    colours = picture.cmap(picture.norm(ids))
    expected = {0: basins.UNDECIDED, 1: basins.COLOURS[0], 2: basins.COLOURS[1]}
    for place, number in np.ndenumerate(shown.map):
        assert to_hex(colours[place]) == expected[int(number)]


def test_every_start_is_the_middle_of_its_pixel():
    shown = cell()
    (picture,) = drawn(shown).images
    left, right, bottom, top = picture.get_extent()
    plane = shown.spec.protocol
    for values, low, high in ((plane.column_values, left, right), (plane.row_values, bottom, top)):
        width = (high - low) / len(values)
        np.testing.assert_allclose(low + width * (np.arange(len(values)) + 0.5), values)


@pytest.mark.parametrize(("name", "ends"), [("rows", (2, 3)), ("columns", (0, 1))])
def test_a_single_row_or_column_is_one_unit_wide(name: str, ends: tuple[int, int]):
    plane = cell(protocol={name: 1}).spec.protocol
    shown = cell(protocol={name: 1}, map=np.ones((plane.rows, plane.columns), np.uint8))
    (picture,) = drawn(shown).images
    extent = picture.get_extent()
    (middle,) = plane.row_values if name == "rows" else plane.column_values
    assert [extent[i] for i in ends] == pytest.approx([middle - 0.5, middle + 0.5])


@pytest.mark.parametrize("plane", ["drop", "contact"])
def test_the_axes_are_those_of_the_plane(plane: str):
    axes = drawn(cell(protocol={"plane": plane}))
    assert (axes.get_xlabel(), axes.get_ylabel()) == basins._AXES[plane]
    symbols = ", ".join(
        f"{SYMBOLS[name]} = {value}" for name, value in (("gamma", 1.27), ("omega", 0.5), ("xi", 0.26))
    )
    assert axes.get_title() == f"{symbols}  (rigid)"


def test_the_legend_names_shares_and_flights():
    assert legend(cell()) == [
        (basins.COLOURS[0], "(1,1)  37.5 %\nup to 4 rad"),
        (basins.COLOURS[1], "(2,1)  37.5 %\nup to 4 rad"),
        (basins.UNDECIDED, "undecided  25.0 %"),
    ]
    still = legend(cell(1, 0.0, attractors=(attractor(1, 1.0, longest=0.0),)))
    assert still == [(basins.COLOURS[0], "(1,1)  100.0 %")]


def test_before_the_cell_is_computed_the_legend_says_so():
    empty = cell(0, numbers={}, map=np.zeros((2, 4), np.uint8))
    assert legend(empty) == [(basins.UNDECIDED, "not computed")]


@for_each(
    ("share", "text"),
    [(1.0, "100.0 %"), (0.001, "0.1 %"), (0.0123, "1.2 %"), (0.00099, "0.099 %"), (float("nan"), "nan %")],
)
def test_small_shares_keep_two_digits(share: float, text: str):
    assert basins._percent(share) == text


def test_of_many_attractors_some_are_named_and_colours_come_again():
    most = basins.NAMED
    assert len(legend(cell(most, 0.0))) == most
    entries = legend(cell(most + 3, 0.0))
    assert [colour for colour, _ in entries[:most]] == [*basins.COLOURS, *basins.COLOURS]
    assert [text for _, text in entries[most:]] == ["and 3 more"]
