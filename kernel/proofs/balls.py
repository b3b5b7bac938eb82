"""Balls of numbers, and what is positive over a whole phase (docs/proofs.md). Needs the extra `proofs`.

Every number is a ball, a midpoint with a radius: a comparison that is true holds for all of the ball.
"""

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from typing import Any, Final, NamedTuple, TypeVar

from flint import acb_mat, arb, arb_mat, ctx

Result = TypeVar("Result")

#: Bits of the arithmetic, tried in turn.
PRECISIONS: Final = (192, 384, 1024)
#: FLINT has one precision for all threads of a process: their proofs wait for each other.
_ONE_PROOF: Final = threading.Lock()
#: Halvings of a phase until its conditions count as undecided.
_DEPTH: Final = 40


class NotProvenError(Exception):
    """What could not be shown. It says nothing about the truth."""

    verdict = "not proven"


class DisprovenError(NotProvenError):
    """The contrary is proven."""

    verdict = "disproven"


class NotCoveredError(NotProvenError):
    """A motion that no proof here describes."""

    verdict = "not covered"


def with_enough_bits(prove: Callable[[], Result]) -> Result:
    """The result of `prove` at the first of PRECISIONS that suffices. Raises the last `NotProvenError`."""
    why = NotProvenError()
    for bits in PRECISIONS:
        with _ONE_PROOF, ctx.workprec(bits):
            try:
                return prove()
            except (DisprovenError, NotCoveredError):
                raise
            except NotProvenError as error:
                why = error
            except ZeroDivisionError:
                why = NotProvenError("equations that may be singular")
    raise why


def flow(a: arb_mat, t: arb) -> arb_mat:
    """exp(a t). The exponential of a wide ball is far too wide: its middle goes apart."""
    whole = (a * t.mid()).exp()
    return whole if t.is_exact() else whole * (a * (t - t.mid())).exp()


def bounds(ball: arb, digits: int = 18) -> tuple[str, str]:
    """Decimals of this many digits below and above every number of the ball."""
    middle, radius = ball.mid().fmpq(), ball.rad().fmpq()
    low, high = (
        Context(prec=digits, rounding=rounding).divide(Decimal(int(end.p)), Decimal(int(end.q)))
        for end, rounding in ((middle - radius, ROUND_FLOOR), (middle + radius, ROUND_CEILING))
    )
    return str(low), str(high)


def contracts(tangent: arb_mat, squarings: int = 50) -> bool:
    """Whether a power of a matrix has a norm < 1 for certain: then its spectral radius is < 1."""
    for _ in range(squarings):
        if sum(abs(entry) for entry in tangent.entries()) < 1:
            return True
        tangent = tangent * tangent
    return False


class Condition(NamedTuple):
    """A linear function of the state that is positive inside a phase."""

    row: arb_mat  # (1, n)
    zero: int  # order of its zero where the phase begins, 0 for none
    ends: bool  # whether it is zero where the phase ends


def check_positive(
    a: arb_mat, conditions: Sequence[Condition], start: arb_mat, end: arb, *, stiff: bool = False
) -> None:
    """Prove that at every instant of (0, end) one of the conditions is positive, by bisection.

    a (n, n), start (n, 1): the motion is exp(a x) start. Where a condition is zero at an end, its derivative
    has the sign that makes it positive inside. stiff: as in `_Functions`. Raises `DisprovenError` if all are
    negative somewhere, `NotProvenError` if a box is undecided.
    """
    functions = _Functions(a, [condition.row for condition in conditions], start, stiff)
    last = arb(math.nextafter(float(end.upper()), math.inf))
    boxes = [(arb(0), functions.start, last / 2, 0)]
    while boxes:
        low, state, half, level = boxes.pop()
        middle, middle_state = low + half, functions.move(state, half)
        where = f"{float(middle):.9g} rad after it begins, of {float(last):.9g}"
        if middle < end and all(functions.value(i) < 0 for i in range(len(conditions))):
            raise DisprovenError(f"broken {where}")
        for i, (_, zero, ends) in enumerate(conditions):
            if not (ends and middle + half == last):
                holds = functions.over(i, zero if low == 0 else 0) > 0
            else:
                holds = not (zero and low == 0) and functions.over(i, 1) < 0
            if holds:
                break
        else:
            if level == _DEPTH:
                raise NotProvenError(f"undecided {where}")
            boxes += [(low, state, half / 2, level + 1), (middle, middle_state, half / 2, level + 1)]


class _Functions:
    """Linear functions of exp(a x) start and their derivatives by x, over boxes of x.

    stiff: by eigenvectors, where there are any: a mode that has decayed does not limit the width of a box.
    """

    def __init__(self, a: arb_mat, rows: Sequence[arb_mat], start: arb_mat, stiff: bool) -> None:
        self._a: Any = a
        self.start, self._rates = start, [arb(0)] * a.nrows()
        if stiff:
            with suppress(ValueError, ZeroDivisionError):  # eigenvalues that are not apart
                rates, vectors = acb_mat(a).eig(right=True)
                self.start, rows = vectors.solve(acb_mat(start)), [acb_mat(row) * vectors for row in rows]
                self._a, self._rates = acb_mat(a.nrows(), a.nrows()), rates
                for i, rate in enumerate(rates):
                    self._a[i, i] = rate
        self._flows = dict[tuple[float, float], Any]()
        self._weights = []
        for row in rows:
            powers = [row]
            for _ in range(7):
                powers.append(powers[-1] * self._a)
            self._weights.append([power.entries() for power in powers])

    def move(self, low: Any, half: arb) -> Any:
        """To the box of this half width that begins at a state. The state (n, 1) at its middle."""
        self._x = arb(0, half)
        state = self._flow(half) * low
        self._state, self._near = state.entries(), (self._flow(self._x) * state).entries()
        self._slow = [bool(abs(rate) * half < 1) for rate in self._rates]
        return state

    def _flow(self, x: arb) -> Any:
        """exp(a x); a few widths come again and again."""
        key = float(x.mid()), float(x.rad())
        if key not in self._flows:
            self._flows[key] = (self._a * x).exp()
        return self._flows[key]

    def value(self, i: int) -> Any:
        """Of function i at the middle."""
        return sum(w * y for w, y in zip(self._weights[i][0], self._state, strict=True)).real

    def over(self, i: int, order: int) -> arb:
        """The derivative of an order over the box: Taylor's polynomial of degree 3 with its rest."""
        weights, x, fast = self._weights[i][order : order + 5], self._x, arb(0)
        terms = [arb(0)] * 5
        for j, slow in enumerate(self._slow):
            if slow:
                modes = [*[self._state[j]] * 4, self._near[j]]
                terms = [t + (w[j] * mode).real for t, w, mode in zip(terms, weights, modes, strict=True)]
            else:
                fast = fast + abs(weights[0][j] * self._near[j])
        taylor = terms[0] + x * (terms[1] + x / 2 * (terms[2] + x / 3 * (terms[3] + x / 4 * terms[4])))
        return taylor + arb(0, fast)
