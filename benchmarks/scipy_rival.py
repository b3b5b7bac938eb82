"""The rigid spring as a script over scipy would do it: solve_ivp with terminal events, a phase at a time."""

import math
from typing import Any

from scipy.integrate import solve_ivp

#: A phase is looked at from a moment after its start, where its event is not the one that began it.
LIFT = 1e-3


def run(
    gamma: float, omega: float, xi: float, periods: int, method: str = "DOP853", rtol: float = 1e-9
) -> list[float]:
    """Flight times (rad) of a cell from rest; absolute tolerance a thousandth of the relative one."""
    gravity, dashpot, stiffness = 1.0 / gamma, 2.0 * xi / omega, 1.0 / omega**2

    def stuck(t: float, y: Any) -> list[float]:
        return [y[1], math.cos(t) - gravity - dashpot * y[1] - stiffness * y[0]]

    def normal(t: float, y: Any) -> float:
        return gravity - math.cos(t) - dashpot * y[1] - stiffness * y[0]

    def flight(t: float, y: Any) -> list[float]:
        force = dashpot * y[3] + stiffness * y[2]
        return [y[1], force - gravity + math.cos(t), y[3], -2.0 * force]

    def gap(t: float, y: Any) -> float:
        return float(y[0])

    for event in (normal, gap):
        event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
    q, v, t, end = -(omega**2) / gamma, 0.0, 0.0, 2.0 * math.pi * periods
    flying, flights = 2.0 * gravity - 1.0 < 0.0, []
    options = {"method": method, "rtol": rtol, "atol": 1e-3 * rtol}
    while t < end:
        if not flying:
            answer = solve_ivp(stuck, (t, end), [q, v], events=normal, **options)
            (q, v), t, flying = answer.y[:, -1], float(answer.t[-1]), True
            continue
        lifted = solve_ivp(flight, (t, t + LIFT), [0.0, 0.0, q, v], **options)
        answer = solve_ivp(flight, (t + LIFT, end), lifted.y[:, -1], events=gap, **options)
        _, impact, q, v = answer.y[:, -1]
        if len(answer.t_events[0]):
            flights.append(float(answer.t[-1]) - t)
        t, v = float(answer.t[-1]), v + impact
        flying = gravity - math.cos(t) - dashpot * v - stiffness * q < 0.0
    return flights
