"""Contacts that never end are recognised in closed form, and the search agrees with it."""

import math

import numpy as np
import pytest
from kernel_runs import TWO_PI, Model, constants, run
from naive import Setting
from tables import for_each

from kernel.interface import State, plate_phase
from kernel.models.rigid import Stuck
from kernel.models.soft_contact import liftoff_function, modes_of
from kernel.numerics.first_root import HORIZON, first_root
from kernel.params import Line, Outcome
from kernel.threshold import threshold

#: (Omega, xi): below and above resonance, hardly damped, slow, fast, and locked.
RINGING = [(0.5, 0.26), (0.6, 0.05), (3.0, 0.01), (0.05, 0.1), (20.0, 0.1)]
CELLS = [*RINGING, (5.0, 100.0)]
KINDS = [Model.BALL, Model.RIGID, Model.SOFT]

#: Up to a hundredth below the threshold, in steps of a hundredth.
BELOW = np.arange(0.02, 0.985, 0.01)


def up(which: Model, omega: float, xi: float) -> tuple[np.ndarray, Line]:
    gamma = (1.0 if which == Model.BALL else float(threshold(omega, xi))) * BELOW
    return gamma, run(gamma, omega, xi, which, restitution=0.01, carry=True, settle=200, observe=100)


def arrivals(which: Model, omega: float, xi: float):
    """Gamma, phase and state at the start of each cell of an up ramp but the first."""
    gamma, line = up(which, omega, xi)
    for before, after, end in zip(gamma, gamma[1:], line.end_state, strict=False):
        yield after, end[0], State(*(end[2:] * before / after))


@for_each(("omega", "xi"), CELLS)
@for_each("which", KINDS)
def test_an_up_ramp_at_rest_stays_at_rest_up_to_eq_25(which, omega, xi):
    _, line = up(which, omega, xi)
    assert np.all(line.outcome == Outcome.AT_REST)
    assert not line.flights.any()


@pytest.mark.parametrize("which", [Model.RIGID, Model.SOFT])
@pytest.mark.parametrize("carry", [False, True])
def test_at_the_threshold_to_the_last_digit_there_is_an_answer(which, carry):
    """Eq. 25 and the numbers next to it, where the force that holds the mass touches zero."""
    omega, xi = (a.ravel() for a in np.meshgrid([1e-3, 0.3, 0.6, 1.0, 1.5, 3.0, 1e3], [0.01, 0.05, 0.2, 1.0]))
    at = threshold(omega, xi)
    for gamma in (np.nextafter(at, 0.0), at, np.nextafter(at, np.inf)):
        for i in range(len(gamma)):
            line = run(gamma[i], omega[i], xi[i], which, settle=40, observe=20, carry=carry)
            assert line.outcome[0] not in (Outcome.MISSING, Outcome.UNRESOLVED, Outcome.DIVERGED)


@for_each(("omega", "xi"), CELLS)
def test_where_the_closed_form_excludes_a_take_off_the_search_finds_none(omega, xi):
    for gamma, phi, (_, _, q, q1) in list(arrivals(Model.RIGID, omega, xi))[::6]:
        s = constants(Setting(gamma, omega, xi, restitution=0.01))
        h = q - s.static_elongation - (s.q_re * math.cos(phi) - s.q_im * math.sin(phi))
        h1 = q1 + (s.q_re * math.sin(phi) + s.q_im * math.cos(phi))
        h2 = -s.dashpot * h1 - s.stiffness * h
        h3 = -s.dashpot * h2 - s.stiffness * h1
        tau, ending, used = first_root(Stuck(s, phi, h2, h3), 0.0, 30.0 * TWO_PI, 1_000_000)
        assert (tau, ending) == (30.0 * TWO_PI, HORIZON)
        assert used > 30  # many evaluations, none of which is a zero
    for gamma, phi, state in list(arrivals(Model.SOFT, omega, xi))[::6]:
        s = constants(Setting(gamma, omega, xi, soft=True, restitution=0.01))
        p = liftoff_function(s, modes_of(s, plate_phase(phi), state), phi)
        tau, ending, used = first_root(p, 0.0, 30.0 * TWO_PI, 1_000_000)
        assert (tau, ending) == (30.0 * TWO_PI, HORIZON)
        assert used > 30
