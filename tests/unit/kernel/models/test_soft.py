"""The soft model against the integrated equations of motion; its constants; what stiffness may not cost."""

import json
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from kernel_runs import (
    TWO_PI,
    Model,
    constants,
    examples,
    last_cycle,
    phases,
    powers,
    recorded,
    run,
    run_setting,
)
from mpmath import mp, mpf
from naive import Setting, bounce, trajectory
from naive_exact import pressed
from paths import GOLDEN
from tables import for_each

from kernel.interface import State, plate_phase
from kernel.line import run_line
from kernel.models import soft
from kernel.models.soft_contact import liftoff_function, modes_of, soft_spring, state_of, sure_contact_time
from kernel.numerics.first_root import ROOT, terms
from kernel.numerics.oscillator import propagator
from kernel.numerics.quartic import Factors, paired, roots
from kernel.restitution import restitution_of, scalar_damping_ratio

FACTS = json.loads((GOLDEN / "facts.json").read_text())["restitution"]

CELLS = [
    Setting(1.5, 0.5, 0.26, True, 0.05, 1e-2, True),
    Setting(3.0, 1.0, 0.05, True, 0.3, 1e-2, True),
    Setting(3.0, 1.0, 0.05, True, 0.3, 1e-2, False),
    Setting(1.5, 0.5, 1.0, True, 0.0, 1e-2, True),
    Setting(2.0, 0.67, 0.05, True, 0.1, 2e-3, True),
    Setting(1.6, 3.0, 1.0, True, 0.5, 3e-2, False),
    Setting(2.0, 3.0, 0.3, True, 1.0, 3e-2, True),  # nothing lost in the contact
]


@pytest.mark.parametrize("cell", CELLS, ids=str)
def test_every_flight_is_the_integrated_one(cell):
    expected = trajectory(cell, 2.0)
    line = run_setting(cell, settle=0, observe=2, keep=200)
    assert len(expected) == line.flights[0] > 0
    assert recorded(line) == pytest.approx([f.time for f in expected], abs=1e-8)
    takeoffs = line.takeoff_phase[0, : line.flights[0]]
    assert takeoffs == pytest.approx([f.takeoff % TWO_PI for f in expected], abs=1e-8)


@for_each("zeta", [0.0, 0.01, 0.3, 0.7, 0.999, 1.0, 1.001, 1.5, 4.0])
def test_restitution_is_that_of_an_integrated_impact(zeta):
    assert 2.0 * restitution_of(zeta) == pytest.approx(bounce(zeta, False), abs=1e-10)
    if zeta < 0.9:  # of adhesive impacts nearly nothing is left near 1
        assert scalar_damping_ratio(bounce(zeta, True), True) == pytest.approx(zeta, abs=1e-8)


@pytest.mark.parametrize("fact", FACTS["trap"])
def test_the_trap_is_real(fact):
    """Adhesive's damping in a contact that cannot pull gives a larger restitution than the requested one."""
    got = 2.0 * restitution_of(scalar_damping_ratio(fact["asked"], True))
    assert got == pytest.approx(fact["got"], abs=5e-4)


@pytest.mark.parametrize("fact", FACTS["spring_as_ball"])
def test_a_locked_spring_as_a_ball(fact):
    """epsilon = f(xi) is half the restitution of a contact that cannot pull, at damping ratio xi."""
    assert restitution_of(fact["xi"]) == pytest.approx(fact["half"], abs=5e-5)


@for_each("penetration", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8])
@for_each(("e", "adhesive"), [(0.0, True), (0.01, True), (0.3, True), (0.05, False)])
def test_take_off_keeps_its_digits_however_stiff_the_contact(penetration, e, adhesive):
    """After a hard landing, against 80 digits: n is 1/d**2 times what little the gap is."""
    s = Setting(1.5, 0.5, 0.26, True, e, penetration, adhesive)
    long = [step for step in phases(s, 4, 60) if not step.flying and step.tau > 0.5 and step.ending == ROOT]
    assert long or e > 0.01  # otherwise every landing ends in a long contact
    for step in long[:2]:
        motion = pressed(s, step.phi, step.before)
        lifts = motion.gap if adhesive else motion.force
        near = mpf(step.tau)
        true = mp.findroot(lambda tau, lifts=lifts: lifts(tau), (near, near * (1 + mpf(10) ** -9)), tol=1e-60)
        assert abs(float(true - near)) < 1e-13


def test_soft_tends_to_rigid():
    """Linearly in d, for e = 0."""
    rigid = last_cycle(run(1.5, 0.5, 0.26, settle=300), 1)[0]
    off = []
    for d in (1e-3, 1e-4, 1e-5, 1e-6):
        line = run(1.5, 0.5, 0.26, Model.SOFT, restitution=0.0, penetration=d, settle=300)
        assert (line.bounces[0], line.periods[0]) == (1, 1)
        off.append(abs(last_cycle(line, 1)[0] - rigid))
    slopes = [math.log10(before / after) for before, after in pairwise(off)]
    assert slopes == pytest.approx([1.0] * 3, abs=0.15)


WIDE = {
    "omega": powers(-3.0, 3.0),
    "xi": st.one_of(st.sampled_from([0.0, 1.0, math.sqrt(0.5), 1.0 + 1e-12, 1.0 - 1e-12]), powers(-3.0, 3.0)),
    "penetration": powers(-8.0, -1.0),
    "restitution": st.one_of(st.sampled_from([0.0, 1.0, 0.01]), st.floats(1e-6, 1.0)),
    "adhesive": st.booleans(),
}


