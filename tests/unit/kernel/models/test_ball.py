"""The ball against closed forms, a dense search for its landings, and its hops summed one by one."""

import math
from collections.abc import Callable

import mpmath
import numpy as np
import pytest
from kernel_runs import Model, recorded
from kernel_runs import run as run_any
from naive_ball import Fall
from tables import for_each

from kernel import interface, restitution
from kernel.cell import CACHE_SIZE
from kernel.interface import State, plate_phase
from kernel.models import ball, contact_law, flight
from kernel.models.ball import BallPlate
from kernel.params import Cell, Line, Outcome, Start

TWO_PI = 2.0 * math.pi


def run(gamma, epsilon=0.0, *, settle=200, observe=100, **more) -> Line:
    return run_any(gamma, 1.0, 1.0, Model.BALL, restitution=epsilon, settle=settle, observe=observe, **more)


def mode(line: Line) -> tuple[int, int]:
    return int(line.bounces[0]), int(line.periods[0])


def bisect(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Where a property that holds at `low` and not at `high` ends, to 1e-7."""
    assert holds(low)
    assert not holds(high)
    while high - low > 1e-7:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return 0.5 * (low + high)


def locked(gamma: float, epsilon: float, n: int, off: float = 0.0) -> Start:
    """On the orbit that meets the plate every n periods at one phase, or `off` rad beside it."""
    reach = min(n * math.pi * (1.0 - epsilon) / (gamma * (1.0 + epsilon)), 1.0)
    landing = -reach - n * math.pi / gamma  # relative velocity at impact
    phase = TWO_PI - math.asin(reach) + off
    return Start(np.array([phase, 1.0, 0.0, -epsilon * landing, 0.0, 0.0]), Cell(gamma, 1.0, 1.0))


def test_flight_time_from_rest_obeys_its_formula():
    gammas = np.concatenate([1.0 + np.logspace(-12, -1, 12), np.linspace(1.2, 3.29, 20)])
    line = run(gammas)
    for i, gamma in enumerate(gammas):
        time = recorded(line, i)[-1]
        # sqrt(Gamma^2 - 1) = (T^2/2 - 1 + cos T)/(T - sin T), by series where that cancels
        if time > 0.1:
            expected = (0.5 * time**2 - 1.0 + math.cos(time)) / (time - math.sin(time))
        else:
            expected = 0.25 * time * (1.0 - time**2 / 30.0) / (1.0 - time**2 / 20.0)
        assert math.sqrt((gamma - 1.0) * (gamma + 1.0)) == pytest.approx(expected, rel=1e-6)
        takeoff = line.takeoff_phase[i, 0]
        assert takeoff == pytest.approx(TWO_PI - math.acos(1.0 / gamma), abs=1e-7)


def test_sticking_ends_where_the_flight_fills_the_period():
    gamma = bisect(lambda g: recorded(run(g))[-1] < TWO_PI - 1e-8, 3.2, 3.4)
    assert gamma == pytest.approx(math.sqrt(1.0 + math.pi**2), abs=1e-6)


def test_two_bounces_in_two_periods_end():
    gamma = bisect(lambda g: mode(run(g, settle=2000)) == (2, 2), 4.5, 4.65)
    assert gamma == pytest.approx(4.6033388, abs=1e-6)


@pytest.mark.parametrize(("epsilon", "n"), [(0.0, 1), (0.15, 2), (0.5, 1)])
def test_period_doubling(epsilon: float, n: int):
    """A disturbance of the (1, n) orbit dies out below the flip and grows above it."""

    def dies_out(gamma: float) -> bool:
        start = locked(gamma, epsilon, n, off=1e-5)
        early, late = (
            run(gamma, epsilon, carry=True, settle=settle, observe=20, start=start)
            for settle in (20, 200_000)
        )
        return abs(recorded(late)[-1] - TWO_PI * n) < abs(recorded(early)[-1] - TWO_PI * n)

    node = n * math.pi * (1.0 - epsilon) / (1.0 + epsilon)
    flip = math.hypot(node, 2.0 * (1.0 + epsilon**2) / (1.0 + epsilon) ** 2)
    assert bisect(dies_out, flip - 0.01, flip + 0.01) == pytest.approx(flip, abs=1e-6)


@for_each("gamma", [8.819118065835461, 10.371590283163922, 6.703383742495469])
def test_the_error_of_flights_between_sticks_is_bounded_where_rounding_grows(gamma: float):
    """Each flight to 40 digits from the take-off after sticking, whose phase forgets what was before."""
    line = run(gamma, 0.3, certify=True, settle_until=5000, keep=4000)
    kept = np.isfinite(line.flight_time[0])
    phases, times = line.takeoff_phase[0, kept], line.flight_time[0, kept]
    with mpmath.workdps(40):
        leaves = 2 * mpmath.pi - mpmath.acos(1 / mpmath.mpf(gamma))
        first, again = np.flatnonzero(np.abs(phases - float(leaves)) < 1e-9)[:2]
        phase, velocity, errors = leaves, mpmath.mpf(0), []
        for i in range(first, again):
            gap, landing = fall_to(gamma, phase, velocity)
            time = mpmath.findroot(gap, mpmath.mpf(times[i]))
            turn = (phase - phases[i] + mpmath.pi) % (2 * mpmath.pi) - mpmath.pi
            errors += [abs(turn), abs(time - times[i])]
            phase, velocity = phase + time, -mpmath.mpf(0.3) * landing(time)
    assert line.outcome[0] == Outcome.PERIODIC
    assert line.multiplier[0] == 0.0
    assert 1e-12 < max(errors) < line.flight_error[0] < 1e5 * max(errors)


def fall_to(gamma: float, phase: mpmath.mpf, velocity: mpmath.mpf) -> tuple[Callable, Callable]:
    """Gap and its rate in a flight that begins on the plate, by the time since."""
    cos, sin = mpmath.cos(phase), mpmath.sin(phase)
    return (
        lambda t: cos + (velocity - sin) * t - t**2 / (2 * mpmath.mpf(gamma)) - mpmath.cos(phase + t),
        lambda t: velocity - sin - t / mpmath.mpf(gamma) + mpmath.sin(phase + t),
    )


@for_each("n", [1, 2])
@for_each("epsilon", [0.15, 0.5, 0.8])
def test_saddle_node(epsilon: float, n: int):
    """The (1, n) orbit of a partially elastic ball appears at n pi (1 - e)/(1 + e)."""

    def is_gone(gamma: float) -> bool:
        line = run(gamma, epsilon, carry=True, settle=20_000, start=locked(gamma, epsilon, n))
        times = recorded(line)
        return len(times) == 0 or abs(times[-1] - TWO_PI * n) > 0.05

    node = n * math.pi * (1.0 - epsilon) / (1.0 + epsilon)
    assert bisect(is_gone, node - 0.01, node + 0.01) == pytest.approx(node, abs=1e-6)


def make_fall(gamma: float, phi: float, gap: float, gap1: float) -> flight.Flight:
    cell = interface.prepare(BallPlate(np.zeros(1)), 0, gamma, 1.0, 1.0)
    return ball.fall(cell, plate_phase(phi), State(gap, gap1, 0.0, 0.0))


def test_grazes_are_distinguished_from_misses():
    """The plate comes up to just touch the ball, or just not, and lets it go on."""
    gamma, phi, gap1 = 4.0, 4.9, -0.5
    fall, taus = Fall(gamma, phi, 0.0, gap1), np.linspace(0.0, 2.0, 20_001)
    bottom = taus[fall.gaps(taus).argmin()]
    touch = -min(fall.gaps(bottom + np.linspace(-1e-3, 1e-3, 20_001)))
    for above, lands in ((-1e-9, True), (-1e-12, True), (1e-12, False), (1e-9, False)):
        tau, _, _ = flight.landing(make_fall(gamma, phi, touch + above, gap1), 0.0, 1e4, 10_000)
        assert (abs(tau - bottom) < 0.1) == lands


@pytest.mark.parametrize("tau", [1e-3, 0.1, 0.3, 0.499])
def test_the_series_of_the_gap_is_complete(tau: float):
    """At a take-off from rest its leading terms are zero and the ones that follow are all there is."""
    gamma, slope = 2.0, math.sqrt(0.75)
    p = make_fall(gamma, TWO_PI - math.atan2(slope, 0.5), 0.0, 0.0)
    gap, gap1, _, _ = flight.state_after(p, tau)
    with mpmath.workdps(50):
        t, sin, cos = mpmath.mpf(tau), mpmath.mpf(p.sin), mpmath.mpf(p.cos)
        exact = -sin * (t - mpmath.sin(t)) - cos * (t * t / 2 - 1 + mpmath.cos(t))
        exact1 = -sin * (1 - mpmath.cos(t)) - cos * (t - mpmath.sin(t))
    for value, expected in ((gap, exact), (gap1, exact1)):
        assert value == pytest.approx(float(expected), rel=2e-15, abs=0.0)


def hops_one_by_one(gamma: float, phi: float, hop: float, epsilon: float) -> float:
    """Time until hops fade, each of them searched for."""
    phases = [phi]
    while hop > 1e-14:
        p = make_fall(gamma, phases[-1] % TWO_PI, 0.0, hop)
        tau, _, _ = flight.landing(p, 0.0, 1e4, 10_000)
        phases.append(phases[-1] + tau)
        hop = -epsilon * flight.state_after(p, tau).gap1
    return phases[-1] - phi


@for_each("epsilon", [0.05, 0.3, 0.7, 0.95])
@for_each("phi", [1.2, 2.0, math.pi, 5.0])
def test_chatter_ends_when_its_hops_do(epsilon: float, phi: float):
    gamma = 2.0
    press, press1 = 1.0 / gamma - math.cos(phi), math.sin(phi)
    hop = bisect(lambda v: contact_law.chatter_completes(v, press, press1, 1.0, epsilon), 0.0, 0.1)
    closed = contact_law.chatter_time(hop, press, press1, epsilon)
    assert closed == pytest.approx(hops_one_by_one(gamma, phi, hop, epsilon), rel=contact_law.STEADY**2)
    assert closed < 2.0 * contact_law.STEADY * math.sqrt(press)


def test_cached_phases_fit_into_the_cache():
    """Compiled code would write beyond the array without an error."""
    assert ball.FIRST + ball.WIDTH * ball.CACHED_PHASES <= CACHE_SIZE


@pytest.mark.parametrize("epsilon", [0.0, 0.15, 0.5])
def test_replayed_phases_are_those_that_would_be_computed(epsilon: float):
    """Phase by phase through the model's own functions, without the cache, beside what a run records."""
    gammas, orbits = np.linspace(1.05, 5.5, 40), 0
    line = run(gammas, epsilon, settle=40, observe=60, keep=2000)
    for i, gamma in enumerate(gammas):
        cell = interface.prepare(BallPlate(np.array([epsilon])), 0, gamma, 1.0, 1.0)
        phi, period, hop, flying, expected = 0.0, 0, 0.0, True, []
        while period < 100:
            end = (interface.flight if flying else interface.contact)(
                cell, plate_phase(phi), State(0.0, hop, 0.0, 0.0), math.inf, 10_000
            )
            landed = period + math.floor((phi + end.tau) / TWO_PI)
            if flying and period >= 40 and landed < 100:
                expected.append((end.tau, phi))
            period, phi = landed, (phi + end.tau) % TWO_PI
            flying, hop = end.in_flight, end.state.gap1
        if line.outcome[i] == Outcome.PERIODIC:  # others depart from each other by what rounding does
            orbits += 1
            assert line.flights[i] == len(expected)
            np.testing.assert_allclose(
                line.flight_time[i, : len(expected)], [f[0] for f in expected], atol=1e-10
            )
            np.testing.assert_allclose(
                line.takeoff_phase[i, : len(expected)], [f[1] for f in expected], atol=1e-10
            )
    assert orbits > 10


def test_settling_skips_whole_cycles():
    """A billion periods of a ball that comes to rest take no longer than a few."""
    for gamma, epsilon in ((1.5, 0.0), (1.5, 0.5), (2.0, 0.15)):
        short, long = (run(gamma, epsilon, settle=settle, keep=64) for settle in (120, 120 + 10**9))
        assert mode(short)[0] > 0
        for name in Line._fields:
            np.testing.assert_allclose(getattr(short, name), getattr(long, name), atol=1e-12)


@pytest.mark.parametrize(
    ("xi", "rigidity", "epsilon"), [(10.0, 650.0, None), (0.5, 650.0, 0.15), (1000.0, 2000.0, None)]
)
def test_rigid_spring_flies_like_the_ball(xi: float, rigidity: float, epsilon: float | None):
    """Figs. 3 and 4, and a locked dashpot, where both repeat and nothing changes nearby."""
    gammas = np.linspace(1.05, 6.0, 100)
    epsilon = float(restitution.restitution_of(xi)) if epsilon is None else epsilon
    window = {"settle": 150, "observe": 50, "keep": 64, "micro_flight": 0.1}
    lines = [
        run_any(gammas, xi / rigidity, xi, model, restitution=e, **window)
        for model, e in ((Model.RIGID, 0.0), (Model.BALL, epsilon))
    ]
    compared = 0
    for i in range(2, len(gammas) - 2):
        modes = {(int(line.bounces[j]), int(line.periods[j])) for line in lines for j in range(i - 2, i + 3)}
        if len(modes) == 1 and modes != {(0, 0)}:
            counted = [np.sort([t for t in recorded(line, i) if t > 0.1])[-5:] for line in lines]
            assert counted[0] == pytest.approx(counted[1], abs=0.05)
            compared += 1
    assert compared > 20
