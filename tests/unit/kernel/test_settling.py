"""Cells that have not settled by the end of their window: how they are told, and how they go on."""

import math

import numpy as np
import pytest
from kernel_runs import TWO_PI, Model, run
from tables import for_each

from kernel.modes import CLOSE, find_cycle, is_settling, limit_cycle
from kernel.params import Line, Outcome
from worker.sweep import SweepSpec

#: Random cells of `rigid` with e = 0 whose flights repeat after a multiple of their cycle in the default
#: window: gamma, omega, xi, the mode by the repetition alone, and the mode after 20,000 periods.
MULTIPLES = (
    (4.194708394, 1.521327377, 1.0, (2, 2), (1, 1)),
    (5.098, 0.6392, 0.8404, (2, 4), (1, 2)),
    (2.2513, 0.9918, 0.0615, (4, 4), (2, 2)),
    (2.546, 1.0594, 0.0254, (8, 8), (4, 4)),
    (2.2577, 0.7136, 0.0589, (6, 3), (2, 1)),
)


def flip(r: float, c: float, amplitude: float, flights: int) -> np.ndarray:
    """(-1)^i a_i with a' = -r a + c a^3 from a_0: the normal form of the flip, solved in closed form."""
    i = np.arange(flights, dtype=float)
    w = c / r + (1.0 / amplitude**2 - c / r) * np.exp(2.0 * r * i)
    return np.where(i % 2 == 0, 1.0, -1.0) / np.sqrt(w)


def modes_of(times: np.ndarray) -> tuple[int, int]:
    """Flights per cycle by repetition, and in the limit; take-offs at phase 0.3 of every period."""
    phases, periods = np.full(len(times), 0.3), np.arange(len(times))
    bounces, _ = find_cycle(times, phases, periods)
    return bounces, limit_cycle(times, phases, bounces)


@for_each("flights", [30, 100, 256])
@for_each("decades", [3.0, 1.0, 0.3])
@for_each("cubic", [0.0, -1.0])
def test_an_alternating_approach_to_one_flight_is_no_cycle_of_two(decades, cubic, flights):
    """The difference falls by so many decades over the window, or faster by the cubic term.

    From the middle of the window on, flights two apart repeat within 1e-6 and those one apart do not.
    """
    r = decades * math.log(10.0) / flights
    start = 0.3e-6 / r * 10.0 ** (0.5 * decades)
    times = 4.0 + flip(r, cubic * r / start**2, start, flights)
    assert modes_of(times) == (2, 1)


@for_each("start", [1.00002, 0.99998, 1.0])
@for_each("size", [1e-4, 1e-2, 0.5])
def test_a_true_cycle_of_two_flights_stays_one(size, start):
    """Flights near the limit of the flip's other side, approached from above, from below, and reached."""
    r = -0.02
    times = 4.0 + flip(r, r / size**2, start * size, 100)
    assert modes_of(times) == (2, 2)


@for_each(("gamma", "omega", "xi", "repeating", "true"), MULTIPLES)
def test_cells_that_were_given_a_multiple_of_their_mode(gamma, omega, xi, repeating, true):
    line = run(gamma, omega, xi, settle=200, observe=100, keep=256)
    times, phases = (array[0, : line.flights[0]] for array in (line.flight_time, line.takeoff_phase))
    assert find_cycle(times, phases, np.arange(len(times)))[0] == repeating[0]
    assert (line.bounces[0], line.periods[0]) == true
    late = run(gamma, omega, xi, settle=20_000, observe=100)
    assert (late.bounces[0], late.periods[0]) == true


def spiral(rate: float, size: float, flights: int = 100, turn: float = 0.381966) -> np.ndarray:
    """Times around 4 rad with an amplitude size * exp(-rate i), turning by `turn` of a circle each flight."""
    i = np.arange(flights)
    return 4.0 + size * np.exp(-rate * i) * np.cos(TWO_PI * turn * i)


def settles(times: np.ndarray) -> bool:
    return is_settling(times, np.where(times > 4.0, 1e-12, TWO_PI - 1e-12))  # both sides of the turn


@pytest.mark.parametrize(("rate", "size"), [(0.05, 1.0), (0.01, 0.3), (0.002, 0.01), (-0.002, 0.004)])
def test_spirals_settle(rate, size):
    """Towards a cycle, quickly and slowly, and slowly away from one."""
    assert settles(spiral(rate, size))


@for_each("size", [1.0, 0.1, 0.9 * CLOSE])
@for_each("turn", [0.381966, 0.27639, math.sqrt(2.0) - 1.0])
def test_quasi_periodic_flights_do_not_settle(size, turn):
    assert not settles(spiral(0.0, size, turn=turn))


def test_chaotic_flights_do_not_settle():
    """The logistic map at r = 4, from 200 starts: near returns that happen to come closer are rare."""
    rng = np.random.default_rng(1)
    x = rng.uniform(0.1, 0.9, 200)
    orbits = np.empty((100, 200))
    for i in range(100):
        x = 4.0 * x * (1.0 - x)
        orbits[i] = x
    assert sum(settles(3.0 + 4.0 * orbit) for orbit in orbits.T) <= 4


