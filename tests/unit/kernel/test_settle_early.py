"""Cycles that surely repeat are not computed: when that is sure, and what is recorded instead."""

import math
from typing import Any

import numpy as np
import pytest
from tables import for_each

from kernel.line import LineRun
from kernel.models.ball import BallPlate
from kernel.models.rigid import RigidPlate
from kernel.models.soft import SoftPlate
from kernel.models.stepped import SteppedPlate
from kernel.modes import LONGEST, TURNS, Flights, find_repetition, repeat_flights
from kernel.params import KernelInputError, Line, Outcome

SIZE = 64

#: At rest, periodic with one to many flights, settling and chaotic cells: more than there are lanes.
GAMMA = np.concatenate([[0.4], np.linspace(1.05, 7.0, 39)])
OMEGA, XI = np.full_like(GAMMA, 0.6), np.full_like(GAMMA, 0.1)
E, D = np.full_like(GAMMA, 0.3), np.full_like(GAMMA, 1e-2)
PLATES: dict[str, Any] = {
    "rigid": RigidPlate(0.0 * E),
    "rigid, restitution": RigidPlate(E),
    "soft, adhesive": SoftPlate(E, D, True),
    "soft, nonadhesive": SoftPlate(E, D, False),
    "stepped": SteppedPlate(0.69 + 0.0 * E, D, np.full(len(GAMMA), 400), True, 0.5),
    "ball": BallPlate(0.0 * E),
    "ball, restitution": BallPlate(E),
}


def cycle_of(flights: int, periods: int) -> list[tuple[float, float, int]]:
    """Time, take-off phase and period of different flights, spread over a cycle."""
    places = [(n + 0.3) * periods / flights for n in range(flights)]
    return [(1.0 + 0.01 * n, 2 * math.pi * (x % 1.0), int(x)) for n, x in enumerate(places)]


class Ring:
    """A ring buffer of flights, which are written to it one by one."""

    def __init__(self, first: int = 0, size: int = SIZE) -> None:
        self.arrays = np.zeros(first + size), np.zeros(first + size), np.zeros(first + size, dtype=np.int64)
        self.first, self.size, self.recorded = first, size, 0
        self.flights = Flights(*self.arrays, size, size)

    def add(self, *flight: float) -> None:
        """One flight more."""
        for array, value in zip(self.arrays, flight, strict=True):
            array[self.first + self.recorded % self.size] = value
        self.recorded += 1

    def turns(self, flights: int, periods: int, turns: int, moved: Any = lambda turn: 0.0) -> None:
        """Turns of a cycle, each flight of which is longer by `moved` of the turn."""
        for turn in range(turns):
            for time, phase, period in cycle_of(flights, periods):
                self.add(time + moved(turn), phase, period + turn * periods)

    def found(self, left: int = 200) -> tuple[int, int]:
        """The cycle that repeats."""
        return find_repetition(self.flights, self.first, self.recorded, left)


@for_each(("flights", "periods"), [(1, 1), (1, 3), (2, 2), (3, 2), (7, 4), (LONGEST, 11)])
@for_each("first", [0, 5])
def test_a_cycle_is_found_once_it_was_followed_often_enough(flights: int, periods: int, first: int):
    ring = Ring(first, 128)
    ring.turns(flights, periods, TURNS - 1)
    assert ring.found() == (0, 0)
    ring.recorded = 0
    ring.turns(flights, periods, TURNS + 2)
    assert ring.found() == (flights, periods)


@for_each(
    ("moved", "repeats"),
    [
        (lambda turn: 1e-11 * 0.5**turn, True),  # falls to nothing
        (lambda turn: 1e-7 * 0.99**turn, False),  # agrees within 1e-9 of the turn before, and goes on
        (lambda turn: 1e-8 * 0.999**turn, False),  # within 1e-11
        (lambda turn: 1e-13 * turn, True),  # 2e-11 until the end: a torus that nearly closes
        (lambda turn: 1e-12 * turn, False),  # 2e-10
        (lambda turn: 1e-14 * (turn * 7 % 5), True),  # rounding
        (lambda turn: 1e-13 * 2.0**turn, False),  # leaves an unstable cycle
        (lambda turn: 1e-8 * (-0.999) ** turn, False),  # a slow flip: flights two turns apart agree
        (lambda turn: 3e-11 * (-1) ** turn, False),  # a cycle of two: found as such below
    ],
)
def test_flights_that_still_drift_do_not_repeat(moved: Any, repeats: bool):
    ring = Ring()
    ring.turns(1, 1, 12, moved)
    assert (ring.found() != (0, 0)) == repeats or ring.found()[0] == 2


