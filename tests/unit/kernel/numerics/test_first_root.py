"""First roots: none missed, none early, over the whole range; the oscillator that they are made of."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from kernel_runs import Step, examples, one_phase, powers
from mpmath import mp, mpf
from naive import Setting
from naive_exact import Exact, exact, instants, lowest, response
from tables import for_each

from kernel.numerics import oscillator
from kernel.numerics.first_root import HORIZON, ROOT, safe_step

HORIZON_RAD = 4.0 * math.pi
BUDGET = 20_000


def signed(largest: float) -> st.SearchStrategy[float]:
    """As many small numbers as large ones."""
    return st.tuples(st.sampled_from([-1.0, 1.0]), powers(-9.0, math.log10(largest))).map(
        lambda x: x[0] * x[1]
    )


CELLS = {
    "gamma": st.one_of(st.just(2.0), powers(-3.0, 2.0)),
    "omega": st.one_of(st.sampled_from([1.001, math.sqrt(2.0)]), powers(-3.0, 3.0)),
    "xi": st.one_of(
        st.sampled_from([0.0, 1.0, math.sqrt(0.5), 1.0 - 1e-12, math.sqrt(0.5) * (1.0 + 1e-12)]),
        powers(-3.0, 3.0),
    ),
    "phi": st.floats(0.0, 2.0 * math.pi),
}


def check(s: Setting, step: Step, what: str) -> None:
    """The function named must stay positive until the phase ends, and be zero where it ends."""
    assume(abs(complex(s.w - 1.0, s.b)) > 1e-4)  # an undamped spring at resonance is computed beside it
    assert step.ending in (ROOT, HORIZON)
    assert step.used < BUDGET
    motion = exact(s, step.flying, step.phi, step.before)
    sign = -1.0 if what == "depth" else 1.0

    def values(taus: np.ndarray) -> np.ndarray:
        return motion.force.many(taus) if what == "force" else sign * motion.gaps(taus)

    # the twin's own rounding for a gap; for the force of a contact of stiffness 1/d**2, the kernel's
    digits = 1e-11 if s.soft and what == "force" else 1e-13
    rounding = digits * (1.0 + 0.01 * step.tau * motion.fastest()) * size_of(s, step, motion, what)
    if step.tau > 0.0:
        taus = instants(motion, step.tau, 12_000)
        minimum, where = lowest(values, taus[taus > 0.0])
        assert minimum >= -rounding - slope(motion, what, where) * 1e-13 * step.tau, (where, "missed")
    if step.ending == ROOT:
        value = abs(float(motion.force(step.tau) if what == "force" else motion.state(step.tau)[0]))
        assert value <= rounding + slope(motion, what, step.tau) * 1e-13 * step.tau, (step.tau, "early")


def slope(motion: Exact, what: str, tau: float) -> float:
    return abs(float(motion.force.slope()(tau) if what == "force" else motion.state(tau)[1]))


def size_of(s: Setting, step: Step, motion: Exact, what: str) -> float:
    """How large the numbers are whose difference the function is."""
    taus = np.linspace(0.0, step.tau, 50)
    if what == "force":
        return 1.0 + 2.0 / s.gamma + float(np.abs(motion.force.many(taus)).max())
    if what == "depth":
        _, gap1, q, q1 = step.before
        pushed = 1.0 + 2.0 / s.gamma + abs(s.w * q) + abs(s.b * q1)
        deepest = float(np.abs(motion.gaps(taus)).max())
        return deepest + s.penetration * abs(gap1) + s.penetration**2 * pushed
    q = float(np.abs(motion.q.many(taus)).max())
    drift = abs(step.before[1]) + abs(step.before[3]) + 1.0
    return 2.0 + abs(step.before[0]) + q + drift * step.tau + step.tau**2 / s.gamma


@given(
    **CELLS, gap=st.one_of(st.just(0.0), powers(-9.0, 0.5)), gap1=signed(5.0), q=signed(1.0), q1=signed(5.0)
)
@examples(20)
def test_no_landing_is_missed(gamma, omega, xi, phi, gap, gap1, q, q1):
    state = (gap, gap1 if gap > 0.0 else abs(gap1), q * min(1.0, omega**2), q1)
    s = Setting(gamma, omega, xi, restitution=1.0)
    check(s, one_phase(s, True, phi, state, HORIZON_RAD, BUDGET), "gap")


@given(**CELLS, q1=signed(5.0))
@examples(20)
def test_no_landing_is_missed_after_a_take_off(gamma, omega, xi, phi, q1):
    """Gap, gap' and gap'' all zero: the root at the beginning is a triple one."""
    s = Setting(gamma, omega, xi)
    q = (1.0 / gamma - math.cos(phi) - s.b * q1) / s.w
    falling = math.sin(phi) - s.b * (math.cos(phi) - 1.0 / gamma - s.b * q1 - s.w * q) - s.w * q1
    assume(falling < -1e-6 * (1.0 + abs(s.b) + abs(s.w * q1)))
    check(s, one_phase(s, True, phi, (0.0, 0.0, q, q1), HORIZON_RAD, BUDGET), "gap")


