"""Proofs for one cycle under any contact law, from its segments: that it exists, admissible and stable.

State (gap, gap', q, q', c, s, 1) with c + i s = Gamma exp(i phi), lengths in g/omega**2: every phase, landing
and contact law is linear in it, so that a phase of t rad is the exponential of a matrix times t. Words and
unknowns are those of `kernel.cycles.segments`: (gap', q, q', c, s) where the first segment begins, and the
duration of each. The events, the return after the periods, and Gamma or the first flight's duration are as
many equations. Krawczyk's operator maps a box into its inside: then exactly one solution lies in it.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from flint import arb, arb_mat, ctx

from kernel.proofs.balls import (
    Condition,
    NotCoveredError,
    NotProvenError,
    check_positive,
    contracts,
    flow,
    with_enough_bits,
)
from kernel.restitution import scalar_damping_ratio

if TYPE_CHECKING:
    from kernel.cycles.cycles import Point

#: Hops of one chatter at most.
_MOST_HOPS: Final = 400
#: Newton's steps.
STEPS: Final = 12
#: How far a proven cycle may lie from its guess, in any unknown.
_NEAR: Final = 5e-7

#: Places in a state; among unknowns the first is left out, and durations follow.
GAP, GAP1, Q, Q1, COS, SIN, ONE = range(7)
START: Final = 5


class Law(NamedTuple):
    """A contact law. A decimal string is that decimal, a float its 53 bits."""

    restitution: float | str = 0
    penetration: float | str | None = None  # None: an ideal plate
    adhesive: bool = True


class Guess(NamedTuple):
    """A cycle as computed with doubles."""

    word: str
    periods: int
    unknowns: Sequence[Any]  # (5 + segments,)


class Proven(NamedTuple):
    """What holds for certain of exactly one cycle in these balls."""

    says: str
    gamma: arb
    flight_times: list[arb]  # rad


def guess_of(point: "Point") -> Guess:
    """A cycle of `kernel.cycles.cycles`, begun where the mass sticks after a chatter, if it does."""
    point = point.begun((point.letters.find("c") + 1) % len(point.letters))
    return Guess(point.letters, point.cycles.periods, point.x[: START + len(point.letters)].tolist())


def prove_cycle(law: Law, gamma: float | str, omega: float | str, xi: float | str, guess: Guess) -> Proven:
    """That a stable cycle exists beside a guess. Raises `NotProvenError` and its kinds."""

    def prove() -> Proven:
        cycles = Cycles(law, omega, xi, guess)
        box = cycles.box(arb(gamma))
        if not all(abs(ball - known) < _NEAR for ball, known in zip(box, cycles.guess, strict=True)):
            raise NotProvenError("no cycle is so near")
        return cycles.stable(
            box, "a cycle with these flights exists, alone in its box, admissible and stable"
        )

    return with_enough_bits(prove)


class _Segment(NamedTuple):
    motion: arb_mat  # (7, 7)
    event: arb_mat  # (1, 7) zero where it ends
    reset: arb_mat  # (7, 7)
    conditions: list[list[Condition]]  # of each, one is positive at every instant


class Cycles:
    """The cycles of one word in a spring, at the present precision."""

    def __init__(self, law: Law, omega: float | str, xi: float | str, guess: Guess) -> None:
        self.e, self._adhesive = arb(law.restitution), law.adhesive
        self.b, self.w = b, w = 2 * arb(xi) / arb(omega), 1 / arb(omega) ** 2
        flight: list[list[Any]] = [
            [0, 1, 0, 0, 0, 0, 0],
            [0, 0, w, b, 1, 0, -1],
            [0, 0, 0, 1, 0, 0, 0],
            [0, 0, -2 * w, -2 * b, 0, 0, 0],
            [0, 0, 0, 0, 0, -1, 0],
            [0, 0, 0, 0, 1, 0, 0],
            [0] * 7,
        ]
        self.flight, self._up = arb_mat(flight), arb_mat([[1, 0, 0, 0, 0, 0, 0]])
        if law.penetration is None:
            self._force = arb_mat([[0, 0, -w, -b, -1, 0, 1]])
            self.contact = arb_mat([[0] * 7, [0] * 7, flight[2], [0, 0, -w, -b, 1, 0, -1], *flight[4:]])
        else:
            # the gap in units of the scale: both rates of a contact are then that, not its square
            scale, damping = 1 / arb(law.penetration), _damping_ratio(law)
            self.flight[GAP, GAP1] = scale
            self._force = arb_mat([[-scale, -2 * damping * scale, 0, 0, 0, 0, 0]])
            self.contact = self.flight + arb_mat(7, 1, [0, 1, 0, -1, 0, 0, 0]) * self._force
        # the gap is zero where a flight ends: setting it keeps errors of one hop out of the next
        self._hop = arb_mat(7, 7, 1)
        self._hop[GAP, GAP], self._hop[GAP1, GAP1], self._hop[Q1, GAP1] = 0, -self.e, 1 + self.e
        self._stick = arb_mat(self._hop)
        self._stick[GAP1, GAP1], self._stick[Q1, GAP1] = 0, 1
        self.word, self.periods, self.guess = guess.word, guess.periods, [arb(x) for x in guess.unknowns]
        if "c" in self.word:
            self._follow_hops()
        self._segments = [self._segment(i) for i in range(len(self.word))]

    def _segment(self, i: int) -> _Segment:
        letter, before, up, force = self.word[i], self.word[i - 1], self._up, self._force
        if letter in "Shcsz" and (letter == "S") != (before in "sc"):
            raise NotProvenError(f"{letter} after {before}: no motion has the word {self.word}")
        sided = letter == "C" and not self._adhesive
        motion = self.contact if letter in "SC" else self.flight
        event = force if letter in "Sb" or sided else up
        reset = self._hop if letter == "h" else self._stick if letter in "csz" else arb_mat(7, 7, 1)
        if letter in "Sb":
            conditions = [[Condition(force if letter == "S" else -force, int(letter == "b"), True)]]
        elif sided:
            below = int(before == "b")
            conditions = [[Condition(-up, 1 - below, False)], [Condition(force, below, True)]]
        elif letter == "C":
            conditions = [[Condition(-up, 1, True)]]
        elif letter == "F" and not self._adhesive:
            conditions = [[Condition(up, 0, True), Condition(-force, 1, False)]]
        else:
            conditions = [[Condition(up, {"S": 3, "z": 2}.get(before, 1), True)]]
        return _Segment(motion, event, reset, conditions)

    def _follow_hops(self) -> None:
        """Take in the hops until they leave at less than the root of the widest box, from the guess in order.

        In the guess the mass sticks where the rest of a chatter is summed on, here after the last hop.
        """
        if self.word[0] != "S":
            raise NotCoveredError("a cycle that does not begin where the mass sticks")
        y, word, times, late = _start(self.guess), "", list[arb](), arb(0)
        for i, letter in enumerate(self.word, START):
            motion, event = (self.contact, self._force) if letter == "S" else (self.flight, self._up)
            t, y = _end(motion, event, y, self.guess[i] - late)
            late = arb(0)
            while letter == "c" and not abs(y[GAP1, 0]) < arb(2) ** (-ctx.prec // 6):
                word, times, y = word + "h", [*times, t], (self._hop * y).mid()
                n = (self._force * y)[0, 0]
                if not n > 0 or len(word) > _MOST_HOPS:
                    raise NotCoveredError(f"a chatter of more than {_MOST_HOPS} hops, or without an end")
                t, y = _end(motion, event, y, 2 * y[GAP1, 0] / n)
                late = late + t
            word, times = word + letter, [*times, t]
            if letter != "S":
                y = ((self._hop if letter == "h" else self._stick) * y).mid()
        start = (flow(self.contact, late) * _start(self.guess)).mid().entries()
        times[0] = (times[0] - late).mid()
        self.word, self.guess = word, [arb(0), *start[Q:ONE], *times]

    def box(self, given: arb, *, by_flight: bool = False) -> list[arb]:
        """A box with exactly one cycle of this Gamma, or of each first flight in this ball (Krawczyk)."""
        self._given, self._by_flight = given, by_flight
        x = self.guess
        for _ in range(STEPS):
            value, slope = self._residual(x)
            step = slope.mid().solve(value.mid()).entries()
            x = [(old - change).mid() for old, change in zip(x, step, strict=True)]
            if all(abs(change) < arb(2) ** (-ctx.prec // 2) for change in step):
                break
        value, slope = self._residual(x)
        inverse, m = slope.mid().inv().mid(), len(x)
        move = inverse * value
        radius = arb(2) ** (-ctx.prec // 3) + 4 * max((t.abs_upper() for t in move.entries()), key=float)
        box = [middle + arb(0, radius) for middle in x]
        left = arb_mat(m, m, 1) - inverse * self._residual(box)[1]
        inner = (arb_mat(m, 1, x) - move + left * arb_mat(m, 1, [arb(0, radius)] * m)).entries()
        if not all(outer.contains_interior(ball) for outer, ball in zip(box, inner, strict=True)):
            raise NotProvenError("no box is mapped into its inside")
        return inner

    def _residual(self, x: Sequence[arb]) -> tuple[arb_mat, arb_mat]:
        """The equations (m, 1) at unknowns and their Jacobian (m, m)."""
        m = len(x)
        y = start = _start(x)
        d = first = arb_mat([[int(row == j + 1 < ONE) for j in range(m)] for row in range(7)])
        values, rows = list[Any](), list[list[Any]]()
        for j, segment in enumerate(self._segments, START):
            whole = flow(segment.motion, x[j])
            y, d = whole * y, whole * d
            along = segment.motion * y
            for row in range(7):
                d[row, j] = d[row, j] + along[row, 0]
            values.append((segment.event * y)[0, 0])
            rows.append((segment.event * d).entries())
            of_state, of_slope = self._resets(j - START, y)
            y, d = of_state * y, of_slope * d
        values += [*(y - start).entries()[GAP1:COS], sum(x[START:]) - 2 * self.periods * arb.pi()]
        rows += [*(d - first).tolist()[GAP1:COS], [int(j >= START) for j in range(m)]]
        if self._by_flight:
            flies = START + next(i for i, letter in enumerate(self.word) if letter not in "SC")
            values.append(x[flies] - self._given)
            rows.append([int(j == flies) for j in range(m)])
        else:
            c, s = x[COS - 1 : START]
            values.append(c * c + s * s - self._given**2)
            rows.append([0, 0, 0, 2 * c, 2 * s, *[0] * len(self.word)])
        return arb_mat(m, 1, values), arb_mat(rows)

    def _resets(self, i: int, y: arb_mat) -> tuple[arb_mat, arb_mat]:
        """What follows segment i, of the state (7, 7) and of its derivatives.

        With restitution e > 0 a mass sticks after hops without end, the last from h on. In Q = q + gap and
        u = q' + gap', which no hop changes, they are Q' = u, u' = c - 1 - b u - w Q + (b gap' + w gap): a
        stuck spring but for a forcing. They take no longer than `time`: under forces between `least` and its
        9/8 a hop takes 2 h/least at most, and the next begins with e h (1 + (1 - e)/4) at most. What they add
        to (Q, u) is the forcing's integral, carried back to the landing; by parts, that of the gap with a
        factor below 2 rates**2. The gap is at most h**2/(2 least). Its derivatives by h, by the instants of
        landings and by the state are of the order h/least: over all hops their sums are geometric too.
        """
        reset = self._segments[i].reset
        if self.word[i] != "c":
            return reset, reset
        h, rates, after = abs(self.e * y[GAP1, 0]).upper(), 1 + self.b + self.w, reset * y
        time = 4 * h / ((self._force * after)[0, 0] * (1 - self.e))
        nearby = flow(self.contact, arb(0).union(time)) * after
        n = (self._force * nearby)[0, 0] + arb(0, 2 * rates * (h + time))
        change, least = n.upper() - n.lower(), n.lower()
        if not (change < least * (1 - self.e) / 8 and change < (1 - self.e) / 8):
            raise NotProvenError("the force during a chatter")
        size = rates * rates * h * time / least
        value, slope = arb(0, 2 * h * size), arb(0, 100 * size / (1 - self.e))
        hit = arb_mat(7, 1, [0, 0, 1, 1, 0, 0, 0])
        return reset + hit * arb_mat([[0] * 6 + [value]]), reset + hit * arb_mat([[0, *[slope] * 5, 0]])

    def stable(self, box: Sequence[arb], says: str) -> Proven:
        """What is said of the cycle in a box, if it is admissible and a power of its tangent contracts."""
        self.check_admissible(box)
        if not contracts(self._tangent(box)):
            raise NotProvenError("no power of the tangent map contracts")
        flights = [t for t, letter in zip(box[START:], self.word, strict=True) if letter not in "SC"]
        return Proven(says, amplitude(box), flights)

    def check_admissible(self, box: Sequence[arb]) -> None:
        """Prove that every segment of the cycles in a box ends where it says, and not before."""
        y = _start(box)
        for i, (letter, segment, t) in enumerate(zip(self.word, self._segments, box[START:], strict=True)):
            try:
                if not t > 0:
                    raise NotProvenError("its duration")
                for conditions in segment.conditions:
                    check_positive(segment.motion, conditions, y, t, stiff=letter == "C")
            except NotProvenError as why:
                raise type(why)(f"segment {i} ({letter}): {why}") from None
            y = flow(segment.motion, t) * y
            y = self._resets(i, y)[0] * y

    def _tangent(self, box: Sequence[arb]) -> arb_mat:
        """The derivative (4, 4) of the return by (gap', q, q', phase): the events make durations functions.

        Enclosed as a whole: carried from hop to hop, balls would grow in each.
        """
        rows, n = self._residual(box)[1].tolist(), len(self.word)
        turn = arb_mat([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, -box[4]], [0, 0, 0, box[3]]])
        by_start = (arb_mat([row[:START] for row in rows]) * turn).tolist()
        by_time = [row[START:] for row in rows]
        delays = -arb_mat(by_time[:n]).solve(arb_mat(by_start[:n]))
        back = slice(n, n + 4)
        return arb_mat(by_start[back]) + arb_mat(by_time[back]) * delays + arb_mat(4, 4, 1)


def amplitude(box: Sequence[arb]) -> arb:
    """Gamma of a box of unknowns."""
    return (box[COS - 1] ** 2 + box[SIN - 1] ** 2).sqrt()


def _start(x: Sequence[arb]) -> arb_mat:
    """The state (7, 1) where the first segment begins."""
    return arb_mat(7, 1, [0, *x[:START], 1])


def _end(motion: arb_mat, row: arb_mat, y: arb_mat, t: arb) -> tuple[arb, arb_mat]:
    """A guess of the time beside t at which row . exp(motion t) y is zero, and that state (Newton)."""
    for _ in range(STEPS):
        state = flow(motion, t) * y
        t = (t - (row * state)[0, 0] / (row * (motion * state))[0, 0]).mid()
    return t, flow(motion, t) * y


def _damping_ratio(law: Law) -> arb:
    """Of a soft contact. That of the nonadhesive law is the kernel's double."""
    if not law.adhesive:
        return arb(scalar_damping_ratio(float(law.restitution), False))
    loss = -arb(law.restitution).log()
    return loss / (arb.pi() ** 2 + loss * loss).sqrt() if float(law.restitution) else arb(1)