@for_each("seed", range(60))
def test_the_flights_recorded_are_those_of_the_turns_left_out(seed: int):
    """Against a run that records flight by flight, and forgets those before the window when that begins."""
    random = np.random.default_rng(seed)
    flights, periods, turns = (int(random.integers(1, most)) for most in (6, 5, 40))
    before = int(random.integers(TURNS, 9))
    settle = int(random.integers(0, (before + turns) * periods))
    size = int(random.choice([32, 64, 512]))
    cycle = cycle_of(flights, periods)

    def record(ring: Ring, turn: int) -> None:
        for time, phase, period in cycle:
            takeoff = period + turn * periods
            landing = takeoff + (phase + time) / (2 * math.pi)
            if settling[0] and landing >= settle:
                ring.recorded, settling[0] = 0, False
            if takeoff >= settle or settling[0]:
                ring.add(time, phase, takeoff)

    whole, short = Ring(3, size), Ring(3, size)
    for ring, last in ((whole, before + turns), (short, before)):
        settling = [settle > 0]
        for turn in range(last):
            record(ring, turn)
        begun = not settling[0]
    if short.recorded < flights:
        return  # the window has just begun: no cycle was seen
    ends = (before + turns - 1) * periods + cycle[-1][2] + (cycle[-1][0] + cycle[-1][1]) / (2 * math.pi)
    if ends < settle:
        return  # nothing is in the window
    short.recorded = repeat_flights(short.flights, 3, short.recorded, flights, periods, turns, settle, begun)
    assert short.recorded == whole.recorded
    kept = [(whole.first + n % size) for n in range(max(0, whole.recorded - size), whole.recorded)]
    for a, b in zip(short.arrays, whole.arrays, strict=True):
        np.testing.assert_array_equal(a[kept], b[kept])


def line_run(plate: str, early: bool, **options: Any) -> LineRun:
    fields = {"carry": False, "settle": 150, "observe": 60, "keep": 48, "micro_flight": 0.01} | options
    return LineRun(GAMMA, OMEGA, XI, plate=PLATES[plate], settle_early=early, **fields)


def steps_of(run: LineRun) -> int:
    """Parts of one step that the run takes."""
    steps = 1
    while not run.advance(1):
        steps += 1
    return steps


@for_each("plate", PLATES)
def test_the_record_is_that_of_all_cycles(plate: str):
    full, early = (line_run(plate, early) for early in (False, True))
    for run in (full, early):
        run.advance()
    assert len(set(full.line.outcome)) > 2
    for name in ("outcome", "bounces", "periods", "flights"):
        np.testing.assert_array_equal(getattr(early.line, name), getattr(full.line, name), name)
    for name in ("flight_time", "takeoff_phase", "end_state"):
        np.testing.assert_allclose(getattr(early.line, name), getattr(full.line, name), atol=2e-9, rtol=1e-9)
    chaotic = full.line.outcome == Outcome.APERIODIC
    for name in Line._fields:
        assert getattr(early.line, name)[chaotic].tobytes() == getattr(full.line, name)[chaotic].tobytes()


@pytest.mark.parametrize("plate", ["rigid", "soft, adhesive", "stepped"])
def test_it_takes_fewer_steps(plate: str):
    def steps(early: bool) -> int:
        one = slice(5, 6)
        fields = {"carry": False, "settle": 1000, "observe": 500, "keep": 4}
        plates = type(PLATES[plate])(
            *(x[one] if isinstance(x, np.ndarray) else x for x in PLATES[plate])
        )  # fmt: skip
        return steps_of(LineRun(GAMMA[one], OMEGA[one], XI[one], plate=plates, settle_early=early, **fields))

    assert steps(early=True) * 3 < steps(early=False)


@pytest.mark.parametrize("options", [{"carry": True}, {"exponents": 1}])
def test_ramps_and_exponents_compute_every_cycle(options: dict[str, Any]):
    with pytest.raises(KernelInputError, match=r"settle_early.*compute every cycle"):
        line_run("rigid", True, **options)