@given(**CELLS, force=powers(-9.0, 1.0), q1=signed(5.0))
@examples(20)
def test_no_take_off_is_missed(gamma, omega, xi, phi, force, q1):
    s = Setting(gamma, omega, xi)
    q1 *= min(1.0, 1.0 / s.b) if s.b else 1.0
    q = (1.0 / gamma - math.cos(phi) - s.b * q1 - force) / s.w
    check(s, one_phase(s, False, phi, (0.0, 0.0, q, q1), HORIZON_RAD, BUDGET), "force")


SOFT = {
    "penetration": powers(-8.0, -1.0),
    "restitution": st.one_of(st.sampled_from([0.01, 0.1]), st.floats(0.0, 0.9)),
}


@given(**CELLS, **SOFT, depth=powers(-6.0, 0.0), gap1=signed(2.0), q=signed(1.0), q1=signed(2.0))
@examples(20)
def test_no_release_is_missed(gamma, omega, xi, phi, penetration, restitution, depth, gap1, q, q1):
    """An adhesive contact lasts as long as the mass is below the plate."""
    s = Setting(gamma, omega, xi, True, restitution, penetration, True)
    state = (-depth * penetration, gap1, q * min(1.0, omega**2), q1)
    check(s, one_phase(s, False, phi, state, HORIZON_RAD, BUDGET), "depth")


@given(**CELLS, **SOFT, depth=powers(-6.0, 0.0), gap1=signed(2.0), q=signed(1.0), q1=signed(2.0))
@examples(20)
def test_no_release_without_adhesion_is_missed(
    gamma, omega, xi, phi, penetration, restitution, depth, gap1, q, q1
):
    """A contact that cannot pull lasts as long as it pushes."""
    s = Setting(gamma, omega, xi, True, max(restitution, 0.01), penetration, False)
    state = (-depth * penetration, -abs(gap1), q * min(1.0, omega**2), q1)
    check(s, one_phase(s, False, phi, state, HORIZON_RAD, BUDGET), "force")


@given(**CELLS, **SOFT, depth=powers(-6.0, -1.0), q=signed(1.0), q1=signed(2.0))
@examples(20)
def test_a_flight_below_the_surface_ends_at_recontact(
    gamma, omega, xi, phi, penetration, restitution, depth, q, q1
):
    """Released below the plate with n = 0: the flight ends where gap < 0 and n > 0 again."""
    s = Setting(gamma, omega, xi, True, max(restitution, 0.01), penetration, False)
    gap = -depth * penetration
    state = (gap, -s.kappa * gap / s.beta * (1.0 + 1e-9), q * min(1.0, omega**2), q1)
    step = one_phase(s, True, phi, state, 1.0, BUDGET)
    assert step.ending in (ROOT, HORIZON)
    motion = exact(s, True, phi, state)
    taus = instants(motion, step.tau, 5000)[1:-1]
    gaps = motion.gaps(taus)
    rates = motion.gap1.many(taus) + float(motion.fall[1]) + 2.0 * float(motion.fall[2]) * taus
    bearing = np.minimum(-gaps, -(s.kappa * gaps + s.beta * rates))
    # what the digits of gap leave unsure: its rounding times kappa
    unsure = 1e-13 * (1.0 + abs(q1) * step.tau) * s.kappa * (1.0 + abs(state[2]))
    assert bearing.max(initial=-1.0) <= unsure


