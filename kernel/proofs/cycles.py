"""Proofs for one cycle under any contact law, from its segments: that it exists, admissible and stable.

A word has a letter for each segment, as in `kernel.branches.segments`, from one that begins after a landing.
Unknowns are the state and the phase where
the first segment begins and the duration of every segment; the events and the return after the periods are
as many equations. Krawczyk's operator maps a box of them into its inside: the box holds exactly one solution.

With restitution e > 0 a mass sticks after hops without end. Hops are segments until they leave at less than
_LAST_HOP; what the rest does is enclosed. In Q = q + gap and u = q' + gap', which no hop changes, it is

    Q' = u,  u' = c - 1 - b u - w Q + (b gap' + w gap):

a stuck spring but for the integral of a smooth function times the gap, since b gap' can be integrated by
parts over each hop. After a hop at speed h the gap is at most h**2/(2 n), and the rest takes at most
2 h/(n (1 - e)).
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from flint import acb, arb, arb_mat, ctx
from numpy.typing import NDArray

from kernel.proofs.balls import (
    Condition,
    NotCoveredError,
    NotProvenError,
    around,
    check_positive,
    column,
    contracts,
    entries,
    exact,
    flight_rows,
    flow,
    identity,
    matrix,
    total,
    with_enough_bits,
)
from kernel.restitution import scalar_damping_ratio

if TYPE_CHECKING:
    from kernel.branches.cycles import Point

#: Velocity of a hop from which on the rest of a chatter is enclosed, in g/omega per rad.
_LAST_HOP: Final = 1e-18
#: Hops of one chatter at most: e = 0.95 takes a thousand.
_MOST_HOPS: Final = 400

#: Newton's steps; how far it may leave the start.
_STEPS: Final = 12
_NEAR: Final = 1e-3

#: Order of the gap's root where a flight on an ideal plate begins, by the segment before it.
_TAKEOFF_ROOTS: Final = {"S": 3, "z": 2, "h": 1}

GAP, GAP1, Q, Q1, COS, SIN, ONE = range(7)


class Law(NamedTuple):
    """A contact law. A decimal string is that decimal, a float its 53 bits."""

    restitution: float | str = 0
    penetration: float | str | None = None  # None: an ideal plate
    adhesive: bool = True


class Guess(NamedTuple):
    """A cycle as computed with doubles, lengths in g/omega**2."""

    word: str
    periods: int
    gap1: float  # where its first segment begins
    q: float
    q1: float
    phase: float  # rad
    durations: Sequence[float]  # (segments,) rad


def guess_of(point: "Point") -> Guess:
    """A cycle of `kernel.branches.cycles`, begun where the mass sticks after a chatter, if it does."""
    chatter = point.letters.find("c")
    point = point.begun((chatter + 1) % len(point.letters))
    gap1, q, q1 = point.x[:3].tolist()
    return Guess(point.letters, point.cycles.periods, gap1, q, q1, point.phase, point.times.tolist())


class ProvenCycle(NamedTuple):
    """What holds for certain: exactly one such cycle lies in these balls."""

    word: str
    periods: int
    phase: arb  # rad, of the plate where the first segment begins
    durations: list[arb]  # (segments,) rad
    flight_times: list[arb]  # rad
    tangent: arb_mat  # (m, m) of the return to the first segment's start
    stable: bool  # whether a power of the tangent contracts; False says nothing


class _Segment(NamedTuple):
    """A phase and how it ends."""

    motion: arb_mat  # (7, 7)
    event: arb_mat  # (1, 7) zero where it ends
    reset: arb_mat  # (7, 7)
    conditions: tuple[tuple[Condition, ...], ...]  # of each, one is positive at every instant
    chatters: bool = False  # whether hops without end follow its landing


def prove_cycle(
    law: Law, gamma: float | str, omega: float | str, xi: float | str, guess: Guess, *, stable: bool = True
) -> ProvenCycle:
    """The cycle beside a guess, with a proof that it exists, alone there, that it is admissible and stable.

    stable: whether its stability is part of the statement. Raises `NotProvenError` and its kinds.
    """

    def prove() -> ProvenCycle:
        cycle = _Cycle(law, gamma, omega, xi, guess)
        box = cycle.solve()
        cycle.check_admissible(box)
        tangent = cycle.tangent(box)
        contracting = contracts(tangent)
        if stable and not contracting:
            raise NotProvenError("no power of the tangent map contracts")
        return cycle.described(box, tangent, contracting)

    return with_enough_bits(prove)


def jacobian(
    law: Law, gamma: float | str, omega: float | str, xi: float | str, guess: Guess
) -> NDArray[np.float64]:
    """Of a cycle's equations (m, m) at a guess, by its free state, phase and durations."""
    cycle = _Cycle(law, gamma, omega, xi, guess)
    return np.array([[float(entry) for entry in row] for row in cycle.residual(cycle.guess)[1].tolist()])


