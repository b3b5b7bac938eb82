"""Isolated impacts against 40 digits; the same digits compiled and not, one number or an array."""

import math

import numpy as np
import pytest
from mpmath import mp, mpf
from tables import for_each

from kernel import restitution
from kernel.models import contact_law
from kernel.restitution import SMALLEST

#: From hardly damped to the strongest damping there is, and around critical damping.
NEAR = np.logspace(-16.0, -1.0, 31)
ZETAS = np.concatenate(
    [np.logspace(-9.0, -0.1, 30), 1.0 - NEAR, [1.0], 1.0 + NEAR, np.logspace(0.1, 6.0, 60)]
)
RESTITUTIONS = np.concatenate([np.logspace(-12.0, 0.0, 100), 1.0 - NEAR, [0.5]])


def exponent(zeta: mpf) -> mpf:
    """-ln e of a nonadhesive impact (docs/model.md, section 2)."""
    if zeta == 1:
        return mpf(2)
    return mp.re(2 * zeta * mp.acos(zeta) / mp.sqrt(mp.mpc(1 - zeta * zeta)))


@for_each("zeta", ZETAS)
def test_restitution_without_adhesion(zeta):
    with mp.workdps(40):
        log = exponent(mpf(float(zeta)))
        true = mp.exp(-log)
        got = 2 * mpf(float(restitution.restitution_of(zeta)))
        assert abs(got / true - 1) <= 1e-15 * (1 + log)


@for_each("e", RESTITUTIONS)
def test_damping_ratio(e):
    """To rounding of ln e, also where e is next to 1."""
    with mp.workdps(40):
        log = -mp.log(mpf(float(e)))
        got = mpf(restitution.scalar_damping_ratio(float(e), False))
        assert abs(exponent(got) - log) <= 2e-15 * log
        adhesive = mpf(restitution.scalar_damping_ratio(float(e), True))
        assert abs(adhesive - log / mp.hypot(mp.pi, log)) <= 1e-15 * adhesive


def test_the_ends():
    assert restitution.restitution_of([0.0, 0.0]).tolist() == [0.5, 0.5]
    assert restitution.damping_ratio([0.0, 1.0], True).tolist() == [1.0, 0.0]
    assert restitution.damping_ratio([1.0], False).tolist() == [0.0]
    assert restitution.damping_ratio(0.0, False) == restitution.damping_ratio(SMALLEST, False)
    assert restitution.contact_time([1.0, 1.0], 1.0, True).tolist() == [math.pi, math.pi]
    assert math.isnan(restitution.scalar_damping_ratio(math.nan, False))


@pytest.mark.parametrize("adhesive", [True, False])
def test_compiled_numbers_and_arrays_have_the_same_digits(adhesive):
    compiled = contact_law.jit(restitution.scalar_damping_ratio)
    plain = [restitution.scalar_damping_ratio(float(e), adhesive) for e in RESTITUTIONS]
    assert [compiled(float(e), adhesive) for e in RESTITUTIONS] == plain
    assert restitution.damping_ratio(RESTITUTIONS, adhesive).tolist() == plain
    square = restitution.damping_ratio(RESTITUTIONS[:100].reshape(10, 10), adhesive)
    assert square.ravel().tolist() == plain[:100]
