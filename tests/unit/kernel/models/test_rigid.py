"""The rigid model against the integrated equations of motion, and what only it does."""

import numpy as np
import pytest
from kernel_runs import TWO_PI, phases, recorded, run, run_setting
from naive import Setting, trajectory
from naive_exact import flight, stuck
from tables import for_each

from kernel.models.contact_law import STEADY
from kernel.numerics.first_root import ROOT
from kernel.params import Outcome

CELLS = [
    Setting(1.5, 0.5, 0.26),
    Setting(5.0, 0.5, 0.26),
    Setting(3.0, 1.0, 0.05),
    Setting(2.5, 0.67, 0.05),  # its contacts of no length
    Setting(4.0, 2.0, 0.3),
    Setting(1.8, 3.0, 1.0),
    Setting(1.1, 0.25, 2**-0.5),
    Setting(2.0, 0.8, 0.0),  # n = n' = 0 at the start
    Setting(0.6, 1.0, 0.02),
    Setting(1.8, 0.5, 0.26, restitution=0.5),
    Setting(3.0, 1.0, 0.05, restitution=0.3),
    Setting(3.0, 2.0, 0.5, restitution=0.9),
    Setting(2.0, 0.25, 0.3, restitution=0.3),
]


@for_each("cell", CELLS)
def test_every_flight_is_the_integrated_one(cell):
    """The last hops of chatter are summed, so that only flights above a hundredth are compared."""
    longer = 1e-2 if cell.restitution else 0.0
    expected = [f for f in trajectory(cell, 4.0) if f.time > longer]
    line = run_setting(cell, settle=0, observe=4, keep=300)
    times = recorded(line)
    kept = times > longer
    assert len(expected) == np.count_nonzero(kept) > 0
    assert times[kept] == pytest.approx([f.time for f in expected], abs=1e-9)
    phases = line.takeoff_phase[0, : len(times)][kept]
    assert phases == pytest.approx([f.takeoff % TWO_PI for f in expected], abs=1e-9)


def test_a_contact_of_no_length_between_two_flights():
    """The (2,1) mode at Omega = 0.67, xi = 0.05: where it lands nothing holds it."""
    line = run(2.4, 0.67, 0.05, settle=300, observe=40)
    assert (line.bounces[0], line.periods[0]) == (2, 1)
    times, phases = recorded(line), line.takeoff_phase[0]
    longest = int(np.argmax(times[:-1]))
    assert times[longest + 1] < 0.1
    landing = (phases[longest] + times[longest]) % TWO_PI
    assert phases[longest + 1] == pytest.approx(landing, abs=1e-12)


@pytest.mark.parametrize("restitution", [0.1, 0.5, 0.9])
def test_a_landing_gives_back_the_restitution(restitution):
    """Two flights in a row: the second leaves at e times the speed of the first's impact."""
    s = Setting(3.0, 0.5, 0.26, restitution=restitution)
    cell = Setting(3.0, 0.5, 0.26)
    steps = list(phases(s, 3, 8))
    assert steps[0].flying
    assert steps[0].ending == ROOT
    inelastic = next(iter(phases(cell, 3, 1)))
    # the upper mass keeps its velocity q' + alpha_2', whatever the lower one does
    upper = steps[0].after[1] + steps[0].after[3]
    assert upper == pytest.approx(inelastic.after[1] + inelastic.after[3], abs=1e-14)
    impact = float(flight(s, 0.0, steps[0].before).state(steps[0].tau)[1])
    assert steps[0].after[1] == pytest.approx(-restitution * impact, rel=1e-13)


def hop_by_hop(s: Setting, phi: float, hop: float, q: float, q1: float) -> tuple[float, float, float]:
    """Rad from the first hop to where the mass sticks, and q and q' there; to 80 digits."""
    passed = 0.0
    while hop > 1e-9:  # the next ones add the cube of that
        motion, tau = flight(s, phi + passed, (0.0, hop, q, q1)), 2.0 * hop / s.stuck_force(phi, q, q1)
        for _ in range(4):
            gap, impact, _, _ = motion.state(tau)
            tau -= float(gap / impact)
        _, impact, q, q1 = map(float, motion.state(tau))
        passed, hop, q1 = passed + tau, -s.restitution * impact, q1 + (1.0 + s.restitution) * impact
    return passed, q, q1 + hop


@for_each(("omega", "xi", "e"), [(0.5, 0.26, 0.5), (0.1, 0.3, 0.5), (0.1, 1.0, 0.3), (0.25, 0.3, 0.3)])
def test_chatter_that_is_summed_ends_as_its_hops_one_by_one(omega, xi, e):
    s = Setting(3.0, omega, xi, restitution=e)
    sticks = [step for step in phases(s, 8, 2000) if step.flying and not step.flies_on]
    assert len(sticks) > 3
    for flown in sticks:
        landing = flown.phi + flown.tau
        _, impact, q, q1 = map(float, flight(s, flown.phi, flown.before).state(flown.tau))
        tau, *expected = hop_by_hop(s, landing, -e * impact, q, q1 + (1.0 + e) * impact)
        end = np.array(stuck(s, landing, flown.after).state(tau)[2:], float)
        added = np.subtract(flown.after[2:], (q, q1 + impact))
        assert np.abs(end - expected).max() < STEADY**2 * np.abs(added).max() + 1e-14


@for_each("omega", [0.03, 0.22389726922908548, 0.5, 1.0, 3.0])
@for_each("xi", [0.0, 0.05, 1.0])
def test_gamma_two_exactly(omega, xi):
    """From rest n = 0 at phi = 0 there, and for xi = 0 its rate as well; no jump there."""
    line = run([2.0 * (1.0 - 1e-10), 2.0, 2.0 * (1.0 + 1e-10)], omega, xi, settle=0, observe=1)
    assert set(line.outcome) <= {Outcome.APERIODIC, Outcome.PERIODIC, Outcome.AT_REST, Outcome.SETTLING}
    below, exactly, above = line.end_state
    assert exactly == pytest.approx(below, abs=1e-3)
    assert exactly == pytest.approx(above, abs=1e-3)
