"""The bouncing spring on a soft plate, solved exactly (paper Eqs. 9 to 12, MODEL section 2).

In contact the plate pushes with n = -(kappa gap + beta gap'), and the motion is known exactly
(see `pressed`): no time steps are needed however stiff the contact is, and the search for
take-off steps over the contact's ringing as soon as it is too small to lift the mass.

adhesive: contact while gap < 0; take-off and landing are zeros of the gap, and n may pull.
nonadhesive: contact while gap < 0 and n > 0, so that a flight begins below the plate.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.interface import contact, contact_force, flies, flight, prepare, rest
from kernel.models.contact_law import lets_go
from kernel.models.flight import Flight, flight_terms, landing, state_after, take_off
from kernel.models.soft_contact import SoftSpring, join, pressed, soft_spring, split
from kernel.models.soft_liftoff import pressed_until
from kernel.numerics.elementary import turned
from kernel.numerics.first_root import EPS, HORIZON, ROOT, Phase, Terms, first_root, terms
from kernel.numerics.jit import jit
from kernel.numerics.oscillator import derivatives, envelope, motion, quiet_after
from kernel.validation import check_arrays


class SoftPlate(NamedTuple):
    """The plate under each cell of a line."""

    restitution: NDArray[np.float64]  # (n,) true restitution of an isolated impact
    penetration: NDArray[np.float64]  # (n,) d, plate amplitudes
    adhesive: bool


def plate(*, restitution: NDArray[np.float64], penetration: NDArray[np.float64], adhesive: bool) -> SoftPlate:
    """The plate under n cells; restitution (n,) in [0, 1], penetration (n,) > 0 in plate amplitudes.

    Raises KernelInputError.
    """
    check_arrays({"restitution": restitution, "penetration": penetration})
    return SoftPlate(np.ascontiguousarray(restitution), np.ascontiguousarray(penetration), bool(adhesive))


class Recoil(NamedTuple):
    """kappa gap + beta gap' while a nonadhesive contact springs back: zero brings the plate back to bear."""

    flight: Flight
    kappa: float
    beta: float


class Dip(NamedTuple):
    """-gap of a lower mass still below the plate."""

    flight: Flight


@prepare.register(SoftPlate)
@jit
def _prepare(plate: SoftPlate, i: int, gamma: float, omega: float, xi: float) -> SoftSpring:
    return soft_spring(gamma, omega, xi, plate.restitution[i], plate.penetration[i], plate.adhesive)


@contact_force.register(SoftSpring)
@jit
def _contact_force(s: SoftSpring, cos: float, gap: float, gap1: float, q: float, q1: float) -> float:
    return -(s.kappa * gap + s.beta * gap1)


@rest.register(SoftSpring)
@jit
def _rest(s: SoftSpring) -> tuple[float, float, float, float]:
    return s.dent, 0.0, s.sag, 0.0


@flies.register(SoftSpring)
@jit
def _flies(s: SoftSpring, phi: float, gap: float, gap1: float, q: float, q1: float) -> bool:
    return lets_go(gap, gap1, s.kappa, 0.0 if s.adhesive else s.beta)


