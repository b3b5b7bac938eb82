"""Slow, obvious twins of the kernel, written from the equations of motion alone.

A spring of two masses over the plate cos(phi), in plate amplitudes and radians of phase, with
g the gap under the lower mass, q the elongation, w = 1/Omega**2 and b = 2 xi/Omega:

    q'' = -2 b q' - 2 w q - n          g'' = b q' + w q - 1/Gamma + cos(phi) + n

n is 0 in flight; on the ideal plate it is what keeps g'' = 0; on the soft one -(kappa g + beta g').
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from scipy.integrate import solve_ivp
from scipy.optimize import brentq

#: A hop slower than this sticks, and a flight shorter than this is none.
SLOWEST_HOP = 1e-9
SHORTEST_FLIGHT = 1e-9

State = tuple[float, float, float, float]  # g, g', q, q'


class Setting(NamedTuple):
    """A cell and its contact; `soft` chooses between the two plates."""

    gamma: float
    omega: float
    xi: float
    soft: bool = False
    restitution: float = 0.0
    penetration: float = 1e-3
    adhesive: bool = True

    @property
    def w(self) -> float:
        return 1.0 / self.omega**2

    @property
    def b(self) -> float:
        return 2.0 * self.xi / self.omega

    @property
    def kappa(self) -> float:
        return 1.0 / self.penetration**2

    @property
    def beta(self) -> float:
        return 2.0 * damping_for(self.restitution, self.adhesive) / self.penetration if self.soft else 0.0

    def at_rest(self) -> State:
        return (
            (-2.0 / (self.gamma * self.kappa) if self.soft else 0.0),
            0.0,
            -1.0 / (self.gamma * self.w),
            0.0,
        )

    def stuck_force(self, phi: float, q: float, q1: float) -> float:
        return 1.0 / self.gamma - math.cos(phi) - self.b * q1 - self.w * q

    def push(self, gap: float, gap1: float) -> float:
        return -(self.kappa * gap + self.beta * gap1)


# --- an isolated impact ---------------------------------------------------------------------


def bounce(zeta: float, adhesive: bool) -> float:
    """Restitution of g'' + 2 zeta g' + g = 0 from g = 0, g' = -1, integrated."""

    def leaves(_: float, y: Sequence[float]) -> float:
        return y[0] if adhesive else y[0] + 2.0 * zeta * y[1]

    leaves.terminal, leaves.direction = True, 1  # type: ignore[attr-defined]
    path = solve_ivp(
        lambda _, y: (y[1], -y[0] - 2.0 * zeta * y[1]), (0.0, 200.0 * (1.0 + zeta)), (0.0, -1.0),
        "DOP853", events=leaves, rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    return float(path.y_events[0][0][1]) if len(path.y_events[0]) else 0.0


def restitution_of(zeta: float, adhesive: bool) -> float:
    """docs/model.md, section 2, as printed there."""
    if adhesive:
        return math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)) if zeta < 1.0 else 0.0
    if zeta == 1.0:
        return math.exp(-2.0)
    s = math.sqrt(abs(zeta**2 - 1.0))
    if zeta < 1.0:
        return math.exp(-zeta / s * math.atan2(2.0 * zeta * s, 2.0 * zeta**2 - 1.0))
    # (zeta + s)/(zeta - s) without its cancellation
    return float((zeta + s) ** 2) ** (-zeta / s)


def damping_for(e: float, adhesive: bool) -> float:
    """The damping ratio that gives restitution e."""
    if e == 1.0:
        return 0.0
    if adhesive:
        return 1.0 if e == 0.0 else -math.log(e) / math.sqrt(math.pi**2 + math.log(e) ** 2)
    return float(brentq(lambda z: restitution_of(z, False) - e, 0.0, 1.0 / math.sqrt(e) + 2.0, xtol=1e-15))


# --- whole trajectories, integrated ---------------------------------------------------------


class Flown(NamedTuple):
    takeoff: float  # phase since the start, rad
    time: float


def trajectory(s: Setting, periods: float) -> list[Flown]:
    """Every flight from rest that takes off and lands within some plate periods, by DOP853."""
    phi, end = 0.0, 2.0 * math.pi * periods
    state, flying = s.at_rest(), not s.soft and s.gamma > 2.0
    flown = []
    while True:
        phi_before, was_flying = phi, flying
        phi, state, ended = _integrate(s, phi, state, flying, end)
        if not ended:
            return flown
        if was_flying and phi - phi_before > SHORTEST_FLIGHT:
            flown.append(Flown(phi_before, phi - phi_before))
        state, flying = _after(s, phi, state, was_flying)


def _after(s: Setting, phi: float, state: State, was_flying: bool) -> tuple[State, bool]:
    """What a take-off or a landing does to a state, and whether a flight follows."""
    gap, gap1, q, q1 = state
    if s.soft:
        return (0.0 if s.adhesive else gap, gap1, q, q1), not was_flying
    if not was_flying:
        return (0.0, 0.0, q, q1), True
    hop = -s.restitution * gap1
    hop = 0.0 if hop < SLOWEST_HOP else hop
    q1 += gap1 - hop
    return (0.0, hop, q, q1), hop > 0.0 or s.stuck_force(phi, q, q1) < 0.0


def _integrate(s: Setting, phi: float, state: State, flying: bool, end: float) -> tuple[float, State, bool]:
    """One phase to its end: (phase, state, whether it ended before `end`)."""

    def force(phi: float, y: Sequence[float]) -> float:
        if flying:
            return 0.0
        return s.push(y[0], y[1]) if s.soft else s.stuck_force(phi, y[2], y[3])

    def slopes(phi: float, y: Sequence[float]) -> tuple[float, float, float, float]:
        n, spring = force(phi, y), s.b * y[3] + s.w * y[2]
        return y[1], spring - 1.0 / s.gamma + math.cos(phi) + n, y[3], -2.0 * spring - n

    def lasts(phi: float, y: Sequence[float]) -> float:
        """Positive as long as the phase lasts."""
        if flying:
            return max(y[0], -s.push(y[0], y[1])) if s.soft and not s.adhesive else y[0]
        if s.soft and s.adhesive:
            return -y[0]
        return force(phi, y)

    lasts.terminal, lasts.direction = True, -1  # type: ignore[attr-defined]
    widest = min(0.05, 0.1 * s.omega, 0.3 * s.penetration if s.soft and not flying else 1.0)
    path = solve_ivp(
        slopes, (phi, end), state, "DOP853", events=lasts, rtol=1e-12, atol=1e-18, max_step=widest
    )
    ended = len(path.t_events[0]) > 0
    last = path.y_events[0][0] if ended else path.y[:, -1]
    return float(path.t_events[0][0]) if ended else end, tuple(map(float, last)), ended  # type: ignore[return-value]


# --- modes ----------------------------------------------------------------------------------


def cycle(times: Sequence[float], takeoffs: Sequence[float], tolerance: float = 1e-6) -> tuple[int, int]:
    """(bounces, plate periods) of the shortest cycle over the last half, seen three times; or (0, 0).

    `takeoffs` are phases since the start, not modulo anything.
    """
    n = len(times)
    for bounces in range(1, n // 3 + 1):
        checked = range(n - max(n // 2, 2 * bounces), n)
        turns = {round((takeoffs[i] - takeoffs[i - bounces]) / (2.0 * math.pi)) for i in checked}
        periods = min(turns)
        if len(turns) == 1 and periods >= 1 and all(
            abs(times[i] - times[i - bounces]) <= tolerance
            and abs(takeoffs[i] - takeoffs[i - bounces] - 2.0 * math.pi * periods) <= tolerance
            for i in checked
        ):  # fmt: skip
            return bounces, periods
    return 0, 0
