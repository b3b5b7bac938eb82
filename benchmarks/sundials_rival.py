"""The rigid spring with SUNDIALS' CVODE and root finding, through scikit-sundae; Adams' method."""

import math
from typing import Any

from sksundae.cvode import CVODE

from benchmarks import phases
from benchmarks.phases import LIFT, lifted, march

_STEPS = 100_000
_EVENT = 2  # CVODE's status at a root


class Spring:
    """The solvers of both phases; a cell sets their parameters."""

    def __init__(self, rtol: float) -> None:
        self._cell = phases.Spring.of(1.0, 1.0, 1.0)

        def stuck(t: float, y: Any, slope: Any) -> None:
            slope[0] = y[1]
            slope[1] = math.cos(t) - self._cell.gravity - self._cell.force(y[0], y[1])

        def normal(t: float, y: Any, events: Any) -> None:
            events[0] = self._cell.normal(t, y[0], y[1])

        def flight(t: float, y: Any, slope: Any) -> None:
            force = self._cell.force(y[2], y[3])
            slope[0] = y[1]
            slope[1] = force - self._cell.gravity + math.cos(t)
            slope[2] = y[3]
            slope[3] = -2.0 * force

        def gap(t: float, y: Any, events: Any) -> None:
            events[0] = y[0]

        self._stuck, self._flight = (_solver(*pair, rtol) for pair in ((stuck, normal), (flight, gap)))

    def run(self, gamma: float, omega: float, xi: float, periods: int) -> list[float]:
        """Flight times (rad) of a cell from rest."""
        spring = self._cell = phases.Spring.of(gamma, omega, xi)

        def stick(t: float, q: float, v: float, end: float) -> tuple[float, float, float] | None:
            return _until_event(self._stuck, t, [q, v], end)

        def fly(t: float, q: float, v: float, end: float) -> tuple[float, float, float, float] | None:
            landed = _until_event(self._flight, t + LIFT, lifted(spring, t, q, v), end)
            return None if landed is None else (landed[0], *landed[2:])

        return march(spring, periods, stick, fly)


def _solver(slope: Any, event: Any, rtol: float) -> CVODE:
    event.terminal, event.direction = [True], [-1]
    return CVODE(
        slope, method="Adams", rtol=rtol, atol=1e-3 * rtol, eventsfn=event, num_events=1, max_num_steps=_STEPS
    )


def _until_event(solver: CVODE, t: float, state: Any, end: float) -> Any:
    """(t, *state) at the event, or None if `end` comes first."""
    answer = solver.solve([t, end], state)
    return (float(answer.t[-1]), *answer.y[-1]) if answer.status == _EVENT else None
