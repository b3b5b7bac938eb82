"""The rigid spring with heyoka: adaptive Taylor integrators with terminal events, one for each phase.

On the plate the state is q, the elongation of the spring in plate amplitudes, and its rate; in flight also
the gap under the lower mass and its rate. `march` alternates between the phases. Equations and units are
those of `kernel.models.rigid`.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import heyoka as hy
import numpy as np

#: The landing is searched from this phase (rad) after take-off on: at take-off the gap has a multiple zero.
LIFT = 1e-3


class Coefficients(NamedTuple):
    """One cell, as the coefficients of its equations."""

    gravity: float
    dashpot: float
    stiffness: float

    @classmethod
    def of(cls, gamma: float, omega: float, xi: float) -> "Coefficients":
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


def march(spring: Coefficients, periods: int, stick: Stick, fly: Fly) -> list[float]:
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


def lifted(spring: Coefficients, t: float, q: float, v: float) -> tuple[float, float, float, float]:
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


class Spring:
    """The compiled integrators of both phases; a cell sets their parameters."""

    def __init__(self) -> None:
        q, v, gap, gap1 = hy.make_vars("q", "v", "gap", "gap1")
        gravity, dashpot, stiffness = hy.par[0], hy.par[1], hy.par[2]
        force = dashpot * v + stiffness * q
        normal = gravity - hy.cos(hy.time) - force
        falling = hy.event_direction.negative
        self._stuck = hy.taylor_adaptive(
            [(q, v), (v, hy.cos(hy.time) - gravity - force)],
            [0.0, 0.0],
            pars=[1.0, 1.0, 1.0],
            t_events=[hy.t_event(normal, direction=falling)],
        )
        self._flight = hy.taylor_adaptive(
            [(gap, gap1), (gap1, force - gravity + hy.cos(hy.time)), (q, v), (v, -2.0 * force)],
            [0.0, 0.0, 0.0, 0.0],
            pars=[1.0, 1.0, 1.0],
            t_events=[hy.t_event(gap, direction=falling)],
        )

    def run(self, gamma: float, omega: float, xi: float, periods: int) -> list[float]:
        """Flight times (rad) of a cell from rest."""
        spring = Coefficients.of(gamma, omega, xi)
        for integrator in (self._stuck, self._flight):
            integrator.pars[:] = spring

        def stick(t: float, q: float, v: float, end: float) -> tuple[float, float, float] | None:
            return self._until_event(self._stuck, t, [q, v], end)

        def fly(t: float, q: float, v: float, end: float) -> tuple[float, float, float, float] | None:
            landed = self._until_event(self._flight, t + LIFT, lifted(spring, t, q, v), end)
            return None if landed is None else (landed[0], *landed[2:])

        return march(spring, periods, stick, fly)

    @staticmethod
    def _until_event(integrator: Any, t: float, state: Sequence[float], end: float) -> Any:
        integrator.time = t
        integrator.state[:] = state
        integrator.reset_cooldowns()
        if integrator.propagate_until(end)[0] == hy.taylor_outcome.time_limit:
            return None
        return (integrator.time, *integrator.state)


class BatchSpring:
    """As many cells as a vector holds, in heyoka's batch mode: one integrator of both phases.

    A parameter of each cell tells flight (1) from contact (0), and selects the equations and the event. At
    events, Python changes the cell's state and that parameter.
    """

    def __init__(self) -> None:
        q, v, gap, gap1 = hy.make_vars("q", "v", "gap", "gap1")
        gravity, dashpot, stiffness, flying = hy.par[0], hy.par[1], hy.par[2], hy.par[3]
        force = dashpot * v + stiffness * q
        drive = hy.cos(hy.time) - gravity
        normal = -drive - force
        self.cells = hy.recommended_simd_size()
        event = hy.t_event_batch(
            flying * gap + (1.0 - flying) * normal,
            direction=hy.event_direction.negative, callback=self._at_event, cooldown=LIFT,
        )  # fmt: skip
        self._integrator = hy.taylor_adaptive_batch(
            [
                (gap, gap1),
                (gap1, flying * (force + drive)),
                (q, v),
                (v, (1.0 - flying) * (drive - force) - 2.0 * flying * force),
            ],
            np.zeros((4, self.cells)),
            pars=np.ones((4, self.cells)),
            t_events=[event],
        )
        self._springs: list[Coefficients] = []
        self._takeoffs: list[float | None] = []
        self._flights: list[list[float]] = []

    def run(self, gamma: Sequence[float], omega: float, xi: float, periods: int) -> list[list[float]]:
        """Flight times (rad) of `cells` cells from rest."""
        self._springs = [Coefficients.of(g, omega, xi) for g in gamma]
        integrator = self._integrator
        integrator.set_time(0.0)
        integrator.state[:] = 0.0
        for cell, spring in enumerate(self._springs):
            flying = 2.0 * spring.gravity - 1.0 < 0.0
            integrator.pars[:, cell] = (*spring, float(flying))
            integrator.state[2, cell] = -spring.gravity / spring.stiffness
        self._takeoffs = [0.0 if integrator.pars[3, cell] else None for cell in range(self.cells)]
        self._flights = [[] for _ in range(self.cells)]
        integrator.reset_cooldowns()
        integrator.propagate_until(2.0 * math.pi * periods)
        return self._flights

    def __deepcopy__(self, _: dict[int, Any]) -> "BatchSpring":
        """heyoka copies its callbacks; this one's records are here."""
        return self

    def _at_event(self, integrator: Any, _: int, cell: int) -> bool:
        """Take-off or landing of a cell."""
        time, state, pars = integrator.time[cell], integrator.state, integrator.pars
        gap1, q, v = state[1:, cell]
        if pars[3, cell]:
            takeoff = self._takeoffs[cell]
            self._flights[cell].append(time - takeoff)
            v += gap1
            state[3, cell] = v
        state[:2, cell] = 0.0
        flies = not pars[3, cell] or self._springs[cell].normal(time, q, v) < 0.0
        pars[3, cell] = float(flies)
        self._takeoffs[cell] = time if flies else None
        return True
