"""The sweeps of the figures: a file drawn from them says what it shows, and finished jobs are found again."""

from typing import Any, Final

import pytest
from tables import for_each

from service import presets
from worker.spec import SweepSpec

#: By name: axes (first, last, number of values), and settle, observe, keep where a sweep gives them.
SWEEPS: Final[dict[str, dict[str, Any]]] = {
    "figure 2": {"gamma": (1.0, 6.0, 1001), "omega": (0.5, 0.5, 1), "xi": (0.26, 0.26, 1)},
    "figure 3, spring": {"gamma": (1.0, 7.0, 601), "xi": (10.0, 10.0, 1)},
    "figure 5": {"gamma": (0.03, 4.0, 981), "omega": (0.1, 2.0, 39), "window": (100, 20, 1)},
    "figure 7, an ideal plate": {"gamma": (1.8, 2.2, 81), "window": (1000, 100, 64)},
    "figure 9": {"gamma": (0.1, 3.0, 726), "omega": (0.1, 1.4, 131), "window": (100, 20, 1)},
    "figure 9, from less high": {"gamma": (0.1, 1.2, 276), "omega": (0.2, 0.8, 31), "window": (100, 20, 1)},
}


@pytest.fixture(scope="module")
def sweeps() -> dict[str, SweepSpec]:
    specs = (SweepSpec.parse(dict(sweep)) for figure in presets.FIGURES for sweep in figure.sweeps)
    return {spec.name: spec for spec in specs}


def has(spec: SweepSpec, cells: dict[str, Any]) -> bool:
    """Whether a sweep has these axes and this window."""
    axes = {axis: spec.axis_values(axis) for axis in cells if axis != "window"}
    ends = {axis: (values[0], values[-1], len(values)) for axis, values in axes.items()}
    window = {"window": (spec.settle, spec.observe, spec.keep)} if "window" in cells else {}
    return ends | window == cells


@for_each("name", SWEEPS)
def test_a_sweep_of_a_figure_has_these_cells_and_this_window(sweeps: dict[str, SweepSpec], name: str):
    assert has(sweeps[name], SWEEPS[name])


def test_diagrams_in_which_the_paper_sees_chaos_have_the_largest_exponent(sweeps: dict[str, SweepSpec]):
    exponents = {name: spec.exponents for name, spec in sweeps.items() if spec.exponents}
    assert set(exponents) == {name for name in sweeps if name.startswith(("figure 7", "figure 8"))}
    assert set(exponents.values()) == {1}
