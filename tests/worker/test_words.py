"""Words continued from cells: which part of a branch belongs to the cycle that a cell settled to."""

import numpy as np

from kernel.branches.words import WordBranch
from worker.analysis.words import _Cycle, _up_to_shorter


def doubled(first: np.ndarray, second: np.ndarray, word: str = "ss") -> WordBranch:
    """A branch whose cycles have two flights, of these times."""
    n = len(first)
    times = np.column_stack([first, second])
    return WordBranch(
        omega=0.5, xi=0.26, word=word, periods=2, unknowns=np.zeros((n, 1)), gamma=np.linspace(2.0, 3.0, n),
        flight_time=times, takeoff_phase=np.zeros((n, 2)), impact_velocity=-np.ones((n, 2)),
        multiplier=np.zeros((n, 2), complex), stable=np.ones(n, bool), admissible=np.zeros(n, np.uint8),
    )  # fmt: skip


def settled(*flights: float) -> _Cycle:
    return _Cycle(gamma=2.5, bounces=2, periods=2, flight_time=np.array(flights), takeoff_phase=np.zeros(2))


APART = np.linspace(-0.45, 0.45, 10)  # passes through 0 between the fifth and the sixth point


def test_a_doubled_cycle_ends_where_it_is_the_single_one_twice():
    branch = doubled(5.0 + APART, 5.0 - 2.0 * APART)
    above = _up_to_shorter(branch, settled(5.35, 4.3))
    assert above.gamma.tolist() == branch.gamma[5:].tolist()
    assert (above.flight_time[:, 0] > above.flight_time[:, 1]).all()
    assert len(above.stable) == len(above.multiplier) == 5


def test_flights_of_a_word_that_repeats_nothing_may_be_equal_anywhere():
    branch = doubled(5.0 + APART, 5.0 - APART, word="sl")
    assert len(_up_to_shorter(branch, settled(5.35, 4.65)).gamma) == 10


def test_a_leap_of_the_flights_is_not_a_flip():
    """They change their order without being equal in between."""
    apart = np.repeat([-0.4, 0.4], 5)
    assert len(_up_to_shorter(doubled(5.0 + apart, 5.0 - apart), settled(5.4, 4.6)).gamma) == 10
