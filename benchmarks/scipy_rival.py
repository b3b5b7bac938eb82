"""The rigid spring with scipy's solve_ivp and terminal events."""

import math
from typing import Any

from scipy.integrate import solve_ivp

from benchmarks.phases import LIFT, Spring, lifted, march


def run(
    gamma: float, omega: float, xi: float, periods: int, method: str = "DOP853", rtol: float = 1e-9
) -> list[float]:
    """Flight times (rad) of a cell from rest; absolute tolerance a thousandth of the relative one."""
    spring = Spring.of(gamma, omega, xi)
    options = {"method": method, "rtol": rtol, "atol": 1e-3 * rtol}

    def stuck(t: float, y: Any) -> list[float]:
        return [y[1], math.cos(t) - spring.gravity - spring.force(y[0], y[1])]

    def normal(t: float, y: Any) -> float:
        return spring.normal(t, y[0], y[1])

    def flight(t: float, y: Any) -> list[float]:
        force = spring.force(y[2], y[3])
        return [y[1], force - spring.gravity + math.cos(t), y[3], -2.0 * force]

    def gap(t: float, y: Any) -> float:
        return float(y[0])

    for event in (normal, gap):
        event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]

    def stick(t: float, q: float, v: float, end: float) -> tuple[float, float, float] | None:
        answer = solve_ivp(stuck, (t, end), [q, v], events=normal, **options)
        return (float(answer.t[-1]), *answer.y[:, -1]) if len(answer.t_events[0]) else None

    def fly(t: float, q: float, v: float, end: float) -> tuple[float, float, float, float] | None:
        answer = solve_ivp(flight, (t + LIFT, end), lifted(spring, t, q, v), events=gap, **options)
        return (float(answer.t[-1]), *answer.y[1:, -1]) if len(answer.t_events[0]) else None

    return march(spring, periods, stick, fly)
