"""The edges of parameter space: every cell ends with an answer, every phase obeys the equations."""

import math
import time
from itertools import cycle, pairwise

import numpy as np
import pytest
from extremes import CELLS, CONTACTS, check_phase, resonant, settings_of
from hypothesis import assume, given
from hypothesis import strategies as st
from kernel_runs import TWO_PI, Model, compile_models, examples, phases, powers, recorded, run, run_setting
from naive import Setting
from plates import HARD_CONTACTS
from tables import for_each

from kernel.numerics.first_root import HORIZON
from kernel.params import Line, Outcome

#: Every cell and every contact; tests/nightly checks the phases of all their pairs.
SOME = list(zip(CELLS, cycle(CONTACTS), strict=False))


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compile before the first test: these tests bound the time of a run."""
    compile_models()


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


@for_each("cell", CELLS)
@for_each("contact", CONTACTS)
def test_extreme_cells_end_with_an_outcome_in_time(cell, contact):
    s = settings_of(cell, contact)
    began = time.process_time()
    line = run_setting(s, settle=2, observe=4)
    assert time.process_time() - began < 2.0  # the budget: 20,000 evaluations a plate period
    check_line(line, 4)
    if s.restitution < 1.0 and not resonant(s):
        assert line.outcome[0] != Outcome.UNRESOLVED


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


@for_each(("e", "d", "omega", "xi"), HARD_CONTACTS)
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


@pytest.mark.parametrize(("cell", "contact"), SOME)
def test_extreme_phases_obey_the_equations_of_motion(cell, contact):
    s = settings_of(cell, contact)
    for step in phases(s, 3, 3):
        check_phase(s, step)


@given(s=anything())
@examples(8)
def test_any_phase_obeys_the_equations_of_motion(s):
    for step in phases(s, 2, 4):
        check_phase(s, step)


def test_phase_stays_exact_over_a_million_periods():
    """Fig. 2(a)'s cycle after 40 and after a million plate periods."""
    short = run(1.5, 0.5, 0.26, settle=500, observe=10)
    long = run(1.5, 0.5, 0.26, settle=999_990, observe=10)
    assert long.outcome[0] == short.outcome[0] == Outcome.PERIODIC
    assert long.flights[0] == short.flights[0] == 9  # the first took off before the window
    assert recorded(long) == pytest.approx(recorded(short), abs=1e-10)
    assert long.takeoff_phase[0, :9] == pytest.approx(short.takeoff_phase[0, :9], abs=1e-10)
