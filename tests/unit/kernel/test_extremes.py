"""The edges of parameter space: every cell ends with an answer, every phase obeys the equations."""

import math
import time
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from kernel_runs import TWO_PI, Model, Step, compile_models, examples, phases, recorded, run, run_setting
from naive import Setting
from naive_exact import Exact, energy, exact, instants, work
from plates import HARD_CONTACTS

from kernel.numerics.first_root import HORIZON, ROOT
from kernel.params import Line, Outcome
from kernel.threshold import threshold

#: (Gamma, Omega, xi)
CELLS = {
    "slow plate": (2.5, 1e-3, 0.1),
    "fast plate": (2.5, 1e3, 0.1),
    "undamped": (1.5, 0.5, 0.0),
    "undamped at resonance": (1.5, 1.0, 0.0),
    "hardly damped beside resonance": (1.5, 1.0 + 1e-12, 1e-12),
    "hardly damped": (3.0, 0.7, 1e-3),
    "hardly damped, slow plate": (1.3, 2e-3, 1e-3),
    "locked dashpot": (3.0, 0.5, 1e3),
    "locked dashpot, slow plate": (3.0, 1e-3, 1e3),
    "locked dashpot, fast plate": (3.0, 1e3, 1e3),
    "critical on the plate": (2.5, 0.8, 1.0),
    "critical on the plate, from below": (2.5, 0.8, 1.0 - 1e-12),
    "critical on the plate, from above": (2.5, 0.8, 1.0 + 1e-12),
    "critical in flight": (2.5, 0.8, math.sqrt(0.5)),
    "critical in flight, from below": (2.5, 0.8, math.sqrt(0.5) * (1.0 - 1e-12)),
    "critical in flight, from above": (2.5, 0.8, math.sqrt(0.5) * (1.0 + 1e-12)),
    "gamma two": (2.0, 0.4, 0.0),
    "gamma two, damped": (2.0, 3.0, 0.3),
    "shaken hard": (100.0, 0.3, 0.05),
    "hardly shaken": (1e-3, 1.7, 0.05),
    "at threshold": (float(threshold(0.6, 0.05)), 0.6, 0.05),
}

#: soft, restitution, penetration, adhesive
CONTACTS = {
    "rigid": (False, 0.0, 1e-3, True),
    "rigid, e = 0.5": (False, 0.5, 1e-3, True),
    "rigid, e = 1": (False, 1.0, 1e-3, True),
    "soft": (True, 0.01, 1e-3, True),
    "very stiff": (True, 0.01, 1e-8, True),
    "critically damped": (True, 0.0, 1e-5, True),
    "very soft, elastic": (True, 1.0, 1e-1, True),
    "very soft, nonadhesive": (True, 0.5, 1e-1, False),
    "very stiff, nonadhesive": (True, 0.01, 1e-8, False),
    "e = 1e-6, nonadhesive": (True, 1e-6, 1e-3, False),
}


EVERYWHERE = pytest.mark.parametrize(("cell", "contact"), list(product(CELLS, CONTACTS)))


def settings_of(cell: str, contact: str) -> Setting:
    return Setting(*CELLS[cell], *CONTACTS[contact])


