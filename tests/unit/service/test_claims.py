"""Claims of captions on data made for them: what agrees, what contradicts, and the bounds between."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import xarray
from tables import for_each

from kernel.labels import CHAOTIC, QUASI_PERIODIC
from kernel.params import Outcome
from service.figures import ball, sections
from service.figures.caption import Verdict

AGREES, CONTRADICTS = Verdict.AGREES, Verdict.CONTRADICTS


def diagram(values: Sequence[float], axis: str = "gamma", **cells: Any) -> xarray.Dataset:
    """A bifurcation diagram; of its variables those that a claim is about."""
    variables = {
        name: ((axis, "flight") if name == "flight_time" else axis, np.array(each))
        for name, each in cells.items()
    }
    return xarray.Dataset(variables, {axis: np.array(values, float)})


# A rigid spring and a ball


def modes(*pairs: tuple[int, int], times: Sequence[Sequence[float]], periodic: bool = True) -> xarray.Dataset:
    outcome = Outcome.PERIODIC if periodic else Outcome.APERIODIC
    bounces, periods = zip(*pairs, strict=True)
    values = range(len(pairs))
    outcomes = [outcome] * len(pairs)
    return diagram(values, outcome=outcomes, bounces=bounces, periods=periods, flight_time=times)


def test_cycles_are_compared_cell_by_cell_where_both_are_periodic():
    times = [[9.0, 1.0, 2.0], [3.0, np.nan, np.nan], [1.0, 1.0, np.nan], [4.0, 4.0, np.nan]]
    others = [[7.0, 2.0, 1.5], [3.25, np.nan, np.nan], [1.0, 1.0, np.nan], [4.0, 4.0, np.nan]]
    first = modes((2, 2), (1, 1), (2, 1), (1, 1), times=times)
    second = modes((2, 2), (1, 1), (2, 2), (2, 1), times=others)
    compared = ball.compare(first, second)
    assert (compared.periodic, compared.same) == (4, 2)
    assert compared.deviations.tolist() == [0.5, 0.25]  # in the order of the times within a cycle, too
    assert str(compared) == "2 of 4 periodic cells are in the same mode"
    aperiodic = modes((2, 2), (1, 1), (2, 1), (1, 1), times=times, periodic=False)
    assert ball.compare(first, aperiodic)[:2] == ball.compare(aperiodic, first)[:2] == (0, 0)


# Diagrams along Γ and Ω


# Thresholds


def loop(omega: Sequence[float], down: Sequence[float], up: float = 1.0) -> xarray.Dataset:
    values = {"down": ("omega", np.array(down)), "up": ("omega", np.full(len(down), up))}
    return xarray.Dataset(values, {"omega": np.array(omega, float)})


def ramped(omega: Sequence[float], down: Sequence[float]) -> Any:
    """A job that was ramped down in steps of 2⁻¹⁰, and ended there."""
    spec = {"gamma": {"start": 0.0, "stop": 1.0, "num": 1025}}
    return SimpleNamespace(spec=spec, threshold=lambda xi: loop(omega, down))


# Branches


def test_a_share_is_one_of_the_cells_that_bounce():
    cells = diagram(range(4), label=[CHAOTIC, QUASI_PERIODIC, Outcome.AT_REST, Outcome.MISSING])
    assert sections.chaotic(cells) == sections.share_of(cells, QUASI_PERIODIC) == 0.5
    assert sections.chaotic(cells, np.array([False, False, True, True])) == 0.0


@for_each(("begins", "verdict"), [(2.25, CONTRADICTS), (3.0, AGREES), (3.75, CONTRADICTS)])
def test_chaos_beyond_three_begins_near_three_or_not(begins: float, verdict: Verdict):
    gamma = np.arange(1.0, 5.01, 0.0625)
    label = np.where(gamma >= begins, CHAOTIC, Outcome.PERIODIC)
    assert sections._chaos_beyond_three(diagram(gamma + 0.0625, label=label)).verdict is verdict
