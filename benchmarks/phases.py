"""The rigid spring with a general solver, as a script would compute it: one solve per contact or flight.

On the plate the state is q, the elongation of the spring in plate amplitudes, and its rate; in flight also
the gap under the lower mass and its rate. The solver integrates each phase; `march` alternates between them.
Equations and units are those of `kernel.models.rigid`.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

#: The landing is searched from this phase (rad) after take-off on: at take-off the gap has a multiple zero.
LIFT = 1e-3


class Spring(NamedTuple):
    """One cell, as the coefficients of its equations."""

    gravity: float
    dashpot: float
    stiffness: float

    @classmethod
    def of(cls, gamma: float, omega: float, xi: float) -> "Spring":
        """The coefficients at this (Gamma, Omega, xi)."""
        return cls(1.0 / gamma, 2.0 * xi / omega, 1.0 / omega**2)

    def force(self, q: float, v: float) -> float:
        """Force of spring and dashpot, in units of the plate's acceleration."""
        return self.dashpot * v + self.stiffness * q

    def normal(self, t: float, q: float, v: float) -> float:
        """The normal force; the mass takes off where it falls through zero."""
        return self.gravity - math.cos(t) - self.force(q, v)


#: (t, q, q', end) -> (t, q, q') at take-off, or None if `end` comes first.
Stick = Callable[[float, float, float, float], tuple[float, float, float] | None]
#: (t, q, q', end) -> (t, gap', q, q') at landing, or None if `end` comes first.
Fly = Callable[[float, float, float, float], tuple[float, float, float, float] | None]


def march(spring: Spring, periods: int, stick: Stick, fly: Fly) -> list[float]:
    """Flight times (rad) of a cell from rest, over `periods` plate periods."""
    q, v, t, end = -spring.gravity / spring.stiffness, 0.0, 0.0, 2.0 * math.pi * periods
    flying = 2.0 * spring.gravity - 1.0 < 0.0
    flights: list[float] = []
    while t + LIFT < end:
        if not flying:
            taken_off = stick(t, q, v, end)
            if taken_off is None:
                break
            (t, q, v), flying = taken_off, True
            continue
        landed = fly(t, q, v, end)
        if landed is None:
            break
        flights.append(landed[0] - t)
        t, impact, q, v = landed
        v += impact
        flying = spring.normal(t, q, v) < 0.0
    return flights


def lifted(spring: Spring, t: float, q: float, v: float) -> tuple[float, float, float, float]:
    """gap, gap', q and q' LIFT rad after a take-off, by Taylor's series to the fifth order."""
    sin, cos = math.sin(t), math.cos(t)
    q2 = -2.0 * spring.force(q, v)
    q3 = -2.0 * spring.force(v, q2)
    q4 = -2.0 * spring.force(q2, q3)
    q5 = -2.0 * spring.force(q3, q4)
    g2, g3, g4, g5 = cos - spring.gravity - q2 / 2, -sin - q3 / 2, -cos - q4 / 2, sin - q5 / 2
    h = LIFT
    return (
        h * h * (g2 / 2 + h * (g3 / 6 + h * (g4 / 24 + h * g5 / 120))),
        h * (g2 + h * (g3 / 2 + h * (g4 / 6 + h * g5 / 24))),
        q + h * (v + h * (q2 / 2 + h * (q3 / 6 + h * (q4 / 24 + h * q5 / 120)))),
        v + h * (q2 + h * (q3 / 2 + h * (q4 / 6 + h * q5 / 24))),
    )
