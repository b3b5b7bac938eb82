"""Cycles of any contact: Newton's method, multipliers, the kernel as judge, and cycles read from a state."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cycles.roots import Floats
from kernel.cycles.segments import ALONG, START, Round, monodromy, newton, simulated
from kernel.numerics.elementary import TWO_PI
from kernel.params import Cell
from kernel.stopping import check

#: Limit on Newton steps, and the relative size of the last.
_NEWTON: Final = 14
_CONVERGED: Final = 1e-12
#: Newton's method keeps c + i s on a line. Repeated this often along the new phase, it keeps Gamma.
_SAME_GAMMA: Final = 5

#: Limit on recounts of the hops of one solution.
_RECOUNTS: Final = 8
#: Durations of the kernel and of a cycle agree within this, rad,
AGREE: Final = 3e-6
#: and states after a round within this, plate amplitudes.
_CLOSES: Final = 1e-6
#: Rounding may hide a landing slower than this gap' (g/omega), or a take-off to a shorter flight, rad.
_SOFT_LANDING: Final = 1e-5
_SHORT_FLIGHT: Final = 1e-2
#: A contact shorter than this, rad, is rounding.
_AT_ONCE: Final = 1e-12
#: The cycle through a state is one of the cell if it is within this in Gamma, relative.
_SAME_CELL: Final = 1e-8
#: Rounds simulated to read a cycle: up to two before it begins, its own, and a segment of the next.
_ROUNDS: Final = 4.2
#: Limits on the segments of a cycle, and on the kernel's phases in a plate period.
_LONGEST: Final = 300
MOST: Final = 4000

#: Letters of flights that end with a landing.
LANDINGS: Final = "Fhcsz"
FLIGHTS: Final = LANDINGS + "b"


@dataclass(frozen=True, eq=False)
class Point:
    """A cycle on a branch, with its equations."""

    cycles: "Cycles"
    x: Floats  # (m,) the unknowns: start, durations, and the parameter if it is not Gamma
    round: Round
    tangent: Floats  # (m,) unit vector along the branch

    @property
    def letters(self) -> str:
        return self.cycles.letters

    @property
    def times(self) -> Floats:
        """Durations of the segments (n,), rad."""
        return self.x[START : START + len(self.cycles.letters)]

    @cached_property
    def flights(self) -> list[float]:
        """Durations of the flights in order, rad."""
        return [t for t, letter in zip(self.times.tolist(), self.letters, strict=True) if letter in FLIGHTS]

    @property
    def cell(self) -> Cell:
        return self.cycles.cell(self.x)

    @cached_property
    def parameter(self) -> float:
        """Value of the parameter along which the branch is followed."""
        return self.cycles.parameter(self.x)

    @cached_property
    def rising(self) -> float:
        """Rate of the parameter along the branch; zero at a fold."""
        return float(self.cycles.gradient(self.x) @ self.tangent)

    @property
    def phase(self) -> float:
        """Phase of the plate at the start, rad."""
        return math.atan2(self.x[4], self.x[3]) % TWO_PI

    @property
    def state(self) -> Floats:
        """State at the start (6,), as STATE_FIELDS."""
        return np.array([self.phase, float(self.letters[0] in FLIGHTS), 0.0, *self.x[:3] / self.cell.gamma])

    def towards(self, way: Floats) -> "Point":
        """The cycle with a tangent that leans towards `way` (m,)."""
        return self if self.tangent @ way > 0.0 else self.back()

    def back(self) -> "Point":
        """The cycle with the opposite tangent."""
        return replace(self, tangent=-self.tangent)

    def begun(self, j: int) -> "Point":
        """The same cycle, begun with segment j, where the gap must be zero."""
        if j == 0:
            return self
        letters = self.letters[j:] + self.letters[:j]
        rest = self.x[START + len(letters) :]
        x = np.concatenate([self.round.starts[j, 1 : 1 + START], np.roll(self.times, -j), rest])
        return self.cycles._replace(letters=letters).on_branch(x)

    @cached_property
    def multipliers(self) -> NDArray[np.complex128]:
        """The Floquet multipliers (4,), the largest first; infinite where an event does not fix its duration.

        They belong to the map of (gap', q, q', phase) over one cycle at fixed parameters.
        """
        whole = monodromy(len(self.letters), self.round.slope, self.x)
        if not np.isfinite(whole).all():
            return np.full(4, np.inf, np.complex128)
        mu = np.linalg.eigvals(whole).astype(np.complex128)
        return np.asarray(mu[np.argsort(-np.abs(mu))])

    @property
    def stable(self) -> bool:
        """Whether all multipliers lie inside the unit circle."""
        return bool(np.abs(self.multipliers[0]) < 1.0)


class Cycles(NamedTuple):
    """The equations of the cycles of one signature in a spring, along one parameter."""

    plate: Any  # of one cell
    omega: float
    xi: float
    letters: str  # see `kernel.cycles.segments`
    periods: int
    along: str = "gamma"
    gamma: float = math.nan  # unless it is the parameter

    @property
    def code(self) -> NDArray[np.uint8]:
        return np.frombuffer(self.letters.encode(), np.uint8)

    def cell(self, x: Floats) -> Cell:
        """The cell of unknowns x (m,)."""
        cell = Cell(math.hypot(x[3], x[4]), self.omega, self.xi)
        return cell if self.along == "gamma" else cell._replace(**{self.along: float(x[-1])})

    def gradient(self, x: Floats) -> Floats:
        """Derivatives of the parameter by the unknowns (m,)."""
        way = np.zeros(len(x))
        if self.along == "gamma":
            way[3:START] = x[3:START] / math.hypot(x[3], x[4])
        else:
            way[-1] = 1.0
        return way

    def equations(self, x: Floats) -> Round:
        """One round at unknowns x (m,), with the equations' values (m - 1,) and slopes (m - 1, m)."""
        return self._solved(x, x, 0.0, 0.0, 0)[2]

    def newton(
        self, x: Floats, direction: Floats, goal: float | None = None, converged: float = _CONVERGED
    ) -> Point | None:
        """The cycle near x (m,) at which direction . x is `goal`, by Newton's method; None if it diverges.

        goal: by default its value at the guess x. converged: relative size of the last step. The tangent
        leans towards `direction` (m,).
        """
        check()
        goal = float(direction @ x) if goal is None else goal
        found, x, cycle, tangent = self._solved(x, direction, goal, converged, _NEWTON)
        return Point(self, x, cycle, tangent) if found else None

    def _solved(
        self, x: Floats, direction: Floats, goal: float, converged: float, most: int
    ) -> tuple[bool, Floats, Round, Floats]:
        cycles = self.plate, self.omega, self.xi, self.code, self.periods, ALONG.index(self.along), self.gamma
        return newton(*cycles, x, direction, goal, converged, most)

    def at(self, x: Floats, parameter: float) -> Point | None:
        """The cycle near x (m,) at a value of the parameter, or None."""
        point = self.about(x, parameter)
        return point if point is not None and math.isclose(point.parameter, parameter) else None

    def about(self, x: Floats, parameter: float) -> Point | None:
        """The cycle near x (m,) at about a value of the parameter; beside a fold it may be at another."""
        point = None
        for _ in range(_SAME_GAMMA):
            way = self.gradient(x)
            point = self.newton(x, way, float(way @ x) + parameter - self.parameter(x))
            if point is None or abs(point.parameter - parameter) <= 1e-14 * parameter:
                break
            x = point.x
        return point

    def parameter(self, x: Floats) -> float:
        """Value of the parameter at unknowns x (m,)."""
        return math.hypot(x[3], x[4]) if self.along == "gamma" else float(x[-1])

    def on_branch(self, x: Floats) -> Point:
        """The known cycle at unknowns x (m,), with a tangent of either sign."""
        cycle = self.equations(x)
        scale = 1.0 / np.abs(cycle.slope).max(axis=1, keepdims=True)
        return Point(self, x, cycle, np.linalg.qr((cycle.slope * scale).T, "complete")[0][:, -1])

    def with_segments(self, letters: str, x: Floats, times: Any) -> tuple["Cycles", Floats]:
        """Equations and unknowns of the same start with other segments; times (n,), rad."""
        rest = x[START + len(self.letters) :]
        return self._replace(letters=letters), np.concatenate([x[:START], times, rest])


