"""Cycles of any contact: Newton's method, multipliers, the kernel as judge, and cycles read from a state."""

import math
from itertools import combinations
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cycles.roots import Floats
from kernel.cycles.segments import START, Round, go_round, newton_step, simulated
from kernel.interface import State
from kernel.numerics.elementary import TWO_PI
from kernel.params import Cell
from kernel.stopping import check

#: Newton steps at most, and the last step's size, relative.
_NEWTON: Final = 14
_CONVERGED: Final = 1e-12
#: A step of Newton's method above this, relative, in any unknown has left the branch.
_AWAY: Final = 2.0
#: Newton's method keeps c + i s on a line; so often turned to the new phase, that keeps Gamma.
_SAME_GAMMA: Final = 5
#: Relative step of the derivatives by Omega and xi.
_DIFFERENCE: Final = 1e-6

#: Times that hops are counted anew for one solution.
_RECOUNTS: Final = 8
#: Durations of the kernel and of a cycle agree within this, rad.
AGREE: Final = 3e-6
#: and the state after a round, plate amplitudes.
_CLOSES: Final = 1e-6
#: Rounding may hide a landing at less than this gap' (g/omega), or a take-off to a shorter flight, rad.
_SOFT_LANDING: Final = 1e-5
_SHORT_FLIGHT: Final = 1e-2
#: Rounds that are simulated to read a cycle: up to two before it begins, its own, and a segment of one more.
_ROUNDS: Final = 4.2
#: Segments of a cycle at most, and phases of the kernel in a plate period.
_LONGEST: Final = 300
MOST: Final = 4000

#: A flight that ends with one of these letters has landed.
LANDINGS: Final = "Fhcsz"
FLIGHTS: Final = LANDINGS + "b"

#: Parameters along which cycles are followed.
PARAMETERS: Final = ("gamma", "omega", "xi")


class Point(NamedTuple):
    """A cycle with its equations, and the unit vector along its branch."""

    cycles: "Cycles"
    x: Floats  # (m,) the start, the durations, and the parameter if it is not Gamma
    round: Round
    tangent: Floats  # (m,)

    @property
    def letters(self) -> str:
        return self.cycles.letters

    @property
    def times(self) -> Floats:
        """(n,) rad of each segment."""
        return self.x[START : START + len(self.cycles.letters)]

    @property
    def flights(self) -> list[float]:
        """Rad of each flight, in order."""
        return [t for t, x in zip(self.times.tolist(), self.letters, strict=True) if x in FLIGHTS]

    @property
    def cell(self) -> tuple[float, float, float]:
        """Gamma, Omega, xi."""
        return self.cycles.cell(self.x)

    @property
    def parameter(self) -> float:
        """What the branch is followed along."""
        return self.cell[PARAMETERS.index(self.cycles.along)]

    @property
    def rising(self) -> float:
        """The rate of the parameter along the branch; zero at a fold."""
        return float(self.cycles.gradient(self.x) @ self.tangent)

    @property
    def phase(self) -> float:
        """The plate's, at the start, rad."""
        return math.atan2(self.x[4], self.x[3]) % TWO_PI

    @property
    def state(self) -> Floats:
        """(6,) at the start, as STATE_FIELDS."""
        return np.array([self.phase, float(self.letters[0] in FLIGHTS), 0.0, *self.x[:3] / self.cell[0]])

    def towards(self, way: Floats) -> "Point":
        """With the tangent that leans towards `way` (m,)."""
        return self if self.tangent @ way > 0.0 else self._replace(tangent=-self.tangent)

    def begun(self, j: int) -> "Point":
        """The same cycle, begun with segment j, where the gap is zero."""
        if j == 0:
            return self
        letters = self.letters[j:] + self.letters[:j]
        rest = self.x[START + len(letters) :]
        x = np.concatenate([self.round.starts[j, 1 : 1 + START], np.roll(self.times, -j), rest])
        return self.cycles._replace(letters=letters).on_branch(x)

    def multipliers(self) -> NDArray[np.complex128]:
        """(4,) over one cycle at fixed parameters, the largest first; infinite where a duration has no root.

        The map of (gap', q, q', phase) at the start, the durations following from the events.
        """
        n = len(self.letters)
        c, s = self.x[3:START]
        slope = self.round.slope

        def by_start(rows: Floats) -> Floats:
            return np.column_stack([rows[:, :3], c * rows[:, 4] - s * rows[:, 3]])

        events, final = slope[:n], slope[n : n + 3]
        times = -by_start(events)
        with np.errstate(all="ignore"):
            for i in range(n):  # an event depends on the durations up to its own
                times[i] = (times[i] - events[i, START : START + i] @ times[:i]) / events[i, START + i]
            whole = np.eye(4)
            whole[:3] += by_start(final) + final[:, START : START + n] @ times
            whole[3] += times.sum(axis=0)
        if not np.isfinite(whole).all():
            return np.full(4, np.inf, np.complex128)
        found = np.linalg.eigvals(whole).astype(np.complex128)
        return np.asarray(found[np.argsort(-np.abs(found))])

    @property
    def stable(self) -> bool:
        """Whether all multipliers lie inside the unit circle."""
        return bool(np.abs(self.multipliers()[0]) < 1.0)

    def tests(self) -> Floats:
        """What changes sign at a fold, a flip and a Neimark-Sacker point."""
        mu = self.multipliers()
        torus = np.prod([1.0 - a * b for a, b in combinations(mu, 2)])
        return np.array([self.rising, np.prod(1.0 + mu).real, torus.real])


