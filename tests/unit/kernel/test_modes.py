"""Modes: the shortest cycle of the last flights, against its definition; the outcomes of runs."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kernel_runs import TWO_PI, Model, examples, run
from naive import cycle
from tables import for_each

from kernel.modes import find_cycle
from kernel.params import Outcome


def find(times: np.ndarray, takeoffs: np.ndarray) -> tuple[int, int]:
    """The kernel's answer; `takeoffs` are phases since the start."""
    periods = np.floor(takeoffs / TWO_PI)
    return find_cycle(times, takeoffs - TWO_PI * periods, periods.astype(np.int64))


def repeated(
    flights: list[float], waits: list[float], times: int, first: float = 0.3
) -> tuple[np.ndarray, np.ndarray]:
    """Flights and the contacts after them, over and over."""
    flown = np.array(flights * times)
    spans = flown + np.array(waits * times)
    return flown, first + np.concatenate([[0.0], np.cumsum(spans)[:-1]])


@pytest.mark.parametrize("first", [0.0, 1e-9, TWO_PI - 1e-9, math.pi])
def test_take_off_at_the_turn_of_the_phase(first):
    """Rounding puts some of them at 0 and some at 2 pi."""
    rng = np.random.default_rng(1)
    flown, takeoffs = repeated([4.0, 5.0], [TWO_PI - 4.0, TWO_PI - 5.0], 8, first)
    noise = rng.uniform(-1e-9, 1e-9, len(takeoffs))
    assert find(flown, np.abs(takeoffs + noise)) == (2, 2)


@given(
    flights=st.lists(st.floats(0.01, 12.0), min_size=1, max_size=6),
    waits=st.lists(st.floats(0.0, 6.0), min_size=6, max_size=6),
    times=st.integers(1, 12),
    noise=st.sampled_from([0.0, 1e-9, 1e-7, 1e-5]),
    broken=st.integers(-1, 40),
    lost=st.integers(0, 5),
    seed=st.integers(0, 99),
)
@examples(300)
def test_the_kernel_finds_what_the_definition_says(flights, waits, times, noise, broken, lost, seed):
    waits = waits[: len(flights)]
    span = sum(flights) + sum(waits)
    waits[-1] += math.ceil(span / TWO_PI) * TWO_PI - span
    flown, takeoffs = repeated(flights, waits, times)
    rng = np.random.default_rng(seed)
    flown = flown + rng.uniform(-noise, noise, len(flown))
    takeoffs = takeoffs + rng.uniform(-noise, noise, len(flown))
    if 0 <= broken < len(flown):
        flown[broken] += 0.01
    flown, takeoffs = flown[lost:], takeoffs[lost:]
    assert find(flown, takeoffs) == cycle(list(flown), list(takeoffs))


def test_a_cell_that_only_takes_off_or_lands_in_the_window_is_not_at_rest():
    """Gamma = 30: one flight lasts longer than the window."""
    line = run(30.0, 0.5, 0.26, settle=1, observe=1)
    assert line.flights[0] == 0
    assert line.outcome[0] == Outcome.APERIODIC


@pytest.mark.parametrize("keep", [1, 8_000])
def test_hops_beyond_number_do_not_hide_a_mode(keep):
    """140 to 730 hops in each plate period: 256 flights would hold two cycles, or less than one."""
    cell = (5.064393900886782, 1.462037452302902, 0.07543424170733475)
    line = run(*cell, restitution=0.99, settle=200, observe=100, keep=keep, micro_flight=0.05)
    assert line.flights[0] > 13_000
    assert (line.outcome[0], line.bounces[0], line.periods[0]) == (Outcome.PERIODIC, 8, 1)


@for_each(("keep", "outcome"), [(1, Outcome.UNRESOLVED), (8192, Outcome.APERIODIC)])
def test_a_cell_whose_flights_are_lost_is_unresolved(keep, outcome):
    """4,325 flights in two plate periods: no fewer than 4,096 are kept, which do not reach back three."""
    line = run(1.2, 2.0, 0.0, Model.SOFT, restitution=1.0, penetration=7e-5, settle=0, observe=4, keep=keep)
    assert line.flights[0] > 8192
    assert line.outcome[0] == outcome


def test_a_spent_budget_is_unresolved():
    """An undamped contact on an undamped spring rings for ever: more events than a budget can hold."""
    line = run(1.5, 0.8, 0.0, Model.SOFT, restitution=1.0, penetration=1e-8, settle=0, observe=3)
    assert line.outcome[0] == Outcome.UNRESOLVED
    assert line.bounces[0] == 0
