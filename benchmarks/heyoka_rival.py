"""The rigid spring by heyoka: adaptive Taylor integration with terminal events, one integrator a phase."""

import math

import heyoka as hy


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
        flights = []
        while True:
            integrator = self.flight if flying else self.stuck
            started, integrator.time = t, t
            integrator.state[:] = [0.0, 0.0, q, v] if flying else [q, v]
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