def contact(adhesive: bool, restitution: float, **others: float) -> Setting:
    """A setting that can be: a contact that does not pull gives something back; no two motions alike."""
    assume(abs(others["omega"] / others["penetration"] - 1.0) > 1e-3 or others["xi"] > 0.0)
    e = restitution if adhesive else max(restitution, 1e-6)
    return Setting(1.5, soft=True, adhesive=adhesive, restitution=e, **others)


def pairings(c3: float, c2: float, c1: float, c0: float) -> list[Factors]:
    """Every way to factor that the kernel would choose from."""
    z = roots(c3, c2, c1, c0)
    ways = [paired(c3, c2, c1, c0, z, partner) for partner in (1, 2, 3)]
    furthest = max(apart for apart, _ in ways)
    return [f for apart, f in ways if apart >= min(furthest, 0.1)]


@given(**WIDE)
@examples(300)
def test_factors_multiply_to_the_quartic(**wide):
    """Of the spring's free motion on the soft plate: s**4 + c3 s**3 + c2 s**2 + c1 s + c0."""
    s = contact(**wide)
    b, w, beta, kappa = s.b, s.w, s.beta, s.kappa
    of_powers = beta + 2 * b, kappa + 2 * w + b * beta, b * kappa + w * beta, w * kappa
    c3, c2, c1, c0 = map(mpf, of_powers)
    for f in pairings(float(c3), float(c2), float(c1), float(c0)):
        a1, b1, a2, b2 = map(mpf, f)
        assert 0.0 < b1 <= b2 * (1 + 1e-10)
        # a damping may be off by the rounding of the other, far larger one
        assert min(a1, a2) >= -1e-15 * mp.sqrt(b1)
        assert abs(a1 + a2 - c3) <= 1e-14 * (c3 + mp.sqrt(c2))
        assert abs(b1 + b2 + a1 * a2 - c2) <= 1e-14 * c2
        assert abs(a1 * b2 + a2 * b1 - c1) <= 1e-14 * (c1 + mp.sqrt(c0 * c2))
        assert abs(b1 * b2 - c0) <= 1e-14 * c0


@given(**WIDE, phase=st.floats(0.0, 6.28), gap=st.floats(-1.0, 0.0), gap1=st.floats(-2.0, 2.0),
       q=st.floats(-1.0, 1.0), q1=st.floats(-2.0, 2.0), tau=st.floats(-9.0, 0.8))  # fmt: skip
@examples(60)
def test_the_motion_in_contact_is_the_exact_one(phase, gap, gap1, q, q1, tau, **wide):
    """Any state, pressed for any time: all four numbers against 80 digits."""
    s = contact(**wide)
    if abs(s.omega - 1.0) < 1e-3 and s.xi == 0.0:
        return  # resonance is computed beside itself: see test_rigid
    state, tau = (gap * s.penetration, gap1, q * min(1.0, s.omega**2), q1), 10.0**tau
    cell = constants(s)
    overs = propagator(cell.gap_mode, tau), propagator(cell.elongation_mode, tau)
    modes = modes_of(cell, plate_phase(phase), State(*state))
    got = state_of(cell, modes, plate_phase(phase + tau), *overs)
    true = [float(x) for x in pressed(s, phase, state).state(tau)]
    size = 1.0 + abs(gap1) + abs(q1)
    # a phase error grows with every ringing that is still there
    turns = 1.0 + tau * math.sqrt(2.0 * s.w) + min(tau, 40.0 / max(s.beta, 1e-9)) / s.penetration
    scales = (s.penetration * size, size, min(1.0, s.omega) * size + s.omega**2, size)
    for mine, exact, scale in zip(got, true, scales, strict=True):
        assert abs(mine - exact) <= 1e-13 * turns * scale


def test_no_contact_ends_while_its_ringing_is_stepped_over():
    """Impacts all over the range: the function is positive at 400 instants of the time stepped over."""
    rng = np.random.default_rng(7)
    jumps = 0
    for _ in range(300):
        gamma, omega, xi, d = 10.0 ** rng.uniform([-0.3, -1.5, -3, -7], [2, 1.5, 1, -1])
        adhesive = bool(rng.integers(2))
        e = rng.uniform(0.001, 1.0) ** 2
        s = soft_spring(gamma, omega, xi, e, d, adhesive)
        state = (rng.uniform(0, TWO_PI), 0.0, -(10.0 ** rng.uniform(-6, 1)), *rng.normal(0, 2, 2))
        contact = liftoff_function(s, modes_of(s, plate_phase(state[0]), State(*state[1:])), state[0])
        end = sure_contact_time(contact, terms(contact, 0.0))
        jumps += end > 0.0
        for tau in np.linspace(0.0, end, 400):
            t = terms(contact, tau)
            assert t.smooth + t.ring >= -4.0 * t.noise
    assert jumps > 150


def test_a_start_on_the_surface_that_the_plate_presses_is_in_contact():
    """Its neighbour a little below the surface is."""
    rng, one = np.random.default_rng(0), np.ones(200)
    states = np.zeros((200, 6))
    states[:100, 4:] = rng.normal((-0.2, 0.0), 0.5, (100, 2))
    states[100:] = states[:100]
    states[100:, 2] = -1e-12
    plate = soft.plate(restitution=0.01 * one, penetration=1e-3 * one, adhesive=True)
    cells = 0.8215950177 * one, 0.46 * one, 0.05 * one
    line = run_line(*cells, plate=plate, carry=False, states=states, settle=0, observe=1, keep=8)
    np.testing.assert_allclose(line.end_state[:100], line.end_state[100:], atol=1e-6)
