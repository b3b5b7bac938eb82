"""Proofs that one cycle exists under a contact law, is admissible and is stable, from its segments.

The state is (gap, gap', q, q', c, s, 1) with c + i s = Gamma exp(i phi) and lengths in g/omega**2. Every
phase, landing and contact law is linear in it: a phase of t rad is the exponential of a matrix times t. Words
and unknowns are those of `kernel.cycles.segments`: (gap', q, q', c, s) where the first segment begins, and
the duration of each segment. There are as many equations: the events, the return after the periods, and a
given Gamma or first flight. A box that Newton's operator maps into itself contains exactly one solution.
"""

from collections.abc import Sequence
from itertools import accumulate, compress
from typing import Any, Final, NamedTuple

from flint import arb, arb_mat, ctx

from kernel.cycles.folds import Cycle
from kernel.params import Cell
from kernel.proofs import balls
from kernel.proofs.balls import Condition, NotProvenError, exact, flow
from kernel.restitution import scalar_damping_ratio

_MOST_HOPS: Final = 400  # of one chatter
_MOST_SEGMENTS: Final = 500  # of a cycle; the work grows as their third power
_STEPS: Final = 16  # limit on Newton steps
_NEAR: Final = 5e-7  # largest distance of a proven cycle from its guess, in its start and in any instant

#: Places in a state. The unknowns lack the first, and the durations follow.
GAP, GAP1, Q, Q1, COS, SIN, ONE = range(7)
START: Final = 5


class Law(NamedTuple):
    """A contact law."""

    restitution: float = 0.0
    penetration: float | None = None  # None: an ideal plate
    adhesive: bool = True


class Proven(NamedTuple):
    """A statement that is proven for the one cycle in these balls."""

    says: str
    gamma: arb
    flight_times: list[arb]  # rad


def prove_cycle(law: Law, cell: Cell, guess: Cycle) -> Proven:
    """Prove that a stable cycle exists near a guess that begins at a take-off. Raises `NotProvenError`."""
    says = "a cycle with these flights exists, alone in its box, admissible and stable"

    def prove() -> Proven:
        cycles = Cycles(law, cell.omega, cell.xi, guess)
        box = cycles.box(exact(cell.gamma))
        instants = compress(accumulate(box[START:]), cycles.ends)
        guessed = [*guess.unknowns[:START].tolist(), *accumulate(guess.unknowns[START:].tolist())]
        if not all(abs(x - y) < _NEAR for x, y in zip([*box[:START], *instants], guessed, strict=True)):
            raise NotProvenError("no cycle is so near")
        return cycles.stable(box, says)

    return balls.first_proven(prove)


class _Segment(NamedTuple):
    letter: str
    motion: arb_mat  # (7, 7)
    event: arb_mat  # (1, 7) zero where it ends
    reset: arb_mat  # (7, 7)
    conditions: list[list[Condition]]  # one of each list is positive at every instant