#: gamma, omega, xi of `rigid` cells, e = 0, that settle at the end of the default window, and their mode in
#: the end. The last one takes more than 1,000 periods.
SLOW = np.array([
    (3.667, 1.288, 0.352), (3.943, 0.808, 0.317), (1.501, 0.581, 0.037), (5.748, 1.167, 0.043),
    (5.8851, 1.1539, 0.9968),
])  # fmt: skip
SETTLED = [(1, 1), (1, 2), (6, 5), (1, 1), (7, 12)]


def slow(settle: int = 200, which: slice = slice(None), **others: object) -> Line:
    return run(*SLOW[which].T, **({"settle": settle, "observe": 100, "keep": 256} | others))


def last_cycles(line: Line) -> list[np.ndarray]:
    flown = zip(line.flight_time, line.flights, line.bounces, strict=True)
    return [np.sort(times[flights - bounces : flights]) for times, flights, bounces in flown]


def test_cells_that_still_settle_say_so_and_go_on_until_they_have():
    short, long, late = slow(), slow(settle_until=20_000), slow(settle=20_000)
    assert list(short.outcome) == [Outcome.SETTLING] * len(SLOW)
    assert not short.bounces.any()
    assert not short.periods.any()
    for line in (long, late):
        assert list(line.outcome) == [Outcome.PERIODIC] * len(SLOW)
        assert list(zip(line.bounces.tolist(), line.periods.tolist(), strict=True)) == SETTLED
    for mine, its in zip(last_cycles(long), last_cycles(late), strict=True):
        np.testing.assert_allclose(mine, its, atol=1e-3)


#: gamma, omega, xi of `rigid` cells, e = 0, that look aperiodic in the default window and are seen to settle
#: in the 200 periods that follow; of cells that stay aperiodic for 20,000; and of such that seem to settle.
TRANSIENT = ((4.1963, 0.6996, 0.0853), (2.6197, 0.3602, 0.1156), (4.2461, 0.8319, 0.2112))
LASTING = ((5.7276, 1.0686, 0.0363), (2.3135, 0.3861, 0.1317), (4.7718, 0.8305, 0.1109))
PASSING = ((4.8458, 0.6869, 0.3855), (3.9549, 0.318, 0.3976), (5.2796, 1.1166, 0.6173))


def test_a_cell_without_a_mode_is_followed_before_it_is_called_aperiodic_or_settling():
    window = {"settle": 200, "observe": 100, "keep": 256, "micro_flight": 0.05}
    line = run(*np.array(TRANSIENT + LASTING + PASSING).T, **window)
    assert list(line.outcome) == [Outcome.SETTLING] * 3 + [Outcome.APERIODIC] * 6
    by_window = [settles_by_its_flights(line, i, longer_than=0.05) for i in range(9)]
    assert by_window == [False] * 6 + [True] * 3
    late = run(*np.array(TRANSIENT).T, settle=600, observe=100)
    assert list(late.outcome) == [Outcome.PERIODIC] * 3


def settles_by_its_flights(line: Line, i: int, longer_than: float = 0.0) -> bool:
    counted = line.flight_time[i] > longer_than
    return is_settling(line.flight_time[i, counted], line.takeoff_phase[i, counted])


@for_each("observe", [30, 80])
@for_each("carry", [False, True])
@for_each(
    ("model", "restitution"), [(Model.RIGID, 0.0), (Model.RIGID, 0.3), (Model.SOFT, 0.01), (Model.BALL, 0.5)]
)
def test_the_window_and_what_follows_it_decide_as_one(model, restitution, carry, observe):
    """Against a window of three times the length: the same flights, and the outcome that they tell."""
    cells = {"which": model, "restitution": restitution, "settle": 100, "keep": 1024, "carry": carry}
    lines = [np.linspace(3.8, 6.0, 12)] if not carry else np.linspace(3.8, 6.0, 12)[:, None]
    undecided = 0
    for gamma in lines:
        line, long = (run(gamma, 0.5, 0.1, **cells, observe=n * observe) for n in (1, 3))
        for i in np.flatnonzero((line.outcome == Outcome.APERIODIC) | (line.outcome == Outcome.SETTLING)):
            flights = line.flights[i]
            np.testing.assert_array_equal(line.flight_time[i, :flights], long.flight_time[i, :flights])
            settles = long.outcome[i] == Outcome.PERIODIC or settles_by_its_flights(long, i)
            assert line.outcome[i] == (Outcome.SETTLING if settles else Outcome.APERIODIC)
            undecided += 1
    assert undecided >= 3


@pytest.mark.parametrize(("gamma", "mode"), [(1.5, (1, 1)), (2.3, (2, 2)), (3.6, (1, 2))])
def test_the_default_contact_has_the_modes_of_figure_2(gamma, mode):
    """Soft, e = 0.01, d = 1e-3, Omega = 0.5, xi = 0.26: its hops after a landing do not count."""
    window = {"settle": 200, "observe": 100, "restitution": 0.01}
    micro_flight = SweepSpec.model_fields["micro_flight"].default
    line = run(gamma, 0.5, 0.26, Model.SOFT, **window, micro_flight=micro_flight)
    assert (line.bounces[0], line.periods[0]) == mode
    rigid = run(gamma, 0.5, 0.26, settle=200, observe=100)
    assert (rigid.bounces[0], rigid.periods[0]) == mode
    every = run(gamma, 0.5, 0.26, Model.SOFT, **window, micro_flight=0.0)
    assert every.bounces[0] > line.bounces[0]