# --- the kernel as judge ------------------------------------------------------------------------------------


class Broken(NamedTuple):
    """Why a solution of the equations is not a cycle of the spring."""

    reason: str  # "vanishes", "lands softly", "emerges", "sticks", "takes off", "touches", "does not close"
    segment: int  # index of the segment that breaks
    time: float = math.nan  # rad from the segment's beginning to where the kernel ends it


def kernels_round(cycles: Cycles, x: Floats, span: float, most: int = MOST) -> tuple[str, Floats, Floats]:
    """The kernel's segments over `span` rad from the start in x, as `segments.simulated`."""
    cell, phase = cycles.cell(x), math.atan2(x[4], x[3]) % TWO_PI
    gap1, q, q1 = (x[:3] / cell.gamma).tolist()
    # by rounding a flight from rest may begin into the plate, or late
    flies = cycles.letters[0] in FLIGHTS
    state = [phase, 0.0, 0.0, max(gap1, 0.0) if flies else gap1, q, q1]
    letters, times, states = simulated(cycles.plate, cell, state, span, most)
    late = int(flies and letters.startswith("S") and times[0] < _AT_ONCE)
    return letters[late:], times[late:], states[late:]


def confirmed(point: Point) -> tuple[Point, Broken | None]:
    """The cycle with the kernel's number of hops, and why it is not one of the spring; None if it is one."""
    counted = set()
    for _ in range(_RECOUNTS):
        result = _broken_within(point) or _judged(point)
        if not isinstance(result, int):
            return point, result
        if point.letters in counted:  # at the edge between two numbers of hops both are right
            return point, None
        counted.add(point.letters)
        recounted = _recounted(point, result)
        if recounted is None:
            break
        point = recounted
    return point, Broken("does not close", 0)