class Cycles:
    """The cycles of a word in a spring, at the present precision.

    Raises `NotProvenError` if no motion has the word.
    """

    def __init__(self, law: Law, omega: float, xi: float, guess: Cycle) -> None:
        self._e, self._sided = exact(law.restitution), law.penetration is not None and not law.adhesive
        self.b, self.w = b, w = 2 * exact(xi) / exact(omega), 1 / exact(omega) ** 2
        rates: dict[tuple[int, int], Any] = {
            (GAP, GAP1): 1, (GAP1, Q): w, (GAP1, Q1): b, (GAP1, COS): 1, (GAP1, ONE): -1, (COS, SIN): -1,
            (Q, Q1): 1, (Q1, Q): -2 * w, (Q1, Q1): -2 * b, (SIN, COS): 1,
        }  # fmt: skip
        self.flight, self._up = arb_mat(7, 7), arb_mat([[1, 0, 0, 0, 0, 0, 0]])
        for place, rate in rates.items():
            self.flight[place] = rate
        letters, self._force = "Shc" if law.restitution else "Ssz", arb_mat([[0, 0, -w, -b, -1, 0, 1]])
        if law.penetration is not None:
            # the gap in units of the scale: the rates of a contact are then the scale, not its square
            letters, scale = "CF" if law.adhesive else "CFb", 1 / exact(law.penetration)
            self.flight[GAP, GAP1] = scale
            damping = arb(scalar_damping_ratio(law.restitution, law.adhesive))  # the kernel's double
            self._force = arb_mat([[-scale, -2 * damping * scale, 0, 0, 0, 0, 0]])
        self.contact = self.flight + arb_mat(7, 1, [0, 1, 0, -1, 0, 0, 0]) * self._force
        self.whole, word = 2 * guess.periods * arb.pi(), guess.letters
        stays = [(letter in "SC") == (word[i - 1] in "scFb") for i, letter in enumerate(word)]
        # a word begins with a gap of zero
        if not (all(stays) and set(word) <= set(letters)) or (self._sided and word[-1] in "Cb"):
            raise NotProvenError(f"no motion has the word {word}")
        self._segments = [self._segment(letter, word[i - 1]) for i, letter in enumerate(word)]
        self.ends = [True] * len(word)  # whether a segment of the guess ends with each segment
        self._start = list(map(exact, guess.unknowns))
        if "c" in word:
            self._spell_out_chatter()
        if (n := len(self._segments)) > _MOST_SEGMENTS:
            rule = f"proofs take up to {_MOST_SEGMENTS}: a smaller restitution has fewer"
            raise NotProvenError(f"a cycle of {n} contacts and flights; {rule}", "not covered")

    def _segment(self, letter: str, before: str) -> _Segment:
        up, force, reset, below = self._up, self._force, arb_mat(7, 7, 1), int(before == "b")
        if letter in "hcsz":
            rebound = self._e if letter == "h" else 0
            # a gap set to zero keeps the errors of one hop out of the next
            reset[GAP, GAP], reset[GAP1, GAP1], reset[Q1, GAP1] = 0, -rebound, 1 + rebound
        landing: list[list[Condition]] = [[(up, {"S": 3, "z": 2}.get(before, 1), True)]]
        event, conditions = {
            "S": (force, [[(force, 0, True)]]),
            "C": (up, [[(-up, 1, True)]]),
            "C sided": (force, [[(-up, 1 - below, False)], [(force, below, True)]]),
            "F sided": (up, [[(up, 0, True), (-force, 1, False)]]),
            "b sided": (force, [[(-force, 1, True)]]),
        }.get(letter + " sided" * self._sided, (up, landing))
        if letter in "CFb":  # as above, to the gap at which the event is zero
            reset[GAP, GAP], reset[GAP, GAP1] = 0, -event[0, GAP1] / event[0, GAP]
        return _Segment(letter, self.contact if letter in "SC" else self.flight, event, reset, conditions)

    def _spell_out_chatter(self) -> None:
        """Add the hops of chatters as segments, down to the square root of the widest box.

        A guess ends a chatter in an instant, and the mass sticks. Here the hops take a part of that contact,
        each as long as under a constant force; Newton's method corrects them.
        """
        y, word, times, self.ends = arb_mat(7, 1, [0, *self._start[:START], 1]), "", list[arb](), []
        for segment, t in zip(self._segments, self._start[START:], strict=True):
            landing, hops = flow(segment.motion, t) * y, list[arb]()
            y = (segment.reset * landing).mid()
            leaves, n = self._e * abs(landing[GAP1, 0]), (self._force * y)[0, 0]
            while segment.letter == "c" and not leaves < arb(2) ** (-ctx.prec // 6):
                hops.append((2 * leaves / n).mid())
                leaves = leaves * self._e
                if len(hops) > _MOST_HOPS or not n > 0:
                    raise NotProvenError(f"a chatter of {_MOST_HOPS} hops or without end", "not covered")
            word, times = word + "h" * len(hops) + segment.letter, [*times, t, *hops]
            self.ends += [True] + [False] * len(hops)
        self._segments, self._start[START:] = list(map(self._segment, word, word[-1] + word[:-1])), times

    def box(self, given: arb, *, by_flight: bool = False) -> list[arb]:
        """A box with exactly one cycle of the `given` Gamma, or of each first flight in that ball, rad.

        By interval Newton. Raises `NotProvenError`.
        """
        m = len(self._start)
        flies = next(i for i, segment in enumerate(self._segments, START) if segment.letter not in "SC")

        def equations(unknowns: arb_mat) -> tuple[arb_mat, arb_mat]:
            x = unknowns.entries()
            rows, c, s = self._round(x)[0], x[COS - 1], x[SIN - 1]
            if by_flight:
                rows.append([x[flies] - given, *(int(i == flies) for i in range(m))])
            else:
                rows.append([c * c + s * s - given**2, 0, 0, 0, 2 * c, 2 * s, *[0] * len(self._segments)])
            return arb_mat([row[:1] for row in rows]), arb_mat([row[1:] for row in rows])

        x = arb_mat(m, 1, self._start)
        for _ in range(_STEPS):
            value, slope = equations(x)
            step = slope.mid().solve(value)
            if all(abs(change.mid()) < arb(2) ** (-ctx.prec // 2) for change in step.entries()):
                break
            x = (x - step).mid()
        far = max((change.abs_upper() for change in step.entries()), key=float)
        wide = x + arb_mat(m, 1, [arb(0, arb(2) ** (-ctx.prec // 3) + 4 * far)] * m)
        image = x - equations(wide)[1].solve(value, algorithm="precond")
        if not wide.contains(image):
            raise NotProvenError("no box is mapped into itself")
        return image.entries()

    def _round(self, x: Sequence[arb]) -> tuple[list[list[Any]], list[arb_mat]]:
        """The equations of one round, and the states where segments begin.

        The equations, (1 + m,) each with its derivatives, are the events and the returns of gap', q, q' and
        the phase.
        """
        y, rows, starts = arb_mat(7, 1 + len(x)), list[list[Any]](), list[arb_mat]()
        for place in range(GAP1, ONE):
            y[place, 0], y[place, place] = x[place - 1], 1
        y[ONE, 0] = 1
        first = y
        for place, segment in enumerate(self._segments, START):
            starts.append(arb_mat([row[:1] for row in y.tolist()]))
            y = flow(segment.motion, x[place]) * y
            along = segment.motion * y
            for row in range(7):
                y[row, 1 + place] = y[row, 1 + place] + along[row, 0]
            rows.append((segment.event * y).entries())
            y = segment.reset * y + self._rest_of_chatter(y) if segment.letter == "c" else segment.reset * y
        rows += (y - first).tolist()[GAP1:COS]
        late = sum(x[START:], arb(0)) - self.whole
        return [*rows, [late, *[0] * START, *[1] * len(self._segments)]], starts

    def _rest_of_chatter(self, landing: arb_mat) -> arb_mat:
        """The change of a sticking state and its derivatives (7, .) by the endless hops from h = e |gap'| on.

        No hop changes Q = q + gap and u = q' + gap'. They follow Q' = u, u' = c - 1 - b u - w Q + (b gap' +
        w gap): a stuck spring with a forcing. The hops take no longer than `time`: under forces from `least`
        to 9/8 of it a hop takes at most 2 h/least, and the next begins with at most e h (1 + (1 - e)/4). They
        add the integral of the forcing, carried back to the landing. By parts it is that of the gap, at most
        h**2/(2 least), times a factor below 2 rates**2. Its derivatives by h, by the instants of landings and
        by the state are of the order h/least; their sums over all hops are geometric, too.
        """
        e, rates, after = self._e, 1 + self.b + self.w, self._segment("c", "h").reset * landing
        h = (e * abs(landing[GAP1, 0])).upper()
        time = 4 * h / ((self._force * after)[0, 0] * (1 - e))
        nearby = flow(self.contact, arb(0).union(time)) * after
        n = (self._force * nearby)[0, 0] + arb(0, 2 * rates * (h + time))
        change, least = n.upper() - n.lower(), n.lower()
        if not (change < least * (1 - e) / 8 and change < (1 - e) / 8):
            raise NotProvenError("a chatter under a force that may change", "not covered")
        size = rates * rates * h * time / least
        more = arb_mat([[0, *[arb(0, 100 * size / (1 - e))] * 5, 0]]) * landing
        more[0, 0] = arb(0, 2 * h * size)
        return arb_mat(7, 1, [0, 0, 1, 1, 0, 0, 0]) * more

    def stable(self, box: Sequence[arb], says: str) -> Proven:
        """Prove that the cycle in a box is admissible and stable, and so that `says` holds.

        Raises `NotProvenError`.
        """
        self.check_admissible(box)
        tangent = self._tangent(box)
        if not any(sum(map(abs, (tangent**2**n).entries())) < 1 for n in range(50)):
            raise NotProvenError("no power of the tangent map has a norm below 1")
        flies = (segment.letter not in "SC" for segment in self._segments)
        return Proven(says, amplitude(box), list(compress(box[START:], flies)))

    def check_admissible(self, box: Sequence[arb]) -> None:
        """Prove that no segment of the cycles in a box ends early. Raises `NotProvenError`."""
        starts = self._round(box)[1]
        for i, (segment, start, t) in enumerate(zip(self._segments, starts, box[START:], strict=True)):
            for conditions in segment.conditions:
                balls.check_positive(segment.motion, conditions, start, t, f"segment {i} ({segment.letter})")

    def _tangent(self, box: Sequence[arb]) -> arb_mat:
        """The derivative (4, 4) of the return by (gap', q, q', phase); the events determine the durations."""
        # enclosed as a whole: balls carried from hop to hop would grow in each
        rows, n, (c, s) = self._round(box)[0], len(self._segments), box[COS - 1 : START]
        turn = arb_mat([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, -s], [0, 0, 0, c]])
        by_start = arb_mat([row[1 : 1 + START] for row in rows]) * turn
        by_rest = [[*row[1 + START :], *(-int(i == n + j) for j in range(4))] for i, row in enumerate(rows)]
        changes = arb_mat(by_rest).solve(-by_start).tolist()  # of the durations, and by the return
        return arb_mat(changes[n:]) + arb_mat(4, 4, 1)


def amplitude(box: Sequence[arb]) -> arb:
    """Gamma of a box of unknowns."""
    return (box[COS - 1] ** 2 + box[SIN - 1] ** 2).sqrt()