@pytest.mark.parametrize(
    ("gamma", "omega", "xi", "phi", "state", "tau"),
    [
        (1.2105, 0.36354, 0.03554, 3.1138, (-2.34927e-4, 2.443619e-2, 0.0387416, -1.854625), 6.04e-3),
        (4.50568, 1.49990, 0.31949, 4.17687, (-1.318e-4, 1.37093e-2, 0.241245, -1.572923), 1.95e-3),
    ],
)
def test_a_return_to_contact_is_found_whatever_is_left_of_the_window(gamma, omega, xi, phi, state, tau):
    """The mass never emerges: no search for that goes on for the 500 plate periods that are left."""
    s = Setting(gamma, omega, xi, True, 0.01, 1e-3, False)
    step = one_phase(s, True, phi, state, 1000.0 * math.pi, BUDGET)
    assert (step.ending, step.flies_on) == (ROOT, False)
    assert step.tau == pytest.approx(tau, rel=0.05)
    assert step.used <= 8


@given(**CELLS, gap1=powers(-9.0, 0.0), q=signed(1.0), q1=signed(2.0), below=st.sampled_from([0.0, 0.3]))
@examples(60)
def test_the_end_of_a_hop_keeps_its_digits(gamma, omega, xi, phi, gap1, q, q1, below):
    """Thrown up against a pressing plate, from it or from below: a short flight, to the last digits."""
    s = Setting(gamma, omega, xi, below > 0.0, 0.1, 1e-3, True)
    q *= min(1.0, omega**2)
    press = 1.0 / gamma - math.cos(phi) - 0.5 * s.b * q1 - 0.5 * s.w * q
    assume(press > 0.0 and abs(complex(s.w - 1.0, s.b)) > 1e-4)  # as in `check`
    state = (-below * gap1**2 / (2.0 * press), gap1, q, q1)
    motion = exact(s, True, phi, state)
    step = one_phase(s, True, phi, state, HORIZON_RAD, BUDGET)
    assume(step.ending == ROOT and step.tau < 3.0 * gap1 / press)
    assume(abs(step.after[0]) < 1e-3 * gap1 * step.tau)  # else pressed again before it has emerged
    expected = mpf(step.tau)
    with mp.workdps(40):
        for _ in range(6):  # Newton
            gap, rate, *_ = motion.state(expected)
            expected -= gap / rate
    # the gap's curvature is a difference of these, and the speed of the landing divides its rounding
    terms = (1.0 + 1.0 / gamma + abs(q) + abs(q1)) * (1.0 + s.w + s.b)
    lost = 1e-13 * terms * step.tau / abs(float(rate))
    assert abs(step.tau - float(expected)) <= (1e-14 + lost) * step.tau


@for_each("above", [1e-3, 1e-6, 1e-9, 1e-12])
@for_each(("omega", "xi"), [(0.4, 0.3), (1.0, 0.05), (3.0, 0.0), (30.0, 1.0)])
def test_a_graze_of_the_normal_force(omega, xi, above):
    """Driven steadily, n = 2/Gamma - |N| cos(.): how near it comes to zero is ours to set."""
    w, b = 1.0 / omega**2, 2.0 * xi / omega
    driven = 1.0 / complex(w - 1.0, b)
    swing = 1.0 + complex(w, b) * driven
    start = 0.7 - np.angle(swing)  # n is least where phi = -angle(N)
    for sign in (1.0, -1.0):
        gamma = 2.0 / (abs(swing) * (1.0 + sign * above))
        wave = driven * np.exp(1j * start)
        state = (0.0, 0.0, float(-1.0 / (gamma * w) + wave.real), float(-wave.imag))
        step = one_phase(
            Setting(gamma, omega, xi), False, float(start % (2 * math.pi)), state, HORIZON_RAD, BUDGET
        )
        if sign > 0.0:
            assert step.ending == HORIZON
        else:
            assert step.ending == ROOT
            expected = 2.0 * math.pi - 0.7 - math.acos(1.0 - above)
            assert step.tau == pytest.approx(expected, abs=1e-6 + 1e-15 / math.sqrt(above))


@given(f0=powers(-12.0, 1.0), f1=signed(10.0), f2=signed(10.0), f3=signed(10.0), f4=powers(-3.0, 6.0),
       guess=powers(-9.0, 2.0))  # fmt: skip
@examples(300)
def test_a_safe_step_is_safe_and_a_step(f0, f1, f2, f3, f4, guess):
    step = safe_step(f0, f1, f2, f3, f4, guess)
    assert step > 0.0
    s = np.linspace(0.0, step, 400)[:-1]
    bound = f0 + s * (f1 + s * (f2 / 2.0 + s * (f3 / 6.0 - s * f4 / 24.0)))
    size = f0 + s * (abs(f1) + s * (abs(f2) / 2.0 + s * (abs(f3) / 6.0 + s * f4 / 24.0)))
    assert np.all(bound >= -1e-12 * size)


