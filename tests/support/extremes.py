"""Cells at the edges of parameter space, and the checks that every phase of theirs has to pass."""

import math

import numpy as np
import pytest
from kernel_runs import Step
from naive import Setting
from naive_exact import Exact, energy, exact, instants, work

from kernel.numerics.first_root import HORIZON, ROOT
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


def settings_of(cell: str, contact: str) -> Setting:
    return Setting(*CELLS[cell], *CONTACTS[contact])


def resonant(s: Setting) -> bool:
    """An undamped spring at resonance is computed as one 5e-9 beside it."""
    return abs(complex(s.w - 1.0, s.b)) < 1e-6


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
    """The kernel's state at the end of a phase, before the impact on a rigid plate."""
    gap, gap1, q, q1 = step.after
    if s.soft or not step.flying or step.ending != ROOT:
        return step.after
    impact = float(motion.state(step.tau)[1])
    assert impact <= 1e-9
    # it leaves at e times the speed of the impact, or stays if its chatter may be summed
    assert gap1 == 0.0 or gap1 == pytest.approx(-s.restitution * impact, rel=1e-6, abs=1e-12)
    return gap, impact, q, q1 + gap1 - impact


def sizes(s: Setting, step: Step) -> tuple[float, float, float, float]:
    """The sizes of the terms of gap, gap', q and q'."""
    gap, gap1, q, q1 = step.before
    speed = 1.0 + abs(gap1) + abs(q1) + step.tau / s.gamma
    stretch = abs(q) + s.omega**2 / s.gamma + min(1.0, s.omega) * speed
    if step.flying or not s.soft:
        return 2.0 + abs(gap) + speed * step.tau + stretch, speed, stretch, speed
    force = 1.0 + 1.0 / s.gamma + s.w * stretch + s.b * speed
    return abs(gap) + s.penetration * speed + s.penetration**2 * force, speed, stretch, speed


def rounding(s: Setting, step: Step, motion: Exact) -> float:
    """The relative rounding error, which grows with the phase of a fast ringing, and beside resonance."""
    if resonant(s):
        return 1e-6
    return 1e-13 * (1.0 + 0.01 * min(step.tau * motion.fastest(), 1e6)) + 1e-15 / abs(complex(s.w - 1.0, s.b))


def check_end(s: Setting, step: Step, motion: Exact, end: tuple[float, float, float, float]) -> None:
    """The state the kernel went on with is the one the equations lead to."""
    digits, pushed = rounding(s, step, motion), summed_chatter(s, step, end)
    for mine, true, size in zip(end, motion.state(step.tau), sizes(s, step), strict=True):
        assert abs(mine - float(true)) <= digits * size + pushed


def summed_chatter(s: Setting, step: Step, end: tuple[float, float, float, float]) -> float:
    """A bound on what chatter that is summed adds to q and q'."""
    stays = step.flying and step.ending == ROOT and not step.flies_on
    if s.soft or not stays or s.restitution == 0.0:
        return 0.0
    _, _, q, q1 = step.after
    n = 1.0 / s.gamma - math.cos(step.phi + step.tau) - s.b * q1 - s.w * q
    hop = s.restitution * end[1]
    return (s.b + abs(s.w - s.b**2)) * abs(hop) ** 3 / (n**2 * (1.0 - s.restitution**3))


def check_energy(s: Setting, step: Step, motion: Exact, end: tuple[float, float, float, float]) -> None:
    before, size0 = energy(s, step.phi, step.before)
    after, size1 = energy(s, step.phi + step.tau, end)
    gained, size2 = work(s, motion, step.phi, step.tau)
    assert abs(after - before - gained) <= 10.0 * rounding(s, step, motion) * (size0 + size1 + size2)


def check_the_side_of_the_plate(s: Setting, step: Step, motion: Exact) -> None:
    """Flight is above the plate, except after a nonadhesive contact; contact is below it, not too deep."""
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
