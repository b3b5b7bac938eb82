"""Attractors told apart, of motions that are written down: where starts are put.

A search asks for runs and answers from their records alone. Here no kernel answers: a start's gap names its
motion, its gap velocity counts the plate periods that it has run, its elongation numbers it.
What springs do is in test_basins.py.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.stats import ks_2samp
from studies import spec_of

from kernel.params import STATE_FIELDS, Line, Outcome, empty_line
from worker.basins import attractors
from worker.basins.attractors import Found, Request, find, ks_distance
from worker.basins.specification import BasinSpec

WHICH, ELAPSED, START = (STATE_FIELDS.index(name) for name in ("gap", "gap_velocity", "elongation"))

WINDOWS = spec_of(1.0, 0.5, 0.1, window=(100, 20, 8), settle_until=1200)
SPEC = BasinSpec(**WINDOWS, protocol={"kind": "basin"})


class Seen(NamedTuple):
    """What a window shows of a motion."""

    outcome: Outcome
    flights: Sequence[float] = ()
    bounces: int = 0
    periods: int = 0


Motion = Callable[[float], Seen]


def cycle(*flights: float, periods: int = 1) -> Motion:
    return lambda _: Seen(Outcome.PERIODIC, flights * 3, len(flights), periods)


def always(outcome: Outcome, flights: Sequence[float] = ()) -> Motion:
    return lambda _: Seen(outcome, flights)


def turning(end: float, before: Motion, after: Motion) -> Motion:
    """One motion for so many plate periods, then another."""
    return lambda periods: (before if periods < end else after)(periods)


def spread(low: float, high: float) -> list[float]:
    """300 flights, evenly distributed, in no order."""
    return np.random.default_rng(1).permutation(np.linspace(low, high, 300)).tolist()


CHAOS = always(Outcome.APERIODIC, spread(1.0, 2.0))


def searched(starts: Sequence[int], *motions: Motion, **rules: Any) -> Found:
    """Where starts of these motions lead."""

    def run(request: Request, reduce: Callable[[Line], Any]) -> Any:
        n = len(request.states)
        line = empty_line(n, request.keep, request.exponents)
        line.end_state[:] = request.states
        line.end_state[:, ELAPSED] += request.settle + request.observe
        for i, state in enumerate(line.end_state):
            seen = motions[int(state[WHICH])](state[ELAPSED])
            flights = np.array(seen.flights[-request.keep :])
            line.flight_time[i, : len(flights)], line.takeoff_phase[i, : len(flights)] = flights, 0.5
            line.flights[i], line.outcome[i] = len(seen.flights), seen.outcome
            line.bounces[i], line.periods[i] = seen.bounces, seen.periods
            line.lyapunov[i] = state[ELAPSED]
        return reduce(line)

    states = np.zeros((len(starts), len(STATE_FIELDS)))
    states[:, WHICH], states[:, START] = starts, np.arange(len(starts))
    return find(states, SPEC.model_copy(update=rules), run)


def test_a_group_whose_representatives_end_apart_goes_on_until_it_is_two():
    """One of two seems to be on the cycle of the other for 500 plate periods."""
    leaving = turning(500, cycle(1.0, 2.0), cycle(4.0))
    found = searched([0, 1, 1], leaving, cycle(1.0, 2.0))
    assert found.ids.tolist() == [2, 1, 1]
    assert [a.flights.tolist() for a in found.attractors] == [[1.0, 2.0], [4.0]]


@pytest.mark.parametrize(("flights", "count"), [
    ((1.0 + 0.9e-4, 2.0 + 0.9e-4), 1),
    ((1.0 + 1.2e-4, 2.0 + 1.2e-4), 2),
    ((1.0, 2.0 + 1.2e-4), 2),
    ((1.0 - 1.2e-4, 2.0), 2),
])  # fmt: skip
def test_cycles_of_one_mode_are_one_if_their_flights_are(flights: tuple[float, ...], count: int):
    found = searched([0, 1], cycle(1.0, 2.0), cycle(*flights))
    assert len(found.attractors) == count
    assert set(found.ids.tolist()) == set(range(1, count + 1))


def test_two_distributions_are_two_attractors():
    found = searched([0, 1, 1, 0, 1], CHAOS, always(Outcome.APERIODIC, spread(1.5, 2.5)))
    assert found.ids.tolist() == [2, 1, 1, 2, 1]
    assert [a.longest_flight for a in found.attractors] == [2.5, 2.0]


def test_the_starts_farthest_from_what_is_known_are_looked_at_too():
    """The second of 40 is not among the 32 representatives."""
    starts = [0] * 40
    starts[2] = 1
    found = searched(starts, CHAOS, always(Outcome.APERIODIC, spread(3.0, 4.0)))
    assert found.ids.tolist() == [2 if which else 1 for which in starts]


def test_a_cycle_of_many_flights_joins_the_distribution_that_it_has():
    long, short = (cycle(*(1.0 + (np.arange(n) + 0.5) / n).tolist()) for n in (20, 19))
    found = searched([0, 1, 2, 2], long, short, CHAOS)
    assert found.ids.tolist() == [1, 2, 1, 1]
    other = cycle(*np.linspace(3.0, 4.0, 20).tolist())
    assert searched([0, 1, 1], other, CHAOS).ids.tolist() == [2, 1, 1]


@pytest.mark.parametrize("starts", [1, 2])
def test_aperiodic_runs_that_turn_out_to_repeat_are_a_cycle(starts: int):
    flights = np.linspace(1.0, 2.0, 90).tolist()
    closing = turning(2000, CHAOS, cycle(*flights, periods=70))
    found = searched([0] * starts, closing)
    (attractor,) = found.attractors
    assert (attractor.outcome, attractor.bounces, attractor.periods) == (Outcome.PERIODIC, 90, 70)
    assert attractor.flights.tolist() == flights
    assert attractor.state[START] == 0


def test_distances_are_those_of_kolmogorov_and_smirnov():
    """Also where values repeat, and of rows that hold fewer flights than there is room for."""
    generator = np.random.default_rng(2)
    pool = generator.integers(0, 12, 50) / 4.0
    rows = generator.integers(0, 12, (6, 16)) / 4.0
    phases = generator.integers(0, 12, (6, 16)) / 4.0
    pool_phase = generator.integers(0, 12, 50) / 4.0
    rows[1, 9:] = phases[1, 9:] = np.nan
    rows[2] = phases[2] = np.nan
    found = attractors._distance_of_rows(rows, phases, pool, pool_phase)
    for times, angles, distance in zip(rows, phases, found, strict=True):
        row, phase = times[np.isfinite(times)], angles[np.isfinite(angles)]
        pairs = (row, pool), (np.sin(phase), np.sin(pool_phase)), (np.cos(phase), np.cos(pool_phase))
        expected = [ks_2samp(a, b).statistic if len(row) else 0.0 for a, b in pairs]
        assert distance == pytest.approx(max(expected), abs=1e-12)
        if len(row):
            assert [ks_distance(a, b) for a, b in pairs] == pytest.approx(expected, abs=1e-12)