def resonant(s: Setting) -> bool:
    """An undamped spring at resonance is computed as one 5e-9 beside it."""
    return abs(complex(s.w - 1.0, s.b)) < 1e-6


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compile before the first test: these tests bound the time of a run."""
    compile_models()


# --- outcomes -------------------------------------------------------------------------------


def check_line(line: Line, periods: int) -> None:
    assert line.outcome[0] in (*range(Outcome.PERIODIC, Outcome.UNRESOLVED + 1), Outcome.SETTLING)
    assert np.all(np.isfinite(line.end_state[0]))
    times, takeoffs = recorded(line), line.takeoff_phase[0, : len(recorded(line))]
    assert np.all(times > 0.0)
    assert np.sum(times) <= TWO_PI * periods * (1.0 + 1e-12)
    assert np.all((takeoffs >= 0.0) & (takeoffs < TWO_PI))
    assert np.all(np.isnan(line.flight_time[0, len(times) :]))
    assert (line.outcome[0] == Outcome.PERIODIC) == (line.bounces[0] > 0) == (line.periods[0] > 0)
    if line.outcome[0] == Outcome.AT_REST:
        assert line.flights[0] == 0


@EVERYWHERE
def test_extreme_cells_end_with_an_outcome_in_time(cell, contact):
    s = settings_of(cell, contact)
    began = time.process_time()
    line = run_setting(s, settle=2, observe=4)
    assert time.process_time() - began < 2.0  # the budget: 20,000 evaluations a plate period
    check_line(line, 4)
    if s.restitution < 1.0 and not resonant(s):
        assert line.outcome[0] != Outcome.UNRESOLVED


def powers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda x: 10.0**x)


@st.composite
def anything(draw: st.DrawFn) -> Setting:
    """Any cell of the whole range, with any contact."""
    gamma = draw(st.one_of(st.just(2.0), powers(-3.0, 2.0)))
    omega = draw(st.one_of(st.sampled_from([1.0, math.sqrt(2.0)]), powers(-3.0, 3.0)))
    edges = [0.0, 1.0, math.sqrt(0.5), 1.0 - 1e-12, math.sqrt(0.5) * (1.0 + 1e-12)]
    xi = draw(st.one_of(st.sampled_from(edges), powers(-3.0, 3.0)))
    soft, adhesive = draw(st.booleans()), draw(st.booleans())
    e = draw(st.one_of(st.sampled_from([0.0, 0.01, 1.0]), st.floats(0.0, 1.0)))
    d = draw(powers(-8.0, -1.0))
    assume(xi > 0.0 or abs(omega / d - 1.0) > 1e-3)  # see test_soft: a plate as soft as the spring
    return Setting(gamma, omega, xi, soft, e if adhesive else max(e, 1e-6), d, adhesive)


@given(s=anything())
@examples(300)
def test_any_cell_ends_with_an_outcome_in_time(s):
    began = time.process_time()
    line = run_setting(s, settle=1, observe=2)
    assert time.process_time() - began < 2.0
    check_line(line, 2)
    # an elastic contact never comes to rest, and one nearly so takes long
    assert line.outcome[0] != Outcome.UNRESOLVED or s.restitution > 0.99 or resonant(s)


@pytest.mark.parametrize(("e", "d", "omega", "xi"), HARD_CONTACTS)
def test_every_cell_of_a_hard_contact_ends(e, d, omega, xi):
    gamma = np.append(np.linspace(1.0, 6.0, 101), [2.81, 4.21])
    line = run(gamma, omega, xi, Model.SOFT, restitution=e, penetration=d, adhesive=False, settle=60)
    assert set(line.outcome) <= {Outcome.PERIODIC, Outcome.APERIODIC, Outcome.AT_REST, Outcome.SETTLING}


def test_contacts_and_flights_of_zero_length_do_not_alternate():
    """Undamped at resonance, where n = n' = 0 to rounding: from a take-off on both ended at once for ever."""
    s = Setting(4.278260869565218, 1.0, 0.0, True, 0.01, 1e-8, False)
    steps = list(phases(s, 40, 5000))
    assert steps[-1].ending == HORIZON
    assert all(a.tau > 0.0 or b.tau > 0.0 for a, b in pairwise(steps))
    assert sum(step.used for step in steps) < 40 * 1000
    line = run_setting(s, settle=200, observe=100)
    assert line.outcome[0] in (Outcome.PERIODIC, Outcome.APERIODIC, Outcome.SETTLING)


# --- every phase ----------------------------------------------------------------------------


@EVERYWHERE
def test_extreme_phases_obey_the_equations_of_motion(cell, contact):
    s = settings_of(cell, contact)
    for step in phases(s, 3, 3):
        check_phase(s, step)


@given(s=anything())
@examples(25)
def test_any_phase_obeys_the_equations_of_motion(s):
    for step in phases(s, 2, 4):
        check_phase(s, step)


def check_phase(s: Setting, step: Step) -> None:
    assert step.ending in (ROOT, HORIZON)
    assert 0.0 <= step.tau < math.inf
    assert step.flying or step.ending == HORIZON or step.flies_on  # a contact ends in a flight
    motion = exact(s, step.flying, step.phi, step.before)
    end = before_impact(s, step, motion)
    check_end(s, step, motion, end)
    check_energy(s, step, motion, end)
    if step.tau > 0.0:
        check_the_side_of_the_plate(s, step, motion)


