"""Balls of numbers, and what is positive over a whole phase (docs/proofs.md). Needs the extra `proofs`.

Every number is a ball, a midpoint with a radius: a comparison that is true holds for all of the ball.
"""

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from typing import Any, Final, TypeVar

from flint import acb_mat, arb, arb_mat, ctx

Result = TypeVar("Result")

#: A linear function of the state (1, n) that is positive inside a phase, the order of its zero where that
#: begins, 0 for none, and whether it is zero where that ends.
Condition = tuple[arb_mat, int, bool]

PRECISIONS: Final = (192, 384, 1024)  # bits of the arithmetic, tried in turn
_ONE_PROOF: Final = threading.Lock()  # FLINT has one precision for all threads of a process
_DEPTH: Final = 40  # halvings of a phase until its conditions count as undecided


class NotProvenError(Exception):
    """What could not be shown.

    verdict: `not proven`, which says nothing about the truth; `disproven`: the contrary is shown; `not
    covered`: a motion that no proof here describes.
    """

    def __init__(self, says: str, verdict: str = "not proven") -> None:
        super().__init__(says)
        self.verdict = verdict


def first_proven(*ways: Callable[[], Result]) -> Result:
    """The result of the first way that succeeds, with as few bits as it needs. Raises `NotProvenError`."""
    why: Exception | None = None
    for prove in ways:
        for bits in PRECISIONS:
            with _ONE_PROOF, ctx.workprec(bits):
                try:
                    return prove()
                except (NotProvenError, ZeroDivisionError) as error:
                    why = error
    raise why if isinstance(why, NotProvenError) else NotProvenError("equations that may be singular")


def exact(number: float) -> arb:
    """A double as its shortest decimal: 0.6 is 6/10."""
    return arb(repr(float(number)))


def bounds(ball: arb, digits: int = 18) -> tuple[str, str]:
    """Decimals of this many digits below and above every number of the ball."""
    middle, radius = ball.mid().fmpq(), ball.rad().fmpq()
    low, high = (
        Context(prec=digits, rounding=rounding).divide(Decimal(int(end.p)), Decimal(int(end.q)))
        for end, rounding in ((middle - radius, ROUND_FLOOR), (middle + radius, ROUND_CEILING))
    )
    return str(low), str(high)


def flow(a: Any, t: arb) -> Any:
    """exp(a t). The exponential of a wide ball is far too wide: its middle goes apart."""
    return (a * t.mid()).exp() * (a * (t - t.mid())).exp()


def contracts(tangent: arb_mat) -> bool:
    """Whether a power of a matrix has a norm < 1 for certain: then its spectral radius is < 1."""
    return any(sum(map(abs, (tangent**2**n).entries())) < 1 for n in range(50))


def check_positive(a: Any, conditions: Sequence[Condition], start: Any, end: arb, what: str) -> None:
    """Prove that at every instant of (0, end) one of the conditions is positive, by bisection.

    a (n, n), start (n, 1): the motion is exp(a x) start. Where a condition is zero at an end, its derivative
    has the sign that makes it positive inside. Raises `NotProvenError`, `disproven` if all are negative at an
    instant; `what` says what moves.
    """
    if not end > 0:
        raise NotProvenError(f"{what} may take no time")
    vectors, rates = arb_mat(a.nrows(), a.nrows(), 1), [arb(0)] * a.nrows()
    with suppress(ValueError, ZeroDivisionError):  # eigenvalues that are not apart
        rates, vectors = acb_mat(a).eig(right=True)
        a, start = _diagonal(rates), vectors.solve(acb_mat(start))
    derivatives = [[row * vectors * a**order for order in range(8)] for row, _, _ in conditions]
    last = half = arb(math.nextafter(float(end.upper()), math.inf))
    boxes = [(arb(0), start)]
    for _ in range(_DEPTH):
        half, undecided = half / 2, []
        move, around = (a * half).exp(), (a * arb(0, half)).exp()
        slow = [int(abs(rate) * half < 1) for rate in rates]  # others are enclosed as they are
        slow, fast = _diagonal(slow), _diagonal([1 - each for each in slow])
        for low, state in boxes:
            middle, later = low + half, move * state
            near, slowly = around * later, slow * later
            terms = [slowly + fast * near, slowly, slowly, slowly, slow * near]
            for (_, zero, ends), rows in zip(conditions, derivatives, strict=True):
                begins = zero if low == 0 else 0
                if ends and middle + half == last:
                    holds = not begins and _over(half, rows[1:], terms) < 0
                else:
                    holds = _over(half, rows[begins:], terms) > 0
                if holds:
                    break
            else:
                if middle < end and all((rows[0] * later)[0, 0].real < 0 for rows in derivatives):
                    says = f"{what} breaks off after {float(middle):.9g} of {float(end):.9g} rad"
                    raise NotProvenError(says, "disproven")
                undecided += [(low, state), (middle, later)]
        boxes = undecided
    if boxes:
        raise NotProvenError(f"{what} is undecided after {float(boxes[0][0]):.9g} of {float(end):.9g} rad")


def _over(half: arb, rows: Sequence[Any], terms: Sequence[Any]) -> Any:
    """A function all over a box, from its derivatives: Taylor's polynomial of degree 3 with its rest."""
    x = arb(0, half)
    a, b, c, d, e = ((row * term)[0, 0].real for row, term in zip(rows[:5], terms, strict=True))
    return a + x * (b + x / 2 * (c + x / 3 * (d + x / 4 * e)))


def _diagonal(entries: Sequence[Any]) -> Any:
    return acb_mat([[x if i == j else 0 for j in range(len(entries))] for i, x in enumerate(entries)])