class _Cycle:
    """The equations of a word."""

    def __init__(
        self, law: Law, gamma: float | str, omega: float | str, xi: float | str, guess: Guess
    ) -> None:
        self.gamma, self.e, omega_ball = exact(gamma), exact(law.restitution), exact(omega)
        self.b, self.w = 2 * exact(xi) / omega_ball, 1 / (omega_ball * omega_ball)
        self.adhesive = law.adhesive
        word = guess.word
        # where the mass has the plate's velocity, gap' is no unknown
        self.free = (Q, Q1) if word[-1] in "csz" else (GAP1, Q, Q1)
        start = {GAP1: guess.gap1, Q: guess.q, Q1: guess.q1}
        known = [arb(value) for value in (*(start[i] for i in self.free), guess.phase)]
        durations = [arb(t) for t in guess.durations]
        self._build(law)
        if "c" in word:
            word, known, durations = self._with_hops(word, known, durations)
        self.word, self.periods = word, guess.periods
        self.segments = [self._segment(word, i) for i in range(len(word))]
        self.guess = known + durations

    def _build(self, law: Law) -> None:
        b, w = self.b, self.w
        flight = flight_rows(b, w)
        self.up = matrix([[1, 0, 0, 0, 0, 0, 0]])
        if law.penetration is not None:
            kappa, beta = _contact_constants(law)
            force: list[Any] = [-kappa, -beta, 0, 0, 0, 0, 0]
            touching = [list(row) for row in flight]
            for i in (GAP, GAP1):
                touching[GAP1][i] = touching[GAP1][i] + force[i]
                touching[Q1][i] = touching[Q1][i] - force[i]
            # the gap in units of 1/sqrt(kappa): both rates of a contact are then sqrt(kappa), not kappa
            scale = kappa.mid().sqrt().mid()
            self.flight, self.contact = _scaled(flight, scale), _scaled(touching, scale)
            force[GAP] = force[GAP] / scale
        else:
            force = [0, 0, -w, -b, -1, 0, 1]
            still = [[0] * 7, [0] * 7, flight[2], [0, 0, -w, -b, 1, 0, -1], *flight[4:]]
            self.flight, self.contact = matrix(flight), matrix(still)
        self.force = matrix([force])
        # the gap is zero where a flight ends: setting it keeps errors of one hop out of the next
        self.stick, self.hop = identity(7), identity(7)
        self.stick[GAP, GAP], self.hop[GAP, GAP] = 0, 0
        self.stick[GAP1, GAP1], self.stick[Q1, GAP1] = 0, 1
        self.hop[GAP1, GAP1], self.hop[Q1, GAP1] = -self.e, 1 + self.e

    def _segment(self, word: str, i: int) -> _Segment:
        letter, before = word[i], word[i - 1]
        up, down, force, pull = self.up, -1 * self.up, self.force, -1 * self.force
        same = identity(7)
        if letter == "S":
            return _Segment(self.contact, force, same, ((Condition(force, 0, True),),))
        if letter == "C" and self.adhesive:
            return _Segment(self.contact, up, same, ((Condition(down, 1, True),),))
        if letter == "C":
            below = int(before == "b")
            sides = ((Condition(down, 1 - below, False),), (Condition(force, below, True),))
            return _Segment(self.contact, force, same, sides)
        if letter == "b":
            return _Segment(self.flight, force, same, ((Condition(pull, 1, True),),))
        if letter == "F" and self.adhesive:
            return _Segment(self.flight, up, same, ((Condition(up, 1, True),),))
        if letter == "F":
            return _Segment(self.flight, up, same, ((Condition(up, 0, True), Condition(pull, 1, False)),))
        if before not in _TAKEOFF_ROOTS:
            raise NotCoveredError(f"a flight after {before!r} in the word {word}")
        order = _TAKEOFF_ROOTS[before]
        reset = self.hop if letter == "h" else self.stick
        return _Segment(self.flight, up, reset, ((Condition(up, order, True),),), chatters=letter == "c")

    def _with_hops(
        self, word: str, known: list[arb], durations: list[arb]
    ) -> tuple[str, list[arb], list[arb]]:
        """Word, state and durations with all hops to _LAST_HOP, computed from the guess in order.

        In the guess the mass sticks from where the rest of a chatter is summed on, here after the last hop.
        """
        if word[0] != "S":
            raise NotCoveredError("a cycle that does not begin where the mass sticks")
        y, letters, times, late = self.start(known), "", list[arb](), arb(0)
        for i, letter in enumerate(word):
            motion, event = (self.contact, self.force) if letter == "S" else (self.flight, self.up)
            end = _root(motion, event, y, durations[i] - late)
            y, late = flow(motion, end) * y, arb(0)
            while letter == "c" and not abs(y[GAP1, 0]) < _LAST_HOP:
                letters, times = letters + "h", [*times, end]
                y = (self.hop * y).mid()
                n = (self.force * y)[0, 0]
                if not n > 0 or len(letters) > _MOST_HOPS:
                    raise NotCoveredError(f"a chatter of more than {_MOST_HOPS} hops, or without an end")
                end = _root(self.flight, self.up, y, 2 * y[GAP1, 0] / n)
                y, late = flow(self.flight, end) * y, late + end
            if letter != "S":
                y = (self.hop if letter == "h" else self.stick) * y
            letters, times, y = letters + letter, [*times, end], y.mid()
        times[0] = (times[0] - late).mid()
        phase = acb(y[COS, 0], y[SIN, 0]).arg().mid()
        return letters, [y[Q, 0], y[Q1, 0], phase], times

    def start(self, unknowns: Sequence[arb]) -> arb_mat:
        """The state (7, 1) where the first segment begins."""
        y = [arb(0)] * 7
        for value, i in zip(unknowns, self.free, strict=False):
            y[i] = value
        phase = unknowns[len(self.free)]
        y[COS], y[SIN], y[ONE] = self.gamma * phase.cos(), self.gamma * phase.sin(), arb(1)
        return column(y)

    def residual(self, x: Sequence[arb]) -> tuple[arb_mat, arb_mat]:
        """The equations (m, 1) at unknowns and their Jacobian (m, m)."""
        states, m = len(self.free), len(x)
        y = first = self.start(x)
        d = arb_mat(7, m)
        for j, i in enumerate(self.free):
            d[i, j] = arb(1)
        d[COS, states], d[SIN, states] = -y[SIN, 0], y[COS, 0]
        d0 = arb_mat(d)
        values, rows = [], []
        for i, segment in enumerate(self.segments):
            whole = flow(segment.motion, x[states + 1 + i])
            y, d = whole * y, whole * d
            along = segment.motion * y
            for r in range(7):
                d[r, states + 1 + i] = d[r, states + 1 + i] + along[r, 0]
            values.append((segment.event * y)[0, 0])
            rows.append((segment.event * d).tolist()[0])
            y, d = self._reset(segment, y, d)
        for i in self.free:
            values.append(y[i, 0] - first[i, 0])
            rows.append([d[i, j] - d0[i, j] for j in range(m)])
        values.append(total(x[states + 1 :]) - 2 * self.periods * arb.pi())
        rows.append([arb(0)] * (states + 1) + [arb(1)] * len(self.segments))
        return column(values), matrix(rows)

    def _reset(self, segment: _Segment, y: arb_mat, d: arb_mat) -> tuple[arb_mat, arb_mat]:
        """State and derivatives after the segment, with what the rest of a chatter may add."""
        after, moved = segment.reset * y, segment.reset * d
        if segment.chatters:
            value, slope = self._rest_of_chatter(y, after)
            for i in (Q, Q1):
                after[i, 0] = around(after[i, 0], value)
                for j in range(d.ncols()):
                    size = total(abs(d[r, j]) for r in range(GAP1, ONE))
                    moved[i, j] = around(moved[i, j], slope * size)
        return after, moved

    def _rest_of_chatter(self, y: arb_mat, after: arb_mat) -> tuple[arb, arb]:
        """Bounds of what hops without end add to (q, q'), and to its derivatives by the state before them.

        In hops at speed h under n from `least` to `most` a flight takes at most 2 h/least, and the next speed
        grows with h by at most e (1 + 2 (most - least)/least) < 1. So the rest's flights are summable with
        their derivatives; each adds its integral of the gap, a third power of its time.
        """
        rates = 1 + self.b + self.w
        hop = abs(self.e * y[GAP1, 0]).upper()
        n = (self.force * after)[0, 0]
        time = 8 * hop / (n * (1 - self.e))
        turn = abs((self.force * (self.contact * after))[0, 0]) + 1
        change = turn * time + rates * hop
        least, most = n.lower() - change.upper(), n.upper() + change.upper()
        if not (least > 0 and hop < 10 * _LAST_HOP):
            raise NotProvenError("the force during a chatter")
        shrinks = self.e * (1 + 2 * (most - least) / least)
        if not shrinks < 1:
            raise NotProvenError("hops that may not shrink")
        time = 2 * hop / (least * (1 - shrinks))
        value = 4 * rates * rates * hop * hop / (2 * least) * time
        slope = 100 * rates * rates * (1 + most / least) ** 2 * (1 + rates / least) * time / (1 - shrinks)
        return value.upper(), slope.upper()

    def solve(self) -> list[arb]:
        """A box that holds exactly one solution (Krawczyk)."""
        x = self._newton()
        m = len(x)
        value, slope = self.residual(x)
        try:
            inverse = slope.mid().inv().mid()
        except ZeroDivisionError:
            raise NotProvenError("a singular Jacobian") from None
        move = entries(inverse * value)
        states = len(self.free) + 1
        sizes = [arb(1)] * states + [min(arb(1), abs(t).upper(), key=float) for t in x[states:]]
        widest = max((step.abs_upper() / size for step, size in zip(move, sizes, strict=True)), key=float)
        radii = [((4 * widest + arb(2) ** (-ctx.prec // 3)) * size).upper() for size in sizes]
        box = [around(middle, radius) for middle, radius in zip(x, radii, strict=True)]
        left = identity(m) - inverse * self.residual(box)[1]
        spread = entries(left * column([arb(0, radius) for radius in radii]))
        inner = [middle - step + change for middle, step, change in zip(x, move, spread, strict=True)]
        if not all(outer.contains_interior(ball) for outer, ball in zip(box, inner, strict=True)):
            raise NotProvenError("no box is mapped into its inside")
        return inner

    def _newton(self) -> list[arb]:
        """The middle of a solution."""
        x, small = self.guess, arb(2) ** (-ctx.prec // 2)
        for _ in range(_STEPS):
            value, slope = self.residual(x)
            try:
                step = entries(slope.mid().solve(value.mid()))
            except ZeroDivisionError:
                raise NotProvenError("a singular Jacobian") from None
            x = [(old - change).mid() for old, change in zip(x, step, strict=True)]
            if all(abs(change) < small for change in step):
                break
        if not all(abs(new - old) < _NEAR for new, old in zip(x, self.guess, strict=True)):
            raise NotProvenError("Newton's method left the guess")
        return x

    def check_admissible(self, box: Sequence[arb]) -> None:
        """Prove that every segment of the cycle in a box ends where it says, and not before."""
        y = self.start(box)
        for i, (segment, t) in enumerate(zip(self.segments, box[len(self.free) + 1 :], strict=True)):
            if not t > 0:
                raise NotProvenError(f"segment {i} ({self.word[i]}): its duration")
            for conditions in segment.conditions:
                try:
                    check_positive(segment.motion, conditions, y, t, stiff=self.word[i] == "C")
                except NotProvenError as why:
                    raise type(why)(f"segment {i} ({self.word[i]}): {why}") from None
            y = flow(segment.motion, t) * y
            y = self._reset(segment, y, arb_mat(7, 0))[0]

    def tangent(self, box: Sequence[arb]) -> arb_mat:
        """The derivative (m, m) of the return to the first segment's start, by its state and phase.

        The events make the durations functions of these. Enclosed as a whole: carried from hop to hop, balls
        would grow in each.
        """
        m = len(self.free) + 1
        rows = self.residual(box)[1].tolist()
        n = len(self.segments)
        by_start = matrix([row[:m] for row in rows[:n]])
        by_time = matrix([row[m:] for row in rows[:n]])
        delays = -1 * _solution(by_time, by_start, [abs(t).upper() for t in box[m:]])
        ends = matrix([row[:m] for row in rows[n:-1]]) + matrix([row[m:] for row in rows[n:-1]]) * delays
        phase = [total(delays[i, j] for i in range(n)) for j in range(m)]
        return matrix([*ends.tolist(), phase]) + identity(m)

    def described(self, box: Sequence[arb], tangent: arb_mat, stable: bool) -> ProvenCycle:
        states = len(self.free)
        durations = list(box[states + 1 :])
        flown = [t for t, letter in zip(durations, self.word, strict=True) if letter not in "SC"]
        return ProvenCycle(self.word, self.periods, box[states], durations, flown, tangent, stable)


def _solution(a: arb_mat, b: arb_mat, sizes: Sequence[arb]) -> arb_mat:
    """The solution x of a x = b, whose rows are of these sizes. Raises `NotProvenError`."""
    try:
        inverse = a.mid().inv().mid()
    except ZeroDivisionError:
        raise NotProvenError("an event that may graze") from None
    middle = (inverse * b).mid()
    rest, left = inverse * (b - a * middle), identity(a.nrows()) - inverse * a
    shares = [
        total(abs(left[i, k]) * size for k, size in enumerate(sizes)) / sizes[i] for i in range(len(sizes))
    ]
    share = max((each.upper() for each in shares), key=float)
    if not share < 1:
        raise NotProvenError("an event that may graze")
    for j in range(b.ncols()):
        widest = max((abs(rest[i, j]) / size for i, size in enumerate(sizes)), key=_upper)
        radius = widest.upper() / (1 - share)
        for i, size in enumerate(sizes):
            middle[i, j] = around(middle[i, j], radius * size)
    return middle


def _scaled_rows(a: arb_mat, sizes: Sequence[arb]) -> list[list[arb]]:
    """The rows of a map between vectors whose entries are of these sizes, in units of them."""
    return [
        [entry * size / own for entry, size in zip(row, sizes, strict=True)]
        for row, own in zip(a.tolist(), sizes, strict=True)
    ]


def _upper(ball: arb) -> float:
    return float(ball.upper())


def _contact_constants(law: Law) -> tuple[arb, arb]:
    """kappa and beta of a soft contact. The damping ratio of the nonadhesive law is the kernel's double."""
    assert law.penetration is not None
    d, e = exact(law.penetration), exact(law.restitution)
    if law.adhesive:
        loss = -e.log()
        zeta = arb(1) if float(law.restitution) == 0.0 else loss / (arb.pi() ** 2 + loss * loss).sqrt()
    else:
        zeta = arb(scalar_damping_ratio(float(law.restitution), False))
    return 1 / (d * d), 2 * zeta / d


def _scaled(rows: Sequence[Sequence[Any]], scale: arb) -> arb_mat:
    """The matrix of a motion for scale * gap in place of the gap."""
    scaled = matrix(rows)
    for i in range(1, 7):
        scaled[GAP, i], scaled[i, GAP] = scaled[GAP, i] * scale, scaled[i, GAP] / scale
    return scaled


def _root(motion: arb_mat, row: arb_mat, y: arb_mat, t: arb) -> arb:
    """The time beside t at which row . exp(motion t) y is zero, by Newton's method: a guess."""
    for _ in range(60):
        state = flow(motion, t) * y
        step = ((row * state)[0, 0] / (row * (motion * state))[0, 0]).mid()
        t = (t - step).mid()
        if abs(step) <= abs(t) * arb(2) ** (8 - ctx.prec) or not math.isfinite(float(step)):
            break
    return t