def admissible(point: Point) -> Point | None:
    """The cycle with the kernel's number of hops; None if it is not one of the spring."""
    point, broken = confirmed(point)
    return point if broken is None else None


def _recounted(point: Point, first: int) -> Point | None:
    """The cycle with the hops of the kernel's round that begins with its segment `first`, or None."""
    kernel = kernels_round(point.cycles, point.x, _ROUNDS * TWO_PI * point.cycles.periods)
    guess = _guess(point.cycles, point.cell.gamma, point.phase, kernel, first)
    if guess is None or len(guess[0].letters) > _LONGEST:
        return None
    cycles, start = guess
    rest = START + len(point.letters)
    way = np.concatenate([point.tangent[:START], np.zeros(len(cycles.letters)), point.tangent[rest:]])
    way /= math.sqrt(way @ way)
    return cycles.newton(np.concatenate([start, point.x[rest:]]), way)


def _broken_within(point: Point) -> Broken | None:
    """Why the solution by itself is not a cycle of the spring; None if nothing shows."""
    times, letters, cycle = point.times, point.letters, point.round
    i = int(np.argmin(times))
    if times[i] <= 0.0:
        return Broken("vanishes", i)
    for i, letter in enumerate(letters):
        if cycle.rates[i] >= 0.0:
            return Broken("lands softly" if letter in LANDINGS else "touches", i)
        if letter == "b" and cycle.starts[i + 1, 0] >= 0.0:
            return Broken("emerges", i)
        if letter == "z" and cycle.forces[i] >= 0.0:
            return Broken("sticks", i)
        if letter == "s" and cycle.forces[i] <= 0.0:
            return Broken("takes off", i)
    return None


def _judged(point: Point) -> Broken | int | None:
    """Why the kernel does not follow the solution; None if it does.

    If the kernel follows other hops: the index of its segment with which its next round begins.
    """
    n, letters, times = len(point.letters), 2 * point.letters, np.tile(point.times, 2)
    span, most = TWO_PI * point.cycles.periods + 1.0, 2 * n + 200
    kernel, durations, states = kernels_round(point.cycles, point.x, span, most)
    i = j = end = 0
    late = 0.0  # rad by which the solution lags, from hops that only the kernel or only the solution has
    other_hops = False
    while i < n:
        duration = float(durations[j]) if j < len(kernel) else math.nan
        both = letters[i] + kernel[j] if j < len(kernel) else ""
        last = _chatter_end(kernel, j) if both == "ch" else _chatter_end(letters, i) if both == "hc" else 0
        as_long = abs(duration + late - times[i]) < AGREE
        if not (as_long and (both == 2 * letters[i] or last > 0)):
            reason = "lands softly" if as_long and both == "Fb" else "touches"
            return None if _hides(point, i, duration) else Broken(reason, i, duration)
        end, late = j + 1, 0.0
        if both == "ch":
            late, j = float(durations[end : last + 1].sum()), last
        elif both == "hc":
            late, i = -float(times[i + 1 : last + 1].sum()), last
        other_hops = other_hops or last > 0
        i, j = i + 1, j + 1
    if other_hops:
        return end
    closure = np.abs(states[end][1:] - point.x[:3] / point.cell.gamma).max()
    return None if closure < _CLOSES else Broken("does not close", 0)


def _chatter_end(letters: str, hop: int) -> int:
    """Index of the segment with which a hop's chatter ends; 0 if it does not end."""
    rest = letters[hop + 1 :].lstrip("h")
    return len(letters) - len(rest) if rest.startswith("c") else 0


def _hides(point: Point, i: int, duration: float) -> bool:
    """Whether the kernel misses the end of segment i only by rounding."""
    late = not duration <= point.times[i]
    if point.letters[i] == "S":
        return late and point.times[(i + 1) % len(point.letters)] < _SHORT_FLIGHT
    return point.letters[i] in LANDINGS and late and point.round.rates[i] > -_SOFT_LANDING


# --- from a state -------------------------------------------------------------------------------------------