class Cycles(NamedTuple):
    """The cycles of one signature in a spring, along one parameter: what Newton's method solves."""

    plate: Any  # of one cell
    omega: float
    xi: float
    letters: str  # see `kernel.cycles.segments`
    periods: int
    along: str = "gamma"
    gamma: float = math.nan  # where it is not the parameter

    @property
    def code(self) -> NDArray[np.uint8]:
        return np.frombuffer(self.letters.encode(), np.uint8)

    def cell(self, x: Floats) -> tuple[float, float, float]:
        """Gamma, Omega, xi of unknowns x (m,)."""
        omega = float(x[-1]) if self.along == "omega" else self.omega
        xi = float(x[-1]) if self.along == "xi" else self.xi
        return math.hypot(x[3], x[4]), omega, xi

    def gradient(self, x: Floats) -> Floats:
        """Of the parameter, by the unknowns (m,)."""
        way = np.zeros(len(x))
        if self.along == "gamma":
            way[3:START] = x[3:START] / math.hypot(x[3], x[4])
        else:
            way[-1] = 1.0
        return way

    def equations(self, x: Floats) -> Round:
        """The cycle gone through once at unknowns x (m,), with values (m - 1,) and slopes (m - 1, m)."""
        gamma, omega, xi = self.cell(x)
        if self.along == "gamma":
            return go_round(self.plate, omega, xi, self.code, self.periods, x)
        u = np.ascontiguousarray(x[:-1])
        cycle = go_round(self.plate, omega, xi, self.code, self.periods, u)
        step = _DIFFERENCE * float(x[-1])
        sides = []
        for change in (step, -step):
            _, omega, xi = self.cell(x + change * self.gradient(x))
            sides.append(go_round(self.plate, omega, xi, self.code, self.periods, u).value)
        slope = np.zeros((len(u), len(x)))
        slope[:-1, :-1], slope[:-1, -1] = cycle.slope, (sides[0] - sides[1]) / (2.0 * step)
        slope[-1, 3:START] = u[3:START] / gamma
        return cycle._replace(value=np.append(cycle.value, gamma - self.gamma), slope=slope)

    def newton(
        self, x: Floats, direction: Floats, goal: float | None = None, converged: float = _CONVERGED
    ) -> Point | None:
        """The cycle at which direction . x is `goal`, or None. goal: None: what it is at the guess x (m,).

        The tangent leans towards `direction`. converged: the last step's size, relative.
        """
        goal = float(direction @ x) if goal is None else goal
        done = False
        for _ in range(_NEWTON):
            check()
            with np.errstate(all="ignore"):
                cycle = self.equations(x)
            if not (np.isfinite(cycle.value).all() and np.isfinite(cycle.slope).all()):
                return None
            distance = float(direction @ x) - goal
            step, tangent = newton_step(len(self.letters), cycle.slope, cycle.value, direction, distance)
            if done:
                return Point(self, x, cycle, tangent / math.sqrt(tangent @ tangent))
            size, scale = np.abs(step).max(), max(1.0, np.abs(x).max())
            if not size < _AWAY * scale:
                return None
            x = x - step
            done = size < converged * scale
        return None

    def at(self, x: Floats, parameter: float) -> Point | None:
        """The cycle near x (m,) at a value of the parameter."""
        point = None
        for _ in range(_SAME_GAMMA):
            way = self.gradient(x)
            point = self.newton(x, way, float(way @ x) + parameter - self.parameter(x))
            if point is None or abs(point.parameter - parameter) < 1e-14 * parameter:
                break
            x = point.x
        return point

    def parameter(self, x: Floats) -> float:
        """The parameter at unknowns x (m,)."""
        return self.cell(x)[PARAMETERS.index(self.along)]

    def on_branch(self, x: Floats) -> Point:
        """A cycle that is known, with a tangent of its branch of either sign."""
        cycle = self.equations(x)
        scale = 1.0 / np.abs(cycle.slope).max(axis=1, keepdims=True)
        return Point(self, x, cycle, np.linalg.svd(cycle.slope * scale)[2][-1])

    def with_segments(self, letters: str, x: Floats, times: Any) -> tuple["Cycles", Floats]:
        """The same start with other segments: their equations and unknowns."""
        rest = x[START + len(self.letters) :]
        return self._replace(letters=letters), np.concatenate([x[:START], times, rest])


