"""Energy and momentum of a cycle in closed form (docs/hysteresis.md).

Per cycle, in m A**2 omega**2. The plate works on the lower mass in contact, integral of n (-sin phi), and at
the impact, W sin phi for a relative velocity W < 0; the dashpot takes b times the integral of q'**2, and an
impact without restitution W**2/2. The gravity of two masses over 2 pi k rad is what the plate's forces give
back: integral of n + (-W) = 4 pi k/Gamma.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.branches.closed_form import TWO_PI, orbit
from kernel.branches.spring import Array, Spring, spring, stuck


class Energy(NamedTuple):
    """Of n cycles, in m A**2 omega**2 per cycle, momentum in m A omega; arrays (n,)."""

    plate_contact: NDArray[np.float64]  # work of the plate in contact
    plate_impact: NDArray[np.float64]  # work of the plate at the impact
    dashpot: NDArray[np.float64]  # what the dashpot takes
    impact: NDArray[np.float64]  # what the impact takes
    force: NDArray[np.float64]  # integral of n over the contact
    impulse: NDArray[np.float64]  # of the impact
    weight: NDArray[np.float64]  # 4 pi periods/Gamma


def energy(omega: float, xi: float, periods: int, flight_time: NDArray[np.float64]) -> Energy:
    """Of the cycles of one flight in `periods` plate periods whose flights take flight_time (n,) rad.

    In flight the dashpot takes what the relative motion loses: half the change of q'**2/2 + w q**2. In
    contact its integral of q'**2 is that of a free and a driven motion, each in closed form.
    """
    k = spring(omega, xi)
    w = k.stiffness
    t = flight_time
    x = orbit(k, periods, t)
    gamma = np.hypot(x.c, x.s)
    sin, cos = np.sin(t), np.cos(t)
    # landing: phase phi1 = phi0 + T, sine and cosine times Gamma
    c1, s1 = x.c * cos - x.s * sin, x.c * sin + x.s * cos
    before = x.v_land - x.impact  # v before the impact; q does not jump
    in_flight = 0.25 * (x.v0 * x.v0 - before * before) + 0.5 * w * (x.q0 * x.q0 - x.q_land * x.q_land)
    # in contact q'' + b q' + w q = Gamma cos(phi) - 1, lengths in g/omega**2
    span = TWO_PI * periods - t
    jump_q, jump_v = x.q0 - x.q_land, x.v0 - x.v_land
    drive = _cosine_of_velocity(k, x.q_land, x.v_land, c1, s1, span)
    stored = 0.5 * (x.v0 * x.v0 - x.v_land * x.v_land) + 0.5 * w * (x.q0 * x.q0 - x.q_land * x.q_land)
    in_contact = drive - stored - jump_q
    # n = 1 - Gamma cos(phi) - b q' - w q = 2 - 2 Gamma cos(phi) + q''. Against -Gamma sin(phi):
    # the integral of -2 sin and of 2 sin cos are of the ends; q'' (-sin) by parts is -q' sin + q' cos
    work = 2.0 * (x.c - c1) - (x.c * x.c - c1 * c1) - (x.v0 * x.s - x.v_land * s1) + drive
    force = 2.0 * span - 2.0 * (x.s - s1) + jump_v
    square = 1.0 / (gamma * gamma)
    return Energy(
        plate_contact=work * square,
        plate_impact=x.impact * s1 * square,
        dashpot=(in_flight + in_contact) * square,
        impact=0.5 * x.impact * x.impact * square,
        force=force / gamma,
        impulse=-x.impact / gamma,
        weight=2.0 * TWO_PI * periods / gamma,
    )


def _cosine_of_velocity(k: Spring, q: Array, v: Array, c: Array, s: Array, span: Array) -> Array:
    """Integral of q' Gamma cos(phi) over a contact that begins with q, v at Gamma e^{i phi} = c + i s."""
    b, w = k.dashpot, k.stiffness
    z = c + 1j * s
    response = k.q_re + 1j * k.q_im
    h = q + 1.0 / w - (response * z).real
    h1 = v - (1j * response * z).real
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
