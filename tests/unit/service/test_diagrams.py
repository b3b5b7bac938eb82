"""Diagrams as JSON, CSV and pictures."""

import csv
import io
import json
from concurrent.futures import ThreadPoolExecutor
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from service.results.diagram import Diagram

from kernel.params import Outcome
from service.formats import PictureFormat
from service.render import bifurcation
from service.render.text import COLUMNS, diagram_json, diagrams_csv
from worker.spec import SweepSpec

NAN = float("nan")
#: What the metadata of every picture say.
ORIGIN = {"release": "0.2.0", "job": 32 * "a"}


def draw(diagrams: list[Diagram], spec: SweepSpec, format: PictureFormat) -> bytes:
    return bifurcation.draw(diagrams, spec, format, ORIGIN)


def made(**changes: Any) -> Diagram:
    """Four cells: at rest, bouncing once and twice, and missing; two flights are kept."""
    arrays: dict[str, Any] = {
        "flight_time": np.array([[NAN, NAN], [4.0, NAN], [3.0, 6.0], [NAN, NAN]]),
        "takeoff_phase": np.array([[NAN, NAN], [1.0, NAN], [2.0, 0.5], [NAN, NAN]]),
        "flights": np.array([0, 1, 7, 0], np.int32),
        "outcome": np.array([3, 1, 2, 0], np.uint8),
        "bounces": np.array([0, 1, 0, 0], np.int32),
        "periods": np.array([0, 1, 0, 0], np.int32),
    }
    fields: dict[str, Any] = {
        "along": "gamma",
        "fixed": {"omega": 0.5, "xi": 0.26},
        "direction": "rest",
        "values": np.array([0.5, 1.5, 2.5, 3.5]),
        "arrays": {name: changes.pop(name, array) for name, array in arrays.items()},
    }
    return Diagram(**(fields | changes))


def spec(**changes: Any) -> SweepSpec:
    fields: dict[str, Any] = {"gamma": [0.5, 1.5, 2.5, 3.5], "omega": 0.5, "xi": 0.26, "keep": 2}
    return SweepSpec(**(fields | changes))


def long(cells: int, keep: int, seed: int = 1, **changes: Any) -> Diagram:
    """Many cells, every flight kept."""
    shape = (cells, keep)
    arrays: dict[str, Any] = {
        "values": np.linspace(0.5, 6.0, cells),
        "flight_time": np.random.default_rng(seed).uniform(0.0, 19.0, shape),
        "takeoff_phase": np.zeros(shape),
        "flights": np.full(cells, keep, np.int32),
        "outcome": np.full(cells, 2, np.uint8),
        "bounces": np.zeros(cells, np.int32),
        "periods": np.zeros(cells, np.int32),
    }
    return made(**(arrays | changes))


def words(svg: bytes) -> str:
    """The picture's texts: text is text, and the source of mathematical text is a comment beside it."""
    return svg.decode()


def test_json_is_the_contract_to_the_letter():
    assert json.loads(diagram_json(made())) == {
        "along": "gamma",
        "fixed": {"omega": 0.5, "xi": 0.26},
        "direction": "rest",
        "values": [0.5, 1.5, 2.5, 3.5],
        "flight_time": [[], [4.0], [3.0, 6.0], []],
        "takeoff_phase": [[], [1.0], [2.0, 0.5], []],
        "flights": [0, 1, 7, 0],
        "outcome": [3, 1, 2, 0],
        "bounces": [0, 1, 0, 0],
        "periods": [0, 1, 0, 0],
        "min_flight": 0.0,
        "complete": False,
    }


def test_a_diverged_cell_spoils_no_json():
    wild = made(flight_time=np.array([[NAN, NAN], [np.inf, NAN], [3.0, 6.0], [NAN, NAN]]))
    assert json.loads(diagram_json(wild))["flight_time"] == [[], [], [3.0, 6.0], []]


def test_short_flights_are_left_out_of_both_lists():
    content = json.loads(diagram_json(made(min_flight=3.5)))
    assert (content["flight_time"], content["takeoff_phase"]) == (
        [[], [4.0], [6.0], []],
        [[], [1.0], [0.5], []],
    )


def test_a_table_has_a_row_per_flight():
    down = made(direction="down", min_flight=5.0)
    rows = list(csv.DictReader(io.StringIO(diagrams_csv([made(), down]).decode())))
    assert tuple(rows[0]) == COLUMNS
    assert rows[0] == {
        "direction": "rest",
        "gamma": "1.5",
        "omega": "0.5",
        "xi": "0.26",
        "flight": "0",
        "flight_time_rad": "4.0",
        "takeoff_phase_rad": "1.0",
        "outcome": "periodic",
        "bounces": "1",
        "periods": "1",
    }
    assert [(row["direction"], row["gamma"], row["flight"]) for row in rows] == [
        ("rest", "1.5", "0"),
        ("rest", "2.5", "0"),
        ("rest", "2.5", "1"),
        ("down", "1.5", "0"),  # the cell has no longer flight
        ("down", "2.5", "1"),
    ]


def test_few_points_are_drawn_and_many_become_an_image():
    few = draw([long(100, 4)], spec(), "svg")
    many = draw([long(2000, 64)], spec(), "svg")
    assert b"<image" not in few
    assert b"<image" in many
    assert len(many) < 3_000_000
    ElementTree.fromstring(many)


def test_a_picture_says_what_is_missing_and_what_is_unresolved():
    assert "incomplete: 1 of 4 cells" in words(draw([made()], spec(), "svg"))
    whole = np.array([3, 1, 2, Outcome.UNRESOLVED], np.uint8)
    picture = words(draw([made(outcome=whole)], spec(), "svg"))
    assert "incomplete" not in picture
    assert "1 of 4 cells unresolved" in picture


@pytest.mark.parametrize(
    "diagram",
    [
        made(values=np.array([1.5]), **{name: array[1:2] for name, array in made().arrays.items()}),
        made(flights=np.zeros(4, np.int32)),
        made(values=np.geomspace(1e-3, 1e3, 4)),
    ],
    ids=["one cell", "no flight", "logarithmic"],
)
def test_odd_diagrams_can_be_drawn(diagram: Diagram):
    assert len(draw([diagram], spec(), "png")) > 1000


def test_pictures_may_be_drawn_by_many_at_once():
    diagrams = [long(50, 4, seed) for seed in range(4)]
    alone = [draw([diagram], spec(), "png") for diagram in diagrams]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(lambda diagram: draw([diagram], spec(), "png"), diagrams))
    assert together == alone