# --- the kernel as judge ------------------------------------------------------------------------------------


class Broken(NamedTuple):
    """Why a solution of the equations is not a cycle of the spring."""

    reason: str  # "vanishes", "lands softly", "emerges", "sticks", "takes off", "touches", "does not close"
    segment: int
    time: float = math.nan  # rad after the segment's beginning, where the kernel ends it


def kernels_round(cycles: Cycles, x: Floats, span: float, most: int = MOST) -> tuple[str, Floats, Floats]:
    """The kernel's segments from the start of unknowns x: letters, durations (n,), states (n + 1, 4)."""
    gamma, omega, xi = cycles.cell(x)
    phase = math.atan2(x[4], x[3]) % TWO_PI
    state = State(0.0, x[0] / gamma, x[1] / gamma, x[2] / gamma)
    return simulated(cycles.plate, gamma, omega, xi, phase, state, span, most)


def confirmed(point: Point) -> tuple[Point, Broken | None]:
    """The cycle with the kernel's number of hops, and why it is not one of the spring, or None."""
    counted = set()
    for _ in range(_RECOUNTS):
        result = _broken_within(point) or _judged(point)
        if not isinstance(result, int):
            return point, result
        if point.letters in counted:  # at the edge, either number of hops does
            return point, None
        counted.add(point.letters)
        recounted = _recounted(point, result)
        if recounted is None:
            break
        point = recounted
    return point, Broken("does not close", 0)


def _recounted(point: Point, first: int) -> Point | None:
    """The cycle with the kernel's hops, of its round that begins with its segment `first`."""
    kernel = kernels_round(point.cycles, point.x, _ROUNDS * TWO_PI * point.cycles.periods)
    guess = _guess(point.cycles, point.cell[0], point.phase, kernel, first)
    if guess is None or len(guess[0].letters) > _LONGEST:
        return None
    cycles, start = guess
    rest = START + len(point.letters)
    way = np.concatenate([point.tangent[:START], np.zeros(len(cycles.letters)), point.tangent[rest:]])
    way /= math.sqrt(way @ way)
    solved = cycles.newton(np.concatenate([start, point.x[rest:]]), way)
    return None if solved is None else solved.towards(way)


def _broken_within(point: Point) -> Broken | None:
    """What the solution itself shows."""
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
    """What the kernel's own round shows; a number: it follows other hops, and its next round begins there."""
    n, letters, times = len(point.letters), 2 * point.letters, np.tile(point.times, 2)
    span, most = TWO_PI * point.cycles.periods + 1.0, 2 * n + 200
    kernel, durations, states = kernels_round(point.cycles, point.x, span, most)
    i = j = end = 0
    late = 0.0  # of the solution behind the kernel: what hops take that only one of them follows
    others = False
    while i < n:
        duration = float(durations[j]) if j < len(kernel) else math.nan
        both = letters[i] + kernel[j] if j < len(kernel) else ""
        last = _chatter_end(kernel, j) if both == "ch" else _chatter_end(letters, i) if both == "hc" else 0
        same = both == 2 * letters[i] or last > 0
        if not (same and abs(duration + late - times[i]) < AGREE):
            return None if _hides(point, i, duration) else Broken("touches", i, duration)
        end, late = j + 1, 0.0
        if both == "ch":
            late, j = float(durations[end : last + 1].sum()), last
        elif both == "hc":
            late, i = -float(times[i + 1 : last + 1].sum()), last
        others = others or last > 0
        i, j = i + 1, j + 1
    if others:
        return end
    closure = np.abs(states[end][1:] - point.x[:3] / point.cell[0]).max()
    return None if closure < _CLOSES else Broken("does not close", 0)