def read(plate: Any, cell: Cell, periods: int, state: Floats) -> tuple[Cycles, Floats] | None:
    """The signature, and a guess of the unknowns, of the cycle near a state (6,); None if nothing repeats.

    state: as STATE_FIELDS, such as a cell's end state. They are read from one round that the kernel
    simulates, begun after the longest flight.
    """
    gamma, omega, xi = map(float, cell)
    whole = TWO_PI * periods
    span, most = _ROUNDS * whole + 3.0, MOST * periods
    letters, times, _ = kernel = simulated(plate, cell, state, span, most)
    since = np.cumsum(times) - times  # rad, at the beginning of each segment
    landings = [i for i in range(1, len(letters)) if letters[i] in LANDINGS and since[i] <= whole + 1e-9]
    if not landings:
        return None
    first = max(landings, key=lambda i: times[i]) + 1
    return _guess(Cycles(plate, omega, xi, "", periods), gamma, float(state[0]), kernel, first)


def state_after(plate: Any, cell: Cell, state: Floats, periods: int) -> Floats:
    """The state (6,) about `periods` plate periods after another, as STATE_FIELDS."""
    _, times, states = simulated(plate, cell, state, TWO_PI * periods, MOST * periods)
    return np.array([(state[0] + times.sum()) % TWO_PI, 0.0, *states[-1]])


def _guess(
    cycles: Cycles, gamma: float, phase: float, kernel: tuple[str, Floats, Floats], first: int
) -> tuple[Cycles, Floats] | None:
    """The signature, and a guess of the unknowns, of the cycle that begins with the kernel's segment `first`.

    kernel: the segments that it simulates from `phase` on, as `segments.simulated`. None if nothing repeats.
    """
    letters, times, states = kernel
    around = letters[first - 1 : first + 1]
    last = end_of_round(letters, times, first, TWO_PI * cycles.periods, around, times[first - 1])
    if last == 0:
        return None
    phase += times[:first].sum()
    start = [*(gamma * states[first, 1:]), gamma * math.cos(phase), gamma * math.sin(phase)]
    return cycles._replace(letters=letters[first:last]), np.concatenate([start, times[first:last]])


def end_of_round(letters: str, times: Floats, first: int, whole: float, around: str, flight: float) -> int:
    """Index of the segment with which the next round begins, about `whole` rad after the first; 0: none.

    around: letters before and after the beginning of a round. flight: duration of the one before, rad.
    """
    since = np.cumsum(times[first:])  # rad, at the end of each segment

    def unlike(j: int) -> float:
        return float(abs(since[j - 1 - first] - whole) + abs(times[j - 1] - flight))

    ends = [j for j in range(first + 1, len(letters)) if letters[j - 1 : j + 1] == around]
    return min(ends, key=unlike, default=0)


def cycle_from(
    plate: Any, cell: Cell, periods: int, state: Floats, within: float = math.inf, *, seed: bool = False
) -> Point | None:
    """The cycle of `periods` plate periods near a state (6,), or None.

    within: how far its unknowns may lie from the round read from the state. seed: it begins a branch, so that
    it may be at another Gamma.
    """
    guess = read(plate, cell, periods, state)
    if guess is None:
        return None
    cycles, x = guess
    point = (cycles.about if seed else cycles.at)(x, float(cell.gamma))
    if point is None or np.abs(point.x - x).max() > within:
        return None
    return admissible(point)


def cycle_through(plate: Any, cell: Cell, periods: int, state: Floats) -> Point | None:
    """The cycle of `periods` plate periods through a state (6,) at its start, as `Point.state`, or None.

    At a fold too, where Gamma does not tell its cycles apart.
    """
    gamma, omega, xi = map(float, cell)
    whole = TWO_PI * periods
    letters, times, states = simulated(plate, cell, state, whole + 1.0, MOST * periods)
    # a round ends with a landing, also where the next flight is minute
    away = np.where([letter in LANDINGS for letter in letters], np.abs(np.cumsum(times) - whole), math.inf)
    if state[2] != 0.0 or not np.isfinite(away).any():
        return None
    n = int(np.argmin(away)) + 1
    start = [*(gamma * state[3:]), gamma * math.cos(state[0]), gamma * math.sin(state[0])]
    cycles = Cycles(plate, omega, xi, letters[:n], periods)
    simulated_round = cycles.on_branch(np.array([*start, *times[:n]]))
    point = cycles.newton(simulated_round.x, simulated_round.tangent)
    if point is not None and abs(point.parameter - gamma) <= _SAME_CELL * gamma:
        point = admissible(point)
        if point is not None:
            return point
    # on an event rounding decides about a segment, but not about the motion
    closure = max(away[n - 1], np.abs(states[n] - state[2:]).max())
    return simulated_round if closure < _CLOSES else None
