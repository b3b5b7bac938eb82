"""Cycles of several flights, written as words.

A word has a letter for each flight: "s", it lands and sticks, or "z", it lands where n < 0 and takes off
again at once. The last letter is "s". Unknowns are the state after the last landing, (q, v, c, s) with
c + i s = Gamma e^{i phi} and lengths in units of g/omega**2, and all times: the contact that follows, the
first flight, the contact after it if its letter is "s", and so on. Equations: n = 0 at the end of each
contact, gap = 0 at the end of each flight, q and v come back, and the times add up to 2 pi periods: one
fewer than unknowns. Times, not velocities, are unknowns: nothing is singular where a landing grazes.

`kernel.branches.continuation` follows the branch of a word.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.branches.admissibility import Reason, Samples, deepest, force_from, force_terms, gap_terms
from kernel.branches.closed_form import TWO_PI, multipliers, orbit
from kernel.branches.closed_form import stable as is_stable
from kernel.branches.events import GRAZES, Kind, check_spring, sample_times
from kernel.branches.roots import Floats
from kernel.branches.spring import Array, Flight, Free, Spring, flight, spring, stuck
from kernel.params import KernelInputError

#: A contact shorter than this, rad, is an immediate take-off.
_STICKS: Final = 1e-6

#: A time that is exactly zero is taken as this: what the gap is divided by stays a number.
_SHORTEST: Final = 1e-30

#: Conditions are broken by more than this, in plate amplitudes or m A omega**2. Where a flight shrinks to
#: nothing, n touches zero: two times vanish together, and each is known to the root of rounding only.
_BROKEN: Final = 1e-8

#: The state's places among the unknowns; the times follow.
STATE: Final = 4


class Word(NamedTuple):
    """A cycle of several flights, or a guess of one, from which its branch is followed."""

    omega: float
    xi: float
    letters: str  # of "s" and "z", the last an "s"
    periods: int
    unknowns: Floats  # (m,): see the module
    direction: Floats | None = None  # (m,) the first step from another branch; None: both ways

    @property
    def gamma(self) -> float:
        return float(np.hypot(self.unknowns[2], self.unknowns[3]))

    def at(self, unknowns: Floats) -> "Word":
        """Another orbit of the same word."""
        return self._replace(unknowns=unknowns, direction=None)


class WordBranch(NamedTuple):
    """n cycles of a word, in order along their branch; units as in `events.Branch`."""

    omega: float
    xi: float
    word: str
    periods: int
    unknowns: Floats  # (n, m): see the module
    gamma: Floats  # (n,)
    flight_time: Floats  # (n, flights) rad, in the order of the letters
    takeoff_phase: Floats  # (n, flights) rad, in [0, 2 pi)
    impact_velocity: Floats  # (n, flights) gap' before landing, < 0
    multiplier: NDArray[np.complex128]  # (n, 2)
    stable: NDArray[np.bool_]  # (n,)
    admissible: NDArray[np.uint8]  # (n,) 0, or the bits of a Reason


class Piece(NamedTuple):
    """A contact or a flight of a word."""

    flies: bool
    letter: int  # the flight's, or of the flight after this contact
    place: int  # its time among the unknowns
    power: int  # of the root of the gap at zero time: 3 after a contact, 2 after a "z"


class State(NamedTuple):
    """q, v, c, s of p orbits, with their derivatives: arrays (1 + m, p), the values in row 0."""

    q: Array
    v: Array
    c: Array
    s: Array


class Round(NamedTuple):
    """p orbits gone through once."""

    value: Floats  # (m - 1, p) of the equations
    slope: Floats  # (m - 1, m, p) their derivatives by the unknowns
    starts: list[State]  # at each piece's beginning
    impacts: list[Floats]  # (p,) gap' before each flight's landing


def pieces(letters: str) -> list[Piece]:
    """In order from the last landing on."""
    parts: list[Piece] = []
    for n in range(len(letters)):
        sticks = letters[n - 1] == "s"
        if sticks:
            parts.append(Piece(False, n, STATE + len(parts), 0))
        parts.append(Piece(True, n, STATE + len(parts), 3 if sticks else 2))
    return parts


def go_round(k: Spring, letters: str, periods: int, u: Floats) -> Round:
    """The equations at unknowns u (m, p), and their derivatives: each motion is linear in its state."""
    parts = pieces(letters)
    m, p = u.shape
    times = np.where(u[STATE:] == 0.0, _SHORTEST, u[STATE:])
    flies = np.array([part.flies for part in parts])
    flown, stuck_ = flight(k, times[flies]), stuck(k, times[~flies])
    state = State(*np.zeros((STATE, 1 + m, p)))
    for i, x in enumerate(state):
        x[0], x[1 + i] = u[i], 1.0
    start = state
    rows, starts, impacts = [], [], []
    flights = contacts = 0
    for part in parts:
        starts.append(state)
        t = times[part.place - STATE]
        if part.flies:
            f = Flight(Free(*(x[flights] for x in flown.free)), *(x[flights] for x in flown[1:]))
            state, gap, impact = _fly(k, state, f, t, part.place)
            gap = gap / t**part.power  # without the root at zero
            gap[1 + part.place] -= part.power * gap[0] / t
            rows.append(gap)
            impacts.append(impact)
            flights += 1
        else:
            state = _stick(k, state, Free(*(x[contacts] for x in stuck_)), t, part.place)
            rows.append(force(k, state))
            contacts += 1
    # what is left of the periods is zero: to first order, a contact of that time
    rest = np.zeros((1 + m, p))
    rest[0], rest[1 + STATE :] = TWO_PI * periods - u[STATE:].sum(axis=0), -1.0
    q1, v1 = _contact_motion(k, state)
    rows += [state.q - start.q + rest * q1, state.v - start.v + rest * v1, rest]
    whole = np.array(rows)
    return Round(whole[:, 0], whole[:, 1:], starts, impacts)


def force(k: Spring, x: State) -> Array:
    """n of a mass that sticks (1 + m, p)."""
    n = -x.c - k.dashpot * x.v - k.stiffness * x.q
    n[0] += 1.0
    return np.asarray(n)


def _contact_motion(k: Spring, x: State) -> tuple[Floats, Floats]:
    """q' and v' in contact (p,)."""
    return x.v[0], x.c[0] - 1.0 - k.dashpot * x.v[0] - k.stiffness * x.q[0]


def _turned(x: State, sin: Floats, cos: Floats) -> tuple[Array, Array]:
    """c and s later."""
    return x.c * cos - x.s * sin, x.c * sin + x.s * cos


def _stick(k: Spring, x: State, f: Free, t: Floats, place: int) -> State:
    """The state after a contact of t rad."""
    h = x.q - (k.q_re * x.c - k.q_im * x.s)
    h[0] += 1.0 / k.stiffness
    h1 = x.v + (k.q_re * x.s + k.q_im * x.c)
    c, s = _turned(x, np.sin(t), np.cos(t))
    q = h * f.c + h1 * f.s + (k.q_re * c - k.q_im * s)
    q[0] -= 1.0 / k.stiffness
    end = State(q, h * f.c1 + h1 * f.s1 - (k.q_re * s + k.q_im * c), c, s)
    return _with_time(end, place, *_contact_motion(k, end))


def _with_time(x: State, place: int, q1: Floats, v1: Floats) -> State:
    """With the derivative by the time of the last piece."""
    x.q[1 + place] += q1
    x.v[1 + place] += v1
    x.c[1 + place] -= x.s[0]
    x.s[1 + place] += x.c[0]
    return x


def _fly(k: Spring, x: State, f: Flight, t: Floats, place: int) -> tuple[State, Array, Floats]:
    """The state after a flight of t rad and its landing, the gap (1 + m, p), and gap' there (p,).

    From a take-off with gap = gap' = 0, gap'' = -n.
    """
    b, w = k.dashpot, k.stiffness
    gap2, press = -force(k, x), b * x.v + w * x.q
    gap = 0.5 * t * t * gap2 + x.c * f.cos_rest - x.s * f.sin_rest + press * f.s_int_rest + w * x.v * f.s_int2
    gap1 = t * gap2 - x.c * f.sin_rest - x.s * f.versine + press * f.s_rest + w * x.v * f.s_int
    q, v = x.q * f.free.c + x.v * f.free.s, x.q * f.free.c1 + x.v * f.free.s1
    c, s = _turned(x, f.sin, f.cos)
    before = v[0].copy()
    end = _with_time(
        State(q, v + gap1, c, s), place, before, -b * before - w * q[0] + c[0] - 1.0
    )  # v' + gap'' with v' = -2 b v - 2 w q and gap'' = b v + w q + c - 1
    impact = gap1[0].copy()
    gap[1 + place] += impact
    return end, gap, impact


def trace_and_det(slope: Floats) -> tuple[Floats, Floats]:
    """Of the tangent maps (p,) over a cycle at fixed phase and Gamma, the times following from the events.

    slope (m - 1, m, p). A landing that sticks forgets its phase: the map is 2 x 2.
    """
    each = np.moveaxis(slope, -1, 0)
    events = slope.shape[0] - 3
    final = each[:, events : events + 2]
    by_state = np.linalg.solve(each[:, :events, STATE:], each[:, :events, :2])
    m = final[:, :, :2] + np.eye(2) - final[:, :, STATE:] @ by_state
    return m[:, 0, 0] + m[:, 1, 1], m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0]


class Conditions(NamedTuple):
    """What must be positive for p orbits to be those of a spring."""

    kind: tuple[Kind, ...]  # (r,) what happens where it passes zero
    reason: tuple[Reason, ...]  # (r,)
    piece: tuple[int, ...]  # (r,) the contact or flight it belongs to
    value: Floats  # (r, p) in plate amplitudes or m A omega**2; inf: no minimum inside
    time: Floats  # (r, p) rad after the piece's beginning, of a minimum inside; NaN: not of a minimum


def samples(k: Spring, periods: int) -> Samples:
    """Of flights and contacts of a word, to be made once for a spring."""
    t = sample_times(k, periods)
    return Samples(t, _gap_terms(k, t)[:2], force_terms(k, t)[:2])


def _gap_terms(k: Spring, t: Array) -> tuple[Array, Array, Array]:
    """The gap and its two derivatives as combinations (5, ...) of (c, s, b v + w q, v, -n)."""
    one = np.ones_like(t)
    last = (0.5 * t * t, t, one)
    terms = zip(gap_terms(k, t), last, strict=True)
    return tuple(np.concatenate([x, y[None]]) for x, y in terms)  # type: ignore[return-value]


def conditions(k: Spring, letters: str, u: Floats, cycle: Round, nodes: Samples) -> Conditions:
    """Of orbits u (m, p), gone through as `cycle`."""
    scale = 1.0 / np.hypot(u[2], u[3])
    b, w = k.dashpot, k.stiffness
    rows: list[tuple[Kind, Reason, int, Floats, Floats]] = []
    none = np.full(u.shape[1], np.nan)
    flown = 0
    for i, part in enumerate(pieces(letters)):
        x = State(*(y[0] for y in cycle.starts[i]))
        n = force(k, cycle.starts[i])[0]
        t = u[part.place]
        press = b * x.v + w * x.q
        if part.flies:
            impact = cycle.impacts[flown]
            flown += 1
            weights = np.array([x.c, x.s, press, x.v, -n if part.power == 2 else 0.0 * n]) * scale
            gap = deepest(k, _gap_terms, weights, 0.0 * t, t, impact * scale, nodes.time, nodes.gap, GRAZES)
            rows.append((Kind.GRAZE_FLIGHT, Reason.GAP, i, gap.depth, gap.time))
            rows.append((Kind.GRAZE_FLIGHT, Reason.GAP, i, -impact * scale, none))
            if part.power == 2:
                rows.append((Kind.IMMEDIATE_TAKEOFF, Reason.GAP, i, -n * scale, none))
            else:
                # n' = s - b v' - w v at a take-off from contact, where n = 0
                falls = -(x.s - b * (x.c - 1.0 - press) - w * x.v)
                rows.append((Kind.GRAZE_CONTACT, Reason.TAKEOFF, i, falls * scale, none))
        else:
            weights = force_from(k, x.q, x.v, x.c, x.s) * scale
            after = State(*(y[0] for y in cycle.starts[i + 1]))
            slope = after.s - b * (after.c - 1.0 - b * after.v - w * after.q) - w * after.v
            pull = deepest(
                k, force_terms, weights, 2.0 * scale, t, slope * scale, nodes.time, nodes.force, GRAZES
            )
            rows.append((Kind.GRAZE_CONTACT, Reason.CONTACT, i, pull.depth, pull.time))
            rows.append((Kind.IMMEDIATE_TAKEOFF, Reason.CONTACT, i, n * scale, none))
    kind, reason, piece, value, time = zip(*rows, strict=True)
    return Conditions(kind, reason, piece, np.array(value), np.array(time))


def reasons(held: Conditions) -> NDArray[np.uint8]:
    """Which conditions p orbits break: bits of a Reason (p,)."""
    broken = ~(held.value > -_BROKEN)
    bits = np.zeros(held.value.shape[1], np.uint8)
    for reason, row in zip(held.reason, broken, strict=True):
        bits |= np.uint8(reason) * row.astype(np.uint8)
    return bits


def record(word: Word, unknowns: Floats) -> WordBranch:
    """The orbits (n, m) of a word."""
    k = spring(word.omega, word.xi)
    u = np.ascontiguousarray(unknowns.T)
    cycle = go_round(k, word.letters, word.periods, u)
    trace, det = trace_and_det(cycle.slope)
    parts = pieces(word.letters)
    flights = [i for i, part in enumerate(parts) if part.flies]
    gamma = np.hypot(u[2], u[3])
    phase = [np.arctan2(cycle.starts[i].s[0], cycle.starts[i].c[0]) for i in flights]
    held = conditions(k, word.letters, u, cycle, samples(k, word.periods))
    return WordBranch(
        omega=word.omega,
        xi=word.xi,
        word=word.letters,
        periods=word.periods,
        unknowns=unknowns,
        gamma=gamma,
        flight_time=np.array([u[parts[i].place] for i in flights]).T,
        takeoff_phase=np.mod(np.array(phase).T, TWO_PI),
        impact_velocity=(np.array(cycle.impacts) / gamma).T,
        multiplier=multipliers(trace, det),
        stable=is_stable(trace, det),
        admissible=reasons(held),
    )


def from_branch(omega: float, xi: float, periods: int, flight_time: float) -> Word:
    """The cycle of one flight of flight_time rad as the word "s". Raises KernelInputError."""
    check_spring(omega, xi, periods)
    unknowns = one_flight(spring(omega, xi), periods, np.array([flight_time]))
    return Word(omega, xi, "s", periods, unknowns[:, 0])


def one_flight(k: Spring, periods: int, t: Floats) -> Floats:
    """The unknowns (6, n) of the word "s" whose flights take t (n,) rad."""
    x = orbit(k, periods, t)
    sin, cos = np.sin(t), np.cos(t)
    return np.array(
        [x.q_land, x.v_land, x.c * cos - x.s * sin, x.c * sin + x.s * cos, TWO_PI * periods - t, t]
    )


def from_flights(
    omega: float, xi: float, gamma: float, takeoff_phase: Floats, flight_time: Floats, periods: int
) -> Word:
    """The word of a cycle, with a guess of its unknowns, from its flights, as a sweep records them.

    takeoff_phase, flight_time (flights,): rad, in order, of `periods` plate periods, with all flights,
    however short. Raises KernelInputError if they do not fill these periods or if every landing takes off at
    once.
    """
    check_spring(omega, xi, periods)
    takeoff_phase, flight_time = np.asarray(takeoff_phase, float), np.asarray(flight_time, float)
    if flight_time.ndim != 1 or flight_time.shape != takeoff_phase.shape or not len(flight_time):
        raise KernelInputError("flight_time", "must be (flights,), as takeoff_phase is, with one at least")
    if not (np.isfinite(flight_time).all() and np.isfinite(takeoff_phase).all() and gamma > 0.0):
        raise KernelInputError("flight_time", "must be finite, and gamma > 0")
    k = spring(omega, xi)
    contact = np.mod(np.roll(takeoff_phase, -1) - takeoff_phase - flight_time, TWO_PI)
    contact = np.where(contact > TWO_PI - _STICKS, 0.0, contact)
    # whole plate periods in contact are not in the phases: they go to the longest contact
    missing = round((TWO_PI * periods - flight_time.sum() - contact.sum()) / TWO_PI)
    contact[np.argmax(contact)] += TWO_PI * missing
    if missing < 0:
        raise KernelInputError("periods", f"{periods} are less than the flights take")
    sticks = contact > _STICKS
    if not sticks.any():
        raise KernelInputError("flight_time", "needs a landing that sticks; every one takes off at once")
    turn = int(np.flatnonzero(sticks)[-1]) + 1
    order = np.roll(np.arange(len(sticks)), -turn)
    letters = "".join("s" if sticks[i] else "z" for i in order)
    times = []
    for n, i in enumerate(order):
        if letters[n - 1] == "s":
            times.append(contact[order[n - 1]])
        times.append(flight_time[i])
    last = order[-1]
    phase = takeoff_phase[last] + flight_time[last]
    u = np.array([0.0, 0.0, gamma * np.cos(phase), gamma * np.sin(phase), *times])
    cycle = go_round(k, letters, periods, u[:, None])
    # linear in q and v
    u[:2] = -np.linalg.lstsq(cycle.slope[:, :2, 0], cycle.value[:, 0], rcond=None)[0]
    return Word(omega, xi, letters, periods, u)


def doubled(word: Word) -> Word:
    """The word gone through twice that begins at a flip of this one."""
    k = spring(word.omega, word.xi)
    times = word.unknowns[STATE:]
    u = np.concatenate([word.unknowns, times])
    letters, periods = 2 * word.letters, 2 * word.periods
    slope = go_round(k, letters, periods, u[:, None]).slope[..., 0]
    single = go_round(k, word.letters, word.periods, word.unknowns[:, None]).slope[..., 0]
    along = np.linalg.svd(single)[2][-1]
    along = np.concatenate([along, along[STATE:]])
    # two branches pass here: of the two directions without change, the one that is not the same twice
    direction = np.linalg.svd(np.vstack([slope, along]))[2][-1]
    flight_ = next(part.place for part in pieces(letters) if part.flies)
    if direction[flight_] < 0.0:  # its sign depends on the processor: the first flight is to be the longer
        direction = -direction
    return Word(word.omega, word.xi, letters, periods, u, direction)


def with_hop(word: Word, flight_: int) -> Word:
    """The word that begins where flight number `flight_` lands with n = 0: a "z" and a short flight."""
    letters = word.letters[:flight_] + "zs" + word.letters[flight_ + 1 :]
    place = next(x.place for x in pieces(word.letters) if x.flies and x.letter == flight_)
    return _inserted(word, letters, place + 1, place + 1, word.unknowns[place + 1 :])


def with_split_contact(word: Word, piece: int, time: float) -> Word:
    """The word that begins where n touches zero `time` rad after a contact began: a short flight there."""
    part = pieces(word.letters)[piece]
    letters = word.letters[: part.letter] + "s" + word.letters[part.letter :]
    rest = word.unknowns[part.place :].copy()
    rest[0] -= time
    return _inserted(word, letters, part.place, part.place + 1, rest, time)


def with_contact(word: Word, piece: int) -> Word:
    """The word that begins where n = 0 at the start of a flight after a "z": it sticks shortly before."""
    part = pieces(word.letters)[piece]
    letters = word.letters[: part.letter - 1] + "s" + word.letters[part.letter :]
    return _inserted(word, letters, part.place, part.place, word.unknowns[part.place :])


def _inserted(word: Word, letters: str, keep: int, place: int, rest: Floats, *times: float) -> Word:
    """With a piece of no time at `place` among the unknowns, the first step towards a longer one."""
    u = np.concatenate([word.unknowns[:keep], times, [0.0], rest])
    direction = np.zeros(len(u))
    direction[place] = 1.0
    return Word(word.omega, word.xi, letters, word.periods, u, direction)


def without(word: Word, piece: int) -> Word:
    """The word that goes on where a flight or a contact has shrunk to nothing.

    Raises KernelInputError if there is none.
    """
    part = pieces(word.letters)[piece]
    if not part.flies:  # the landing before takes off again at once
        landing = (part.letter - 1) % len(word.letters)
        others = [i for i, letter in enumerate(word.letters) if letter == "s" and i != landing]
        if not others:
            raise KernelInputError("word", "needs a landing that sticks")
        word = _begun_after(word, others[-1])
        landing = (landing - others[-1] - 1) % len(word.letters)
        place = next(x.place for x in pieces(word.letters) if not x.flies and x.letter == landing + 1)
        letters = word.letters[:landing] + "z" + word.letters[landing + 1 :]
        return word._replace(letters=letters, unknowns=np.delete(word.unknowns, place), direction=None)
    n = part.letter
    if part.power == 2:
        letters = word.letters[: n - 1] + word.letters[n:]
        return word._replace(letters=letters, unknowns=np.delete(word.unknowns, part.place), direction=None)
    if len(word.letters) == 1 or word.letters[n] == "z":
        raise KernelInputError("word", "the flight has no contact on both sides")
    word = _begun_after(word, (n - 1) % len(word.letters))
    u = np.delete(word.unknowns, [STATE + 1, STATE + 2])
    u[STATE] = word.unknowns[STATE : STATE + 3].sum()
    return word._replace(letters=word.letters[1:], unknowns=u, direction=None)


def _begun_after(word: Word, landing: int) -> Word:
    """The same cycle, its unknowns beginning after another landing that sticks."""
    if landing == len(word.letters) - 1:
        return word
    parts = pieces(word.letters)
    cycle = go_round(spring(word.omega, word.xi), word.letters, word.periods, word.unknowns[:, None])
    first = next(i for i, part in enumerate(parts) if not part.flies and part.letter == landing + 1)
    state = [x[0, 0] for x in cycle.starts[first]]
    times = np.roll(word.unknowns[STATE:], -first)
    letters = word.letters[landing + 1 :] + word.letters[: landing + 1]
    return word._replace(letters=letters, unknowns=np.array([*state, *times]), direction=None)
