"""Windows of a map: the adaptive sweep that each of them is."""

from typing import Any

import pytest
from studies import spec_of
from tables import for_each

from worker.maps.window import FEWEST_VALUES, Window
from worker.spec.errors import SpecInvalid
from worker.sweep import SweepSpec
from worker.sweep.specification import EarlierSweep

JOB = "0123456789abcdef" * 2
#: 0.01 apart along gamma.
MAP = spec_of(
    (1.0, 3.0, 201), [0.25, 0.5, 0.75, 1.0], [0.0, 0.125, 0.5], settle=60, keep=8,
    model={"kind": "rigid", "restitution": 0.25},
)  # fmt: skip


def window(map_: dict[str, Any] | None = None, **fields: Any) -> SweepSpec:
    return Window(**{"xi": 0.125} | fields).of(SweepSpec(**MAP | (map_ or {})), JOB)


def problem(map_: dict[str, Any] | None = None, **fields: Any) -> str:
    with pytest.raises(SpecInvalid) as caught:
        window(map_, **fields)
    [found] = caught.value.problems
    return str(found)


def test_a_window_keeps_all_but_the_grid():
    found, whole = window(), SweepSpec(**MAP)
    assert found.name == "Window of sweep 01234567"
    assert window({"name": "modes"}).name == "Window of modes"
    assert window({"name": "m" * 200}).name == "Window of " + "m" * 190
    assert (found.model, found.settle, found.keep) == (whole.model, 60, 8)
    assert found.refine.model_dump() == {"by": "mode", "coarsest": 16, "margin": False}
    earlier = EarlierSweep(**MAP | {"xi": 0.125, "settle_until": 600})
    assert Window().of(earlier, JOB).until == 600


@for_each(
    ("ends", "finer", "expected"),
    [
        ([1.5, 2.5], 4, (1.5, 2.5, 401)),
        ([1.5, 2.5], 1, (1.5, 2.5, FEWEST_VALUES)),
        ([1.5, 2.5], 2, (1.5, 2.5, 201)),
        ([0.5, 2.0], 64, (1.0, 2.0, 6401)),  # cut to the map
        ([2.0, 9.0], 4, (2.0, 3.0, 401)),
        ([1.505, 1.506], 64, (1.505, 1.506, FEWEST_VALUES)),  # between two values
    ],
)
def test_a_window_is_so_many_times_as_fine_as_the_map(ends: list[float], finer: int, expected: tuple):
    gamma = window(gamma=ends, finer=finer).gamma
    assert (gamma.start, gamma.stop, gamma.num) == expected


@pytest.mark.parametrize("ends", [[0.1, 0.9], [0.5, 1.0], [3.0, 4.0], [3.5, 4.0]])
def test_a_window_has_a_part_of_the_map(ends: list[float]):
    assert problem(gamma=ends) == "gamma: must overlap the sweep, which is from 1 to 3"


@for_each(
    ("asked", "given"), [(0.0, 0.0), (0.0624, 0.0), (0.0626, 0.125), (0.3, 0.125), (0.4, 0.5), (0.5, 0.5)]
)
def test_the_nearest_xi_of_the_map_is_taken(asked: float, given: float):
    assert window(xi=asked).xi == given