# --- the oscillator -------------------------------------------------------------------------

NEAR = [0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3]
RATIOS = [0.0, 1e-9, 0.1, 0.9, *(1.0 - x for x in NEAR), *(1.0 + x for x in NEAR), 1.1, 10.0, 1e3, 1e6]


@for_each("ratio", RATIOS)
@for_each("rate", [1e-3, 1.0, 1e3])
def test_the_oscillator_at_every_damping(ratio, rate):
    """Within a few digits' rounding of what it is made of, however near critical."""
    osc = oscillator.oscillator(ratio * rate, rate * rate)
    for tau in np.concatenate([[0.0], np.logspace(-9, 2.5, 24)]) / rate:
        expected = response(ratio * rate, rate * rate, float(tau))
        cosine, sine, sine1 = (float(x) for x in expected)
        got = oscillator.response(osc, float(tau))
        # what rounding of w does to the phase, or near critical damping to a**2 - w
        turns = 1.0 + rate * tau * (rate * tau if abs(ratio - 1.0) < 0.1 else 1.0)
        scales = (
            abs(cosine) + rate * abs(sine),
            abs(sine) + abs(cosine) / rate,
            abs(sine1) + rate * abs(sine),
        )
        for mine, true, scale in zip(got, (cosine, sine, sine1), scales, strict=True):
            assert abs(mine - true) <= 2e-15 * turns * scale + 1e-125 * max(rate, 1.0 / rate)


@given(ratio=st.one_of(st.sampled_from(RATIOS), powers(-3.0, 6.0)), rate=powers(-3.0, 3.0), x=signed(10.0),
       v=signed(10.0), tau=powers(-6.0, 1.0))  # fmt: skip
@examples(200)
def test_a_motion_in_coordinates_is_the_same_motion(ratio, rate, x, v, tau):
    osc, tau = oscillator.oscillator(ratio * rate, rate * rate), tau / rate
    a, b = oscillator.coordinates(osc, x, v)
    now = oscillator.all_derivatives(osc, a, b)
    there, speed = oscillator.position(osc, a, b)
    assert there == now.x == pytest.approx(x, rel=1e-14, abs=1e-14 * now.size)
    assert speed == now.x1 == pytest.approx(v, rel=1e-14, abs=1e-14 * now.size * osc.rate)
    later = oscillator.advance(osc, a, b, tau)
    cosine, sine, sine1 = response(ratio * rate, rate * rate, tau)
    expected = float(x * cosine + v * sine), float(v * sine1 - rate * rate * sine * x)
    turns = 1.0 + rate * tau * (rate * tau if abs(ratio - 1.0) < 0.1 else 1.0)
    scale = abs(x) * float(abs(cosine) + rate * abs(sine)) + abs(v) * float(abs(sine) + abs(cosine) / rate)
    got, then = oscillator.position(osc, *later), oscillator.all_derivatives(osc, *later)
    scale += then.size
    assert abs(got[0] - expected[0]) <= 1e-14 * turns * scale + 1e-300
    assert abs(got[1] - expected[1]) <= 1e-14 * turns * scale * max(osc.rate, rate) + 1e-300
    assert abs(got[0]) <= now.size * (1.0 + 1e-12)
    rates = [later]
    for _ in range(4):
        a1, b1 = rates[-1]
        apart = oscillator.apart(osc)
        rates.append(
            (osc.slow * a1, osc.fast * b1) if apart else (b1, -2.0 * osc.damping * b1 - osc.stiffness * a1)
        )
    first, fourth = oscillator.position(osc, *rates[1])[0], oscillator.position(osc, *rates[4])[0]
    assert first == pytest.approx(got[1], rel=1e-12, abs=1e-300)
    assert abs(fourth) <= now.x4 * (1.0 + 1e-9) + 1e-300
    quiet = oscillator.quiet_time(osc, a, b, 0.1 * now.size)
    if quiet < math.inf:
        after, _ = oscillator.position(osc, *oscillator.advance(osc, a, b, quiet + tau))
        assert abs(after) <= 0.1 * now.size * (1.0 + 1e-12)