def _chatter_end(letters: str, hop: int) -> int:
    """The segment after a hop with which its chatter ends; 0 if it does not."""
    end = hop + 1
    while end < len(letters) and letters[end] == "h":
        end += 1
    return end if end < len(letters) and letters[end] == "c" else 0


def _hides(point: Point, i: int, duration: float) -> bool:
    """Whether the kernel misses the end of segment i by rounding only; then the solution itself decides."""
    late = not duration <= point.times[i]
    if point.letters[i] == "S":
        return late and point.times[(i + 1) % len(point.letters)] < _SHORT_FLIGHT
    return point.letters[i] in LANDINGS and late and point.round.rates[i] > -_SOFT_LANDING


# --- from a state -------------------------------------------------------------------------------------------


def read(plate: Any, cell: Cell, periods: int, state: Floats) -> tuple[Cycles, Floats] | None:
    """The signature and a guess of the unknowns of the cycle near a state (6,), or None.

    state: as STATE_FIELDS, such as a cell's end state. From one round that the kernel simulates: it begins
    after the longest flight.
    """
    gamma, omega, xi = map(float, cell)
    phase, _, *rest = map(float, state)
    whole = TWO_PI * periods
    span, most = _ROUNDS * whole + 3.0, MOST * periods
    letters, times, _ = kernel = simulated(plate, gamma, omega, xi, phase, State(*rest), span, most)
    since = np.cumsum(times) - times  # at the beginning of each
    landings = [i for i in range(1, len(letters)) if letters[i] in LANDINGS and since[i] <= whole + 1e-9]
    if not landings:
        return None
    first = max(landings, key=lambda i: times[i]) + 1
    return _guess(Cycles(plate, omega, xi, "", periods), gamma, phase, kernel, first)


def state_after(plate: Any, cell: Cell, state: Floats, periods: int) -> Floats:
    """The state (6,) about so many plate periods after another, as STATE_FIELDS."""
    gamma, omega, xi = map(float, cell)
    phase, _, *rest = map(float, state)
    most = MOST * periods
    _, times, states = simulated(plate, gamma, omega, xi, phase, State(*rest), TWO_PI * periods, most)
    return np.array([(phase + times.sum()) % TWO_PI, 0.0, *states[-1]])


def _guess(
    cycles: Cycles, gamma: float, phase: float, kernel: tuple[str, Floats, Floats], first: int
) -> tuple[Cycles, Floats] | None:
    """The signature, and start and durations, of the cycle that begins with the kernel's segment `first`.

    kernel: its segments from a phase on.
    """
    letters, times, states = kernel
    around = letters[first - 1 : first + 1]
    last = end_of_round(letters, times, first, TWO_PI * cycles.periods, around, times[first - 1])
    if last == 0:
        return None
    here = phase + times[:first].sum()
    start = [*(gamma * states[first, 1:]), gamma * math.cos(here), gamma * math.sin(here)]
    return cycles._replace(letters=letters[first:last]), np.concatenate([start, times[first:last]])


def end_of_round(letters: str, times: Floats, first: int, whole: float, around: str, flight: float) -> int:
    """The segment with which the round of about `whole` rad that begins with `first` repeats; 0: none does.

    around: the letters before and after the beginning, the first of a flight of `flight` rad.
    """
    since = np.cumsum(times[first:])  # at the end of each

    def unlike(j: int) -> float:
        return float(abs(since[j - 1 - first] - whole) + abs(times[j - 1] - flight))

    ends = [j for j in range(first + 1, len(letters)) if letters[j - 1 : j + 1] == around]
    return min(ends, key=unlike, default=0)


def cycle_from(plate: Any, cell: Cell, periods: int, state: Floats, within: float = math.inf) -> Point | None:
    """The cycle of `periods` plate periods near a state (6,), `within` the round read from it, or None."""
    guess = read(plate, cell, periods, state)
    point = None if guess is None else guess[0].at(guess[1], float(cell.gamma))
    if guess is None or point is None or np.abs(point.x[: guess[1].size] - guess[1]).max() > within:
        return None
    point, broken = confirmed(point)
    return point if broken is None else None
