"""The rigid spring with heyoka: adaptive Taylor integrators with terminal events, one for each phase."""

from collections.abc import Sequence
from typing import Any

import heyoka as hy

from benchmarks import phases
from benchmarks.phases import LIFT, lifted, march


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
        spring = phases.Spring.of(gamma, omega, xi)
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