def before_impact(s: Setting, step: Step, motion: Exact) -> tuple[float, float, float, float]:
    """The kernel's state at the end of a phase, with what a rigid plate did to it undone."""
    gap, gap1, q, q1 = step.after
    if s.soft or not step.flying or step.ending != ROOT:
        return step.after
    impact = float(motion.state(step.tau)[1])
    assert impact <= 1e-9
    # it leaves at e times the speed of the impact, or stays if its chatter may be summed
    assert gap1 == 0.0 or gap1 == pytest.approx(-s.restitution * impact, rel=1e-6, abs=1e-12)
    return gap, impact, q, q1 + gap1 - impact


def sizes(s: Setting, step: Step) -> tuple[float, float, float, float]:
    """How large gap, gap', q and q' are, and what is added up for them."""
    gap, gap1, q, q1 = step.before
    speed = 1.0 + abs(gap1) + abs(q1) + step.tau / s.gamma
    stretch = abs(q) + s.omega**2 / s.gamma + min(1.0, s.omega) * speed
    if step.flying or not s.soft:
        return 2.0 + abs(gap) + speed * step.tau + stretch, speed, stretch, speed
    force = 1.0 + 1.0 / s.gamma + s.w * stretch + s.b * speed
    return abs(gap) + s.penetration * speed + s.penetration**2 * force, speed, stretch, speed


def rounding(s: Setting, step: Step, motion: Exact) -> float:
    """Relative: the phase of a fast ringing is known to so many digits only."""
    return 1e-6 if resonant(s) else 1e-13 * (1.0 + 0.01 * min(step.tau * motion.fastest(), 1e6))


def check_end(s: Setting, step: Step, motion: Exact, end: tuple[float, float, float, float]) -> None:
    """The state the kernel went on with is the one the equations lead to."""
    digits = rounding(s, step, motion)
    for mine, true, size in zip(end, motion.state(step.tau), sizes(s, step), strict=True):
        assert abs(mine - float(true)) <= digits * size


def check_energy(s: Setting, step: Step, motion: Exact, end: tuple[float, float, float, float]) -> None:
    before, size0 = energy(s, step.phi, step.before)
    after, size1 = energy(s, step.phi + step.tau, end)
    gained, size2 = work(s, motion, step.phi, step.tau)
    assert abs(after - before - gained) <= 10.0 * rounding(s, step, motion) * (size0 + size1 + size2)


def check_the_side_of_the_plate(s: Setting, step: Step, motion: Exact) -> None:
    """In flight above the plate (but after a nonadhesive contact), in contact below it and not too deep."""
    digits, size = rounding(s, step, motion), sizes(s, step)[0]
    taus = instants(motion, step.tau, 400)
    gaps = motion.gaps(taus)
    if step.flying:
        below_surface = s.soft and not s.adhesive
        deepest = min(step.before[0], 0.0) if below_surface else 0.0
        assert gaps.min() >= deepest * (1.0 + 1e-9) - 10.0 * digits * size
        return
    if not s.soft:
        push = motion.force.many(taus)
        assert push.min() >= -100.0 * digits * (1.0 + 2.0 / s.gamma + np.abs(push).max())
        return
    assert gaps.max() <= 10.0 * digits * size
    pull = s.b * motion.q1.many(taus) + s.w * motion.q.many(taus) + np.cos(step.phi + taus) - 1.0 / s.gamma
    given_way = (
        abs(step.before[0])
        + s.penetration * abs(step.before[1])
        + 4.0 * s.penetration**2 * np.abs(pull).max()
    )
    assert -gaps.min() <= given_way * (1.0 + 1e-9)


# --- long runs ------------------------------------------------------------------------------


def test_phase_stays_exact_over_a_million_periods():
    """Fig. 2(a)'s cycle after 40 and after a million plate periods."""
    short = run(1.5, 0.5, 0.26, settle=500, observe=10)
    long = run(1.5, 0.5, 0.26, settle=999_990, observe=10)
    assert long.outcome[0] == short.outcome[0] == Outcome.PERIODIC
    assert long.flights[0] == short.flights[0] == 9  # the first took off before the window
    assert recorded(long) == pytest.approx(recorded(short), abs=1e-10)
    assert long.takeoff_phase[0, :9] == pytest.approx(short.takeoff_phase[0, :9], abs=1e-10)


@pytest.mark.parametrize("model", [Model.RIGID, Model.SOFT])
def test_a_spring_at_rest_stays_at_rest(model):
    """However long: a million periods cost one evaluation."""
    began = time.process_time()
    line = run(0.5, 2.0, 0.3, model, settle=1_000_000, observe=10)
    assert line.outcome[0] == Outcome.AT_REST
    assert time.process_time() - began < 2.0
