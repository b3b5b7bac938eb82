"""The rigid spring by heyoka: adaptive Taylor integration with terminal events, one integrator a phase."""

import math

import heyoka as hy

#: How long after a take-off heyoka begins, rad.
LIFT = 1e-3


class Spring:
    """Both phases compiled once; a cell only sets the parameters."""

    def __init__(self) -> None:
        q, v, gap, gap1 = hy.make_vars("q", "v", "gap", "gap1")
        gravity, dashpot, stiffness = hy.par[0], hy.par[1], hy.par[2]
        force = dashpot * v + stiffness * q
        normal = gravity - hy.cos(hy.time) - force
        falling = hy.event_direction.negative
        self.stuck = hy.taylor_adaptive(
            [(q, v), (v, hy.cos(hy.time) - gravity - force)],
            [0.0, 0.0],
            pars=[1.0, 1.0, 1.0],
            t_events=[hy.t_event(normal, direction=falling)],
        )
        self.flight = hy.taylor_adaptive(
            [(gap, gap1), (gap1, force - gravity + hy.cos(hy.time)), (q, v), (v, -2.0 * force)],
            [0.0, 0.0, 0.0, 0.0],
            pars=[1.0, 1.0, 1.0],
            t_events=[hy.t_event(gap, direction=falling)],
        )

    def run(self, gamma: float, omega: float, xi: float, periods: int) -> list[float]:
        """Flight times (rad) of a cell from rest."""
        gravity, dashpot, stiffness = 1.0 / gamma, 2.0 * xi / omega, 1.0 / omega**2
        for integrator in (self.stuck, self.flight):
            integrator.pars[:] = [gravity, dashpot, stiffness]
        q, v, t, end = -(omega**2) / gamma, 0.0, 0.0, 2.0 * math.pi * periods
        flying = 2.0 * gravity - 1.0 < 0.0
        gap = gap1 = 0.0
        flights = []
        while True:
            integrator = self.flight if flying else self.stuck
            started = t
            if flying:
                q, v, gap, gap1 = self._lift(t, q, v, gravity, dashpot, stiffness)
                t += LIFT
            integrator.time = t
            integrator.state[:] = [gap, gap1, q, v] if flying else [q, v]
            integrator.reset_cooldowns()
            outcome = integrator.propagate_until(end)[0]
            if outcome == hy.taylor_outcome.time_limit:
                return flights
            t = integrator.time
            if flying:
                _, impact, q, v = integrator.state
                flights.append(t - started)
                v += impact
                flying = gravity - math.cos(t) - dashpot * v - stiffness * q < 0.0
            else:
                q, v = integrator.state
                flying = True

    @staticmethod
    def _lift(
        t: float, q: float, v: float, gravity: float, dashpot: float, stiffness: float
    ) -> tuple[float, float, float, float]:
        """q, q', gap and gap' a moment after a take-off, by Taylor's series.

        At the take-off itself the gap has a double or triple zero, past which heyoka misses the landing.
        """
        sin, cos = math.sin(t), math.cos(t)
        q2 = -2.0 * (dashpot * v + stiffness * q)
        q3 = -2.0 * (dashpot * q2 + stiffness * v)
        q4 = -2.0 * (dashpot * q3 + stiffness * q2)
        q5 = -2.0 * (dashpot * q4 + stiffness * q3)
        g2, g3, g4, g5 = cos - gravity - q2 / 2, -sin - q3 / 2, -cos - q4 / 2, sin - q5 / 2
        h = LIFT
        return (
            q + h * (v + h * (q2 / 2 + h * (q3 / 6 + h * (q4 / 24 + h * q5 / 120)))),
            v + h * (q2 + h * (q3 / 2 + h * (q4 / 6 + h * q5 / 24))),
            h * h * (g2 / 2 + h * (g3 / 6 + h * (g4 / 24 + h * g5 / 120))),
            h * (g2 + h * (g3 / 2 + h * (g4 / 6 + h * g5 / 24))),
        )
