"""States on the cycles of a (1,k) branch, from which a simulation starts.

The state is exact for an ideal plate with restitution 0. Other contacts start from the same elongation, gap
and velocities, beside a cycle of their own.
"""

from typing import NamedTuple

import numpy as np

from kernel.cycles.closed_form import TWO_PI, orbit
from kernel.cycles.events import Branch, branch, check_spring, flight_times, rows_of
from kernel.cycles.roots import Floats, Ints, roots
from kernel.cycles.spring import STEP, Spring, flight, spring, stuck
from kernel.params import STATE_FIELDS, Cell, KernelInputError, Start


class CycleStart(NamedTuple):
    """A start on a cycle, and that cycle as a branch of one point."""

    start: Start
    cycle: Branch


class GammaRange(NamedTuple):
    """A range of Gamma in which a branch has a stable admissible cycle."""

    low: float
    high: float


def cycles_at(cell: Cell, periods: int) -> Branch:
    """The cycles (1, periods) of the closed form at a cell, by flight time. Raises KernelInputError."""
    gamma, omega, xi = cell
    if not (np.isfinite(gamma) and gamma > 0.0):
        raise KernelInputError("gamma", f"must be > 0 and finite, got {gamma}")
    check_spring(omega, xi, periods)
    k = spring(omega, xi)

    def above(_: Ints, t: Floats) -> tuple[Floats, Floats]:
        x = orbit(k, periods, t + 1j * STEP)
        amplitude = np.sqrt(x.c * x.c + x.s * x.s)
        return amplitude.real - gamma, amplitude.imag / STEP

    t = flight_times(omega, xi, periods)
    with np.errstate(all="ignore"):  # poles of Gamma(T)
        value, slope = above(np.empty(0, np.intp), t)
        times = roots(above, t, value[None], slope[None]).x
    return branch(omega, xi, periods, times)


def start_on_stable_cycle(cell: Cell, periods: int) -> CycleStart | None:
    """A start on the stable admissible cycle (1, periods) of a cell; None if there is none.

    Of several, the one with the longest flight. Raises KernelInputError.
    """
    line = cycles_at(cell, periods)
    holds = np.flatnonzero(line.stable & (line.violations == 0))
    return _start(cell, line, int(holds[-1])) if len(holds) else None


def start_on_cycle(cell: Cell, periods: int, flight_time: float) -> CycleStart | None:
    """A start on the cycle (1, periods) of a cell whose flight takes nearest to `flight_time`, rad.

    The cycle may be unstable or not admissible. None if the cell has no cycle. Raises KernelInputError.
    """
    line = cycles_at(cell, periods)
    if not len(line.flight_time):
        return None
    return _start(cell, line, int(np.argmin(np.abs(line.flight_time - flight_time))))


def stable_ranges(omega: float, xi: float, periods: int) -> list[GammaRange]:
    """Where along Gamma the branch (1, periods) has a stable admissible cycle, to the resolution of its grid.

    Raises KernelInputError.
    """
    with np.errstate(all="ignore"):
        line = branch(omega, xi, periods, flight_times(omega, xi, periods))
    lives = np.concatenate([[False], line.stable & (line.violations == 0), [False]])
    edges = np.flatnonzero(np.diff(lives)).reshape(-1, 2)
    return [
        GammaRange(float(line.gamma[low:high].min()), float(line.gamma[low:high].max()))
        for low, high in edges
    ]


def _start(cell: Cell, line: Branch, i: int) -> CycleStart:
    """The start on cycle i of a branch."""
    return CycleStart(Start(_state(line, i), cell), rows_of(line, slice(i, i + 1)))


def _state(line: Branch, i: int) -> Floats:
    """The state (6,) of cycle i of a branch at phase 0, in the order of STATE_FIELDS."""
    k = spring(line.omega[i], line.xi[i])
    t = line.flight_time[i : i + 1]
    tau = TWO_PI - line.takeoff_phase[i : i + 1]
    state = _in_flight(k, line.periods, t, tau) if tau[0] < t[0] else _in_contact(k, line.periods, t, tau)
    phase, flies, *lengths = np.concatenate([[0.0, float(tau[0] < t[0])], state])
    return np.array([phase, flies, *(np.array(lengths) / line.gamma[i])]).reshape(len(STATE_FIELDS))


def _in_flight(k: Spring, periods: int, t: Floats, tau: Floats) -> Floats:
    """(gap, gap', q, q') tau rad after take-off, in units of g/omega**2."""
    x, fly = orbit(k, periods, t), flight(k, tau)
    gap = x.c * fly.cos_rest - x.s * fly.sin_rest + (1.0 - x.c) * fly.s_int_rest
    gap = gap + k.stiffness * x.v0 * fly.s_int2
    gap1 = (1.0 - x.c) * fly.s_rest - x.c * fly.sin_rest - x.s * fly.versine
    gap1 = gap1 + k.stiffness * x.v0 * fly.s_int
    f = fly.free
    return np.concatenate([gap, gap1, x.q0 * f.c + x.v0 * f.s, x.q0 * f.c1 + x.v0 * f.s1])


def _in_contact(k: Spring, periods: int, t: Floats, tau: Floats) -> Floats:
    """(0, 0, q, q') tau rad after take-off, at phase 0, in units of g/omega**2."""
    x = orbit(k, periods, t)
    size = np.hypot(x.c, x.s)
    cos, sin = np.cos(t), np.sin(t)
    c1, s1 = x.c * cos - x.s * sin, x.c * sin + x.s * cos  # Gamma e^{i phi} at landing
    h = x.q_land + 1.0 / k.stiffness - (k.q_re * c1 - k.q_im * s1)
    h1 = x.v_land + (k.q_re * s1 + k.q_im * c1)
    f = stuck(k, tau - t)
    q = h * f.c + h1 * f.s - 1.0 / k.stiffness + k.q_re * size
    q1 = h * f.c1 + h1 * f.s1 - k.q_im * size
    return np.concatenate([0.0 * q, 0.0 * q, q, q1])
