"""Words continued from cells: which part of a branch belongs to the cycle that a cell settled to."""

from pathlib import Path

import numpy as np
import pytest

import worker.analysis.words
from kernel.params import Outcome
from worker import store
from worker.analysis.words import (
    Skipped,
    _Cycle,
    _cycles,
    continue_words,
)
from worker.sweep import SweepSpec
from worker.sweep.plan import make_plan
from worker.sweep.schema import layout
from worker.sweep.task import run_chunk


def settled(*flights: float) -> _Cycle:
    return _Cycle(0.5, 0.26, 2.5, 2, 2, np.array(flights), np.zeros(2))


def test_cycles_are_those_of_periodic_cells_that_show_two_rounds():
    times = np.array([[1, 2, 1, 2, 9, 9], [3, 3, 0, 0, 0, 0], [1, 2, 3, 4, 0, 0], [4, 4, 0, 0, 0, 0]], float)
    arrays = {
        "outcome": np.array([Outcome.PERIODIC] * 3 + [Outcome.APERIODIC]),
        "flight_time": times,
        "takeoff_phase": times / 10,
        "flights": np.array([4, 2, 4, 2]),
        "bounces": np.array([2, 1, 2, 1]),
        "periods": np.array([3, 1, 2, 1]),
    }
    spec = SweepSpec(gamma=[1.0, 1.5, 2.0, 2.5], omega=0.5, xi=0.26)
    skipped: list[Skipped] = []
    found = list(_cycles(spec, arrays, (0, 0), skipped))
    assert [(c.gamma, c.bounces, c.periods) for c in found] == [(1.0, 2, 3), (1.5, 1, 1)]
    assert [c.flight_time.tolist() for c in found] == [[1, 2], [3]]
    assert [c.takeoff_phase.tolist() for c in found] == [[0.1, 0.2], [0.3]]
    (missed,) = skipped
    assert missed[:3] == (2.0, 2, 2)
    assert "its 4 stored flights" in missed.reason
    filled_in = {"flights": np.array([0, 2, 4, 2])}  # the first cell has the mode of another
    assert [c.gamma for c in _cycles(spec, arrays | filled_in, (0, 0), [])] == [1.5]
    more_flights_than_kept = {**arrays, "flights": np.array([4, 2_000, 4, 2])}
    assert len(list(_cycles(spec, more_flights_than_kept, (0, 0), []))) >= 1


@pytest.mark.parametrize(("most", "followed"), [(2, 2), (1, 1)])
def test_cells_beyond_as_many_branches_as_are_followed_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int, followed: int
):
    """(1,1) twice, on one branch, and its double beyond the flip."""
    spec = SweepSpec(
        gamma=[1.5, 1.6, 2.3], omega=0.5, xi=0.26, model={"kind": "rigid"}, settle=200, observe=40, keep=16
    )
    url, plan = str(tmp_path / "a.zarr"), make_plan(spec)
    store.create(url, layout(spec, plan.chunk_shape))
    run_chunk(spec, plan[0], url)
    monkeypatch.setattr(worker.analysis.words, "MAX_WORDS", most)
    monkeypatch.setattr(worker.analysis.words, "POINTS", 60)
    words = continue_words(spec, url, 0, 0, 0, 4.0, True)
    assert len(words.branches) == len(words.events) == followed
    reason = f"{most} branches were followed before it, the limit"
    assert words.skipped == ((2.3, 2, 2, reason),)[: 2 - followed]