@contact.register(SoftSpring)
@jit
def _contact(
    s: SoftSpring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    m = split(s, phi, gap, gap1, q, q1)
    p = pressed(s, m, phi)
    lull = p.still - math.hypot(p.w_re, p.w_im)
    ringing = envelope(p.slow_osc, p.slow, p.slow1) + envelope(p.fast_osc, p.fast, p.fast1)
    quiet = 0.0
    if ringing >= lull:
        quiet = max(
            quiet_after(p.slow_osc, p.slow, p.slow1, 0.5 * lull),
            quiet_after(p.fast_osc, p.fast, p.fast1, 0.5 * lull),
        )
    tau, ending, used = first_root(p, pressed_until(p, terms(p, 0.0)), min(horizon, quiet), budget)
    if ending == HORIZON:  # or nothing can lift it any more
        tau = horizon
    gap, gap1, q, q1 = join(s, m, phi, tau)
    if ending == ROOT and s.adhesive:
        gap, gap1 = 0.0, max(gap1, 0.0)
    return Phase(tau, ending, ending == ROOT, gap, gap1, q, q1, used)


@terms.register(Dip)
@jit
def _dip_terms(p: Dip, tau: float) -> Terms:
    t = flight_terms(p.flight, tau)
    return Terms(
        -t.smooth, -t.smooth1, -t.smooth2, -t.smooth3, t.smooth4,
        -t.ring, -t.ring1, -t.ring2, -t.ring3, t.ring4, t.amplitude, t.noise,
    )  # fmt: skip


@terms.register(Recoil)
@jit
def _recoil_terms(p: Recoil, tau: float) -> Terms:
    f = p.flight
    t = flight_terms(f, tau)
    q, q1 = motion(f.osc, f.q, f.q1, tau)
    q2, q3, _ = derivatives(f.osc, q, q1)
    q4, _, _ = derivatives(f.osc, q2, q3)
    _, _, q5 = derivatives(f.osc, q1, q2)
    _, cos = turned(f.phi + tau)
    gap4 = -cos - 0.5 * q4
    k, c = p.kappa, p.beta
    return Terms(
        smooth=k * (t.smooth + t.ring) + c * (t.smooth1 + t.ring1),
        smooth1=k * (t.smooth1 + t.ring1) + c * (t.smooth2 + t.ring2),
        smooth2=k * (t.smooth2 + t.ring2) + c * (t.smooth3 + t.ring3),
        smooth3=k * (t.smooth3 + t.ring3) + c * gap4,
        smooth4=k * (t.smooth4 + t.ring4) + c * (1.0 + 0.5 * q5),
        ring=0.0,
        ring1=0.0,
        ring2=0.0,
        ring3=0.0,
        ring4=0.0,
        amplitude=math.inf,
        noise=k * t.noise + 4.0 * EPS * c * abs(t.smooth1 + t.ring1),
    )


@jit
def _least_pull(p: Flight, time: float) -> float:
    """A bound <= 0 below gap'' for the first `time` rad of a flight."""
    _, q3, q4 = derivatives(p.osc, p.q, p.q1)
    gap3 = -p.sin - 0.5 * q3
    return min(p.gap2 + time * (min(gap3, 0.0) - 0.5 * time * (1.0 + 0.5 * q4)), 0.0)


@jit
def _springs_clear(s: SoftSpring, p: Flight, least: float, time: float) -> bool:
    """Whether kappa gap + beta gap', zero at take-off, surely only grows for `time` rad."""
    return s.kappa * (p.gap1 + time * least) + s.beta * least > 0.0


@jit
def _clear_by(s: SoftSpring, p: Flight) -> float:
    """When a mass that takes off below the plate is surely clear of it, never pressed meanwhile; or 0."""
    if p.gap1 <= 0.0:
        return 0.0
    time = -2.0 * p.gap / p.gap1
    least = _least_pull(p, time)
    return time if 0.5 * least * time * time > p.gap and _springs_clear(s, p, least, time) else 0.0


@flight.register(SoftSpring)
@jit
def _flight(
    s: SoftSpring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    p = take_off(s.flight, s.gravity, phi, gap, gap1, q, q1)
    clear, used = 0.0, 0
    if gap < 0.0:
        clear = _clear_by(s, p)
    if gap < 0.0 and clear == 0.0:
        clear, ending, used = first_root(Dip(p), 0.0, horizon, budget)
        tau, pressed = clear, HORIZON
        if not _springs_clear(s, p, _least_pull(p, clear), clear):
            tau, pressed, more = first_root(Recoil(p, s.kappa, s.beta), 0.0, clear, budget - used)
            used += more
        if pressed != HORIZON or ending != ROOT:
            # the plate bears again before the mass is clear of it, or the window ends first
            gap, gap1, q, q1 = state_after(p, tau)
            ending = ending if pressed == HORIZON else pressed
            return Phase(tau, ending, ending != ROOT, gap, gap1, q, q1, used)
    tau, ending, more = landing(p, clear, horizon, budget - used)
    gap, gap1, q, q1 = state_after(p, tau)
    if ending == ROOT:
        gap, gap1 = 0.0, min(gap1, 0.0)
    return Phase(tau, ending, ending != ROOT, gap, gap1, q, q1, used + more)
