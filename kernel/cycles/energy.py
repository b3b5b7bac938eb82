"""Energy and momentum of a cycle in closed form (docs/hysteresis.md).

Energies are per cycle, in m A**2 omega**2. The plate does work on the lower mass in contact, the integral of
n (-sin phi), and at the impact, W sin phi for a relative velocity W < 0. The dashpot takes b times the
integral of q'**2, an impact without restitution W**2/2. The plate's forces balance the gravity of two masses
over 2 pi k rad: integral of n + (-W) = 4 pi k/Gamma.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cycles.closed_form import TWO_PI, orbit
from kernel.cycles.spring import Array, Spring, spring, stuck

if TYPE_CHECKING:
    from kernel.cycles.cycles import Point


class Energy(NamedTuple):
    """Balance of n cycles: energies per cycle in m A**2 omega**2, momenta in m A omega; arrays (n,)."""

    plate_contact: NDArray[np.float64]  # work of the plate in contact
    plate_impact: NDArray[np.float64]  # work of the plate at the impact
    dashpot: NDArray[np.float64]  # energy that the dashpot takes
    impact: NDArray[np.float64]  # energy that the impact takes
    force: NDArray[np.float64]  # integral of n over the contact
    impulse: NDArray[np.float64]  # of the impact
    weight: NDArray[np.float64]  # 4 pi periods/Gamma


def energy(omega: float, xi: float, periods: int, flight_time: NDArray[np.float64]) -> Energy:
    """Balance of the cycles of one flight in `periods` plate periods; flight_time (n,) rad.

    In flight the dashpot takes the loss of the relative motion, half the change of q'**2/2 + w q**2. In
    contact its integral of q'**2 has a free and a driven part, each in closed form.
    """
    k = spring(omega, xi)
    x = orbit(k, periods, flight_time)
    sin, cos = np.sin(flight_time), np.cos(flight_time)
    takeoff = _At(x.q0, x.v0, x.c, x.s)
    landing = _At(x.q_land, x.v_land, x.c * cos - x.s * sin, x.c * sin + x.s * cos)
    span = TWO_PI * periods - flight_time
    parts = [_contact(k, landing, takeoff, span), _flight(k, takeoff, landing, x.impact)]
    return _total(parts, np.hypot(x.c, x.s), periods)


def cycle_energy(point: "Point") -> Energy:
    """Balance of one cycle of any number of flights on an ideal plate without restitution."""
    _, omega, xi = point.cell
    k = spring(omega, xi)
    states = [_At(*np.reshape(row[2:6], (4, 1))) for row in point.round.starts]
    parts = []
    for i, (letter, span) in enumerate(zip(point.letters, point.times, strict=True)):
        if letter == "S":
            parts.append(_contact(k, states[i], states[i + 1], np.array([span])))
        else:
            parts.append(_flight(k, states[i], states[i + 1], point.round.rates[i : i + 1]))
    return _total(parts, np.array([point.parameter]), point.cycles.periods)


class _At(NamedTuple):
    """q, v and Gamma e^{i phi} = c + i s at a take-off or after a landing, in units of g/omega**2."""

    q: Array
    v: Array
    c: Array
    s: Array


def _contact(k: Spring, begin: _At, end: _At, span: Array) -> Energy:
    """Balance of one contact, where q'' + b q' + w q = Gamma cos(phi) - 1; lengths in g/omega**2."""
    drive = _cosine_of_velocity(k, begin, span)
    stored = 0.5 * (end.v * end.v - begin.v * begin.v)
    stored = stored + 0.5 * k.stiffness * (end.q * end.q - begin.q * begin.q)
    # n = 1 - Gamma cos(phi) - b q' - w q = 2 - 2 Gamma cos(phi) + q''. Integrated times -Gamma sin(phi):
    # -2 sin and 2 sin cos depend on the ends alone; q'' (-sin) by parts gives -q' sin + q' cos
    work = 2.0 * (end.c - begin.c) - (end.c * end.c - begin.c * begin.c)
    work = work - (end.v * end.s - begin.v * begin.s) + drive
    force = 2.0 * span - 2.0 * (end.s - begin.s) + end.v - begin.v
    zero = np.zeros_like(span)
    return Energy(work, zero, drive - stored - (end.q - begin.q), zero, force, zero, zero)


def _flight(k: Spring, begin: _At, end: _At, impact: Array) -> Energy:
    """Balance of one flight and its landing; lengths in g/omega**2."""
    before = end.v - impact  # v before the impact; q does not jump
    lost = 0.25 * (begin.v * begin.v - before * before)
    lost = lost + 0.5 * k.stiffness * (begin.q * begin.q - end.q * end.q)
    zero = np.zeros_like(impact)
    return Energy(zero, impact * end.s, lost, 0.5 * impact * impact, zero, -impact, zero)


def _total(parts: list[Energy], gamma: Array, periods: int) -> Energy:
    """Sum of the balances of contacts and flights, in m A**2 omega**2 and m A omega."""
    e = Energy(*(np.sum(x, axis=0) for x in zip(*parts, strict=True)))
    square = 1.0 / (gamma * gamma)
    return Energy(
        e.plate_contact * square, e.plate_impact * square, e.dashpot * square, e.impact * square,
        e.force / gamma, e.impulse / gamma, 2.0 * TWO_PI * periods / gamma,
    )  # fmt: skip


def _cosine_of_velocity(k: Spring, begin: _At, span: Array) -> Array:
    """Integral of q' Gamma cos(phi) over a contact."""
    b, w = k.dashpot, k.stiffness
    z = begin.c + 1j * begin.s
    response = k.q_re + 1j * k.q_im
    h = begin.q + 1.0 / w - (response * z).real
    h1 = begin.v - (1j * response * z).real
    f = stuck(k, span)
    turn = np.exp(1j * span)
    end, end1 = h * f.c + h1 * f.s, h * f.c1 + h1 * f.s1
    # of h'' + b h' + w h = 0 times e^{it}, by parts: I0 = integral of h e^{it}, then that of h' e^{it}
    whole, whole1 = end * turn - h, end1 * turn - h1
    integral = -(whole1 + (b - 1j) * whole) / (w - 1.0 - 1j * b)
    free_part = ((whole - 1j * integral) * z).real
    # driven: q' = Re(i Q z e^{it}), against Re(z e^{it})
    driven = -0.5 * k.q_im * np.abs(z) ** 2 * span
    driven = driven + 0.5 * (1j * response * z * z * (turn * turn - 1.0) / 2j).real
    return np.asarray(free_part + driven)
