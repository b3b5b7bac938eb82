"""Cycles of several flights, written as words, and their branches.

A word has a letter for each flight: "s", it lands and sticks, or "z", it lands where n < 0 and takes off
again at once. The last letter is "s". Unknowns are the state after the last landing, (q, v, c, s) with
c + i s = Gamma e^{i phi} and lengths in units of g/omega**2, and all times: the contact that follows, the
first flight, the contact after it if its letter is "s", and so on. Equations: n = 0 at the end of each
contact, gap = 0 at the end of each flight, q and v come back, and the times add up to 2 pi periods: one
fewer than unknowns.

Branches are followed by pseudo-arclength. Times, not velocities, are unknowns: nothing is singular where a
landing grazes. Derivatives are by the complex step, exact to rounding.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.branches.admissibility import Reason
from kernel.branches.closed_form import TWO_PI, multipliers, orbit
from kernel.branches.closed_form import stable as is_stable
from kernel.branches.events import Events, Kind, join_events
from kernel.branches.spring import STEP, Array, Spring, flight, spring, stuck
from kernel.params import KernelInputError

Floats = NDArray[np.float64]

#: Newton steps at most, and the last step's size, relative.
_NEWTON: Final = 15
_CONVERGED: Final = 1e-12

#: Steps along a branch: the first, the largest, the smallest; the tangent turns by at most this, rad.
_FIRST, _LARGEST, _SMALLEST = 1e-3, 0.1, 1e-9
_TURN: Final = 0.2

#: First step away from the branch that doubles its period, in the units of the unknowns.
_ASIDE: Final = 1e-3

#: Samples of each flight and contact in the check of an orbit, and what is rounding there.
_SAMPLES: Final = 257
_ROUNDING: Final = 1e-9

#: Newton's method keeps c + i s on a line; so often turned to the new phase, that keeps Gamma.
_SAME_GAMMA: Final = 4

#: A contact shorter than this, rad, is an immediate take-off.
_STICKS: Final = 1e-6

#: What changes sign along a branch, in the order of `_tests`.
_TESTS: Final = (Kind.FOLD, Kind.FLIP, Kind.NEIMARK_SACKER)

#: Steps of the search for an event along a branch: enough to halve a step to rounding.
_HALVINGS: Final = 60


class WordBranch(NamedTuple):
    """n cycles of a word, in order along their branch; units as in `events.Branch`."""

    omega: float
    xi: float
    word: str
    periods: int
    unknowns: NDArray[np.float64]  # (n, m): see the module
    gamma: NDArray[np.float64]  # (n,)
    flight_time: NDArray[np.float64]  # (n, flights) rad, in the order of the letters
    takeoff_phase: NDArray[np.float64]  # (n, flights) rad, in [0, 2 pi)
    multiplier: NDArray[np.complex128]  # (n, 2)
    stable: NDArray[np.bool_]  # (n,)
    admissible: NDArray[np.uint8]  # (n,) 0, or the bits of a Reason


class _State(NamedTuple):
    """q, v, and Gamma e^{i phi} = c + i s."""

    q: Array
    v: Array
    c: Array
    s: Array


class _Piece(NamedTuple):
    """A contact or flight of an orbit."""

    flies: bool
    start: _State
    time: Array


def _turned(x: _State, t: Array) -> tuple[Array, Array]:
    """c and s after t rad."""
    sin, cos = np.sin(t), np.cos(t)
    return x.c * cos - x.s * sin, x.c * sin + x.s * cos


def _stick(k: Spring, x: _State, t: Array) -> _State:
    """The state after a contact of t rad."""
    h = x.q + 1.0 / k.stiffness - (k.q_re * x.c - k.q_im * x.s)
    h1 = x.v + (k.q_re * x.s + k.q_im * x.c)
    f = stuck(k, t)
    c, s = _turned(x, t)
    q = h * f.c + h1 * f.s - 1.0 / k.stiffness + (k.q_re * c - k.q_im * s)
    return _State(q, h * f.c1 + h1 * f.s1 - (k.q_re * s + k.q_im * c), c, s)


def _force(k: Spring, x: _State) -> Array:
    """n of a mass that sticks."""
    return 1.0 - x.c - k.dashpot * x.v - k.stiffness * x.q


def _gap(k: Spring, x: _State, t: Array) -> tuple[Array, Array]:
    """gap and gap' t rad after a take-off with gap = gap' = 0, gap'' = -n."""
    f, press = flight(k, t), k.dashpot * x.v + k.stiffness * x.q
    gap2 = -_force(k, x)
    gap = 0.5 * gap2 * t * t + x.c * f.cos_rest - x.s * f.sin_rest
    gap = gap + press * f.s_int_rest + k.stiffness * x.v * f.s_int2
    gap1 = gap2 * t - x.c * f.sin_rest - x.s * f.versine
    return gap, gap1 + press * f.s_rest + k.stiffness * x.v * f.s_int


def _fly(k: Spring, x: _State, t: Array) -> tuple[_State, Array]:
    """The state after a flight of t rad and its landing, and the gap."""
    gap, impact = _gap(k, x, t)
    f = flight(k, t).free
    c, s = _turned(x, t)
    return _State(x.q * f.c + x.v * f.s, x.q * f.c1 + x.v * f.s1 + impact, c, s), gap


def _follow(k: Spring, word: str, periods: int, u: Array) -> tuple[Array, list[_Piece]]:
    """The equations (m - 1, ...) at unknowns u (m, ...), and the pieces of the orbit."""
    x = start = _State(u[0], u[1], u[2], u[3])
    at, total, rows, pieces = 4, 0.0 * u[0], [], []
    for n in range(len(word)):
        power = 2
        if n == 0 or word[n - 1] == "s":
            pieces.append(_Piece(False, x, u[at]))
            x, total, at, power = _stick(k, x, u[at]), total + u[at], at + 1, 3
            rows.append(_force(k, x))
        pieces.append(_Piece(True, x, u[at]))
        x, gap = _fly(k, x, u[at])
        rows.append(gap / u[at] ** power)  # without the root at zero
        total, at = total + u[at], at + 1
    rest = TWO_PI * periods - total
    end = _stick(k, x, rest)
    return np.array([*rows, end.q - start.q, end.v - start.v, rest]), pieces


def _equations(k: Spring, word: str, periods: int, u: Floats) -> tuple[Floats, Floats]:
    """The equations (m - 1,) and their derivatives (m - 1, m)."""
    value, _ = _follow(k, word, periods, u[:, None] + 1j * STEP * np.eye(len(u)))
    return value[:, 0].real, value.imag / STEP


def _newton(
    k: Spring, word: str, periods: int, u: Floats, direction: Floats, goal: float | None = None
) -> tuple[Floats, Floats, bool]:
    """The orbit at which direction . u is `goal`, the derivatives there, and whether it was found.

    goal: None: what it is at the guess u.
    """
    goal = float(direction @ u) if goal is None else goal
    for _ in range(_NEWTON):
        with np.errstate(all="ignore"):
            value, slope = _equations(k, word, periods, u)
        if not (np.isfinite(value).all() and np.isfinite(slope).all()):
            return u, slope, False
        try:
            step = np.linalg.solve(np.vstack([slope, direction]), np.append(value, direction @ u - goal))
        except np.linalg.LinAlgError:
            return u, slope, False
        u = u - step
        if (u[4:] <= 0.0).any():
            return u, slope, False
        if np.abs(step).max() < _CONVERGED * np.abs(u).max():
            return u, slope, True
    return u, slope, False


def _tangent(slope: Floats) -> Floats:
    """The unit vector along the branch."""
    return np.asarray(np.linalg.svd(slope)[2][-1])


def _trace_det(slope: Floats) -> tuple[float, float]:
    """Of the tangent map over a cycle at fixed phase and Gamma, the times following from the events."""
    events = len(slope) - 3
    final = slope[events : events + 2]
    by_state = np.linalg.solve(slope[:events, 4:], slope[:events, :2])
    m = final[:, :2] + np.eye(2) - final[:, 4:] @ by_state
    return float(np.trace(m)), float(np.linalg.det(m))


def _reason(k: Spring, word: str, periods: int, u: Floats) -> int:
    """Which conditions the orbit breaks, by sampling its flights and contacts."""
    _, pieces = _follow(k, word, periods, u[:, None])
    size = float(np.hypot(u[2], u[3]))
    inside = np.linspace(0.0, 1.0, _SAMPLES)[1:-1]
    reason = 0
    for piece in pieces:
        t = inside * piece.time
        if piece.flies:
            gap, _ = _gap(k, piece.start, t)
            _, impact = _gap(k, piece.start, piece.time)
            if gap.min() < -_ROUNDING * size or impact[0] > 0.0:
                reason |= Reason.GAP
            if _force(k, piece.start)[0] > _ROUNDING * size:
                reason |= Reason.CONTACT  # a "z" that would stick
        else:
            force = _force(k, _stick(k, piece.start, t))
            if force.min() < -_ROUNDING * size or _force(k, piece.start)[0] < -_ROUNDING * size:
                reason |= Reason.CONTACT
            if force[-1] < 0.0:
                reason |= Reason.TAKEOFF
    return int(reason)


def doubled(omega: float, xi: float, periods: int, flight_time: float) -> tuple[str, int, Floats, Floats]:
    """The word that begins at a flip of the branch (1, periods), for `follow`.

    Returns the word, its periods, the unknowns (m,) of the orbit at the flip gone through twice, and the
    direction (m,) in which the two rounds begin to differ.
    """
    k = spring(omega, xi)
    t = np.array([flight_time])
    x = orbit(k, periods, t)
    c, s = _turned(_State(x.q_land, x.v_land, x.c, x.s), t)
    contact = TWO_PI * periods - flight_time
    u = np.array([x.q_land[0], x.v_land[0], c[0], s[0], contact, flight_time])
    _, slope = _equations(k, "s", periods, u)
    events = len(slope) - 3
    times = -np.linalg.solve(slope[:events, 4:], slope[:events, :2])
    final = slope[events : events + 2]
    m = final[:, :2] + np.eye(2) + final[:, 4:] @ times
    values, vectors = np.linalg.eig(m)
    state = vectors[:, np.argmin(np.abs(values + 1.0))].real
    first = times @ state
    # the phase of the landing moves by what the second cycle gives back
    direction = np.concatenate([state, [0.0, 0.0], first, -first])
    return "ss", 2 * periods, np.concatenate([u, u[4:]]), direction / np.linalg.norm(direction)


def from_flights(
    omega: float, xi: float, gamma: float, flight_time: Floats, takeoff_phase: Floats, periods: int
) -> tuple[str, int, Floats]:
    """A word and a guess of its unknowns (m,) from the flights of one cycle, as a sweep records them.

    flight_time, takeoff_phase (flights,): rad, in order, of `periods` plate periods. Raises KernelInputError
    if every landing takes off at once.
    """
    k = spring(omega, xi)
    following = np.roll(takeoff_phase, -1)
    contact = np.mod(following - takeoff_phase - flight_time, TWO_PI)
    contact = np.where(contact > TWO_PI - _STICKS, 0.0, contact)
    letters = np.where(contact > _STICKS, "s", "z")
    if not (letters == "s").any():
        raise KernelInputError("flight_time", "needs a landing that sticks")
    turn = int(np.flatnonzero(letters == "s")[-1]) + 1
    order = np.roll(np.arange(len(letters)), -turn)
    word = "".join(letters[order])
    # whole plate periods in contact are not in the phases: they go to the longest contact
    contact[np.argmax(contact)] += TWO_PI * round(
        (TWO_PI * periods - flight_time.sum() - contact.sum()) / TWO_PI
    )
    last = order[-1]
    times = []
    for n, i in enumerate(order):
        if n == 0 or word[n - 1] == "s":
            times.append(contact[order[n - 1]])
        times.append(flight_time[i])
    phase = takeoff_phase[last] + flight_time[last]
    base = np.array([0.0, 0.0, gamma * np.cos(phase), gamma * np.sin(phase), *times])
    zero, slope = _equations(k, word, periods, base)
    base[:2] = -np.linalg.lstsq(slope[:, :2], zero, rcond=None)[0]  # linear in q and v
    return word, periods, base


def follow(
    omega: float, xi: float, word: str, periods: int, unknowns: Floats, *,
    direction: Floats | None = None, points: int = 400, gamma: tuple[float, float] = (0.0, 8.0),
) -> tuple[WordBranch, Events]:  # fmt: skip
    """The branch of a word through a guess of an orbit, both ways, with its events.

    direction (m,): the first step to take, and only that way, as `doubled` gives it; None: both ways. Ends
    where Gamma leaves its range, a time shrinks to zero, or after `points` points each way. Raises
    KernelInputError if no orbit is found.
    """
    if not word or set(word) - {"s", "z"} or word[-1] != "s":
        raise KernelInputError("word", f"must be of letters s and z and end with s, got {word!r}")
    k = spring(omega, xi)
    if direction is not None:
        u, slope, found = _newton(k, word, periods, unknowns + _ASIDE * direction, direction)
        ways = [direction]
    else:
        size, u = float(np.hypot(unknowns[2], unknowns[3])), unknowns
        for _ in range(_SAME_GAMMA):
            same = np.zeros(len(u))
            same[2:4] = u[2:4] / np.hypot(u[2], u[3])
            u, slope, found = _newton(k, word, periods, u, same, size)
            if not found:
                break
        ways = [_tangent(slope), -_tangent(slope)] if found else []
    if not found:
        raise KernelInputError("unknowns", f"no orbit of the word {word} near them")
    lines = [_walk(k, word, periods, u, slope, way, points, gamma) for way in ways]
    line = [*lines[1][0][::-1], u, *lines[0][0]] if len(lines) > 1 else [u, *lines[0][0]]
    events = [event for _, some in lines for event in some]
    return _branch(k, omega, xi, word, periods, np.array(line)), _join(k, omega, xi, word, periods, events)


def _tests(slope: Floats) -> tuple[Floats, float]:
    """1 - tr + det, 1 + tr + det, det - 1; and the trace."""
    trace, det = _trace_det(slope)
    return np.array([1.0 - trace + det, 1.0 + trace + det, det - 1.0]), trace


def _walk(
    k: Spring, word: str, periods: int, u: Floats, slope: Floats, way: Floats, points: int,
    gamma: tuple[float, float],
) -> tuple[list[Floats], list[tuple[Kind, Floats]]]:  # fmt: skip
    """Points of a branch from u on, and its events."""
    line: list[Floats] = []
    events: list[tuple[Kind, Floats]] = []
    tangent = _tangent(slope)
    tangent = tangent if tangent @ way > 0.0 else -tangent
    step = _FIRST
    test, _ = _tests(slope)
    while len(line) < points and step > _SMALLEST:
        v, slope, found = _newton(k, word, periods, u + step * tangent, tangent)
        turned = _tangent(slope) if found else tangent
        turned = turned if turned @ tangent > 0.0 else -turned
        angle = float(np.arccos(min(1.0, float(turned @ tangent))))
        if not found or angle > _TURN:
            step *= 0.5
            continue
        if not gamma[0] <= np.hypot(v[2], v[3]) <= gamma[1]:
            break
        after, trace = _tests(slope)
        for i in np.flatnonzero(test * after < 0.0):
            if _TESTS[i] is Kind.NEIMARK_SACKER and abs(trace) >= 2.0:
                continue
            at = _bisect(k, word, periods, u, tangent, step, int(i), test[i], after[i])
            if at is not None:
                events.append((_TESTS[i], at))
        u, tangent, test = v, turned, after
        line.append(u)
        step = min(step * (1.5 if angle < 0.5 * _TURN else 1.0), _LARGEST)
    return line, events


def _bisect(
    k: Spring, word: str, periods: int, u: Floats, tangent: Floats, step: float, which: int,
    low_value: float, high_value: float,
) -> Floats | None:  # fmt: skip
    """The orbit within a step of u at which a test is zero, by the Illinois rule."""
    low, high = 0.0, step
    at = u
    for _ in range(_HALVINGS):
        middle = low - low_value * (high - low) / (high_value - low_value)
        at, slope, found = _newton(k, word, periods, u + middle * tangent, tangent)
        if not found:
            return None
        value = float(_tests(slope)[0][which])
        if abs(value) < 1e-13 or high - low < 1e-15:
            break
        if (value > 0.0) == (low_value > 0.0):
            low, low_value, high_value = middle, value, 0.5 * high_value
        else:
            high, high_value, low_value = middle, value, 0.5 * low_value
    return at


def _branch(k: Spring, omega: float, xi: float, word: str, periods: int, line: Floats) -> WordBranch:
    """The record of orbits (n, m)."""
    _, pieces = _follow(k, word, periods, line.T)
    flights = [piece for piece in pieces if piece.flies]
    slopes = [_equations(k, word, periods, u)[1] for u in line]
    trace, det = np.array([_trace_det(slope) for slope in slopes]).T
    return WordBranch(
        omega=omega,
        xi=xi,
        word=word,
        periods=periods,
        unknowns=line,
        gamma=np.hypot(line[:, 2], line[:, 3]),
        flight_time=np.array([piece.time for piece in flights]).T,
        takeoff_phase=np.mod(np.array([np.arctan2(p.start.s, p.start.c) for p in flights]).T, TWO_PI),
        multiplier=multipliers(trace, det),
        stable=is_stable(trace, det),
        admissible=np.array([_reason(k, word, periods, u) for u in line], np.uint8),
    )


def _join(
    k: Spring, omega: float, xi: float, word: str, periods: int, events: list[tuple[Kind, Floats]]
) -> Events:
    """The record of events; flight_time is that of the first flight."""
    if not events:
        return join_events([])
    b = _branch(k, omega, xi, word, periods, np.array([u for _, u in events]))
    m = len(events)
    return Events(
        np.array([kind for kind, _ in events], np.str_), np.full(m, omega), np.full(m, xi),
        np.full(m, len(word), np.int32), np.full(m, periods, np.int32), b.flight_time[:, 0], b.gamma,
        b.multiplier, b.admissible,
    )  # fmt: skip
