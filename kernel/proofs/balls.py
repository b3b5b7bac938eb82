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
    """What is not shown. The verdict `disproven` says that the contrary is, `not proven` nothing, and `not
    covered` that no proof here describes the motion."""

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


def check_positive(a: Any, conditions: Sequence[Condition], start: Any, end: arb, what: str) -> None:
    """Prove that at every instant of (0, end) one of the conditions is positive, by bisection.

    a (n, n), start (n, 1): the motion is exp(a x) start. Where a condition is zero at an end, its derivative
    has the sign that makes it positive inside. Raises `NotProvenError`, `disproven` if all are negative at an
    instant; `what` says what moves.
    """
    if not end > 0:
        raise NotProvenError(f"{what} may take no time")
    rows = [condition[0] for condition in conditions]
    # by eigenvectors, where there are any, what has decayed does not limit the width of a box
    with suppress(ValueError, ZeroDivisionError):
        rates, vectors = acb_mat(a).eig(right=True)
        rows, start = [row * vectors for row in rows], vectors.solve(acb_mat(start))
        a = acb_mat([[rate * int(i == j) for j in range(len(rates))] for i, rate in enumerate(rates)])
    derivatives = [[row * a**order for order in range(8)] for row in rows]
    last = half = arb(math.nextafter(float(end.upper()), math.inf))
    boxes = [(arb(0), start)]
    for _ in range(_DEPTH):
        half, x, undecided = half / 2, arb(0, half / 2), []
        move, around = (a * half).exp(), (a * x).exp()
        for low, state in boxes:
            middle, later = low + half, move * state
            terms = [later] * 4 + [around * later]
            for (_, zero, ends), powers in zip(conditions, derivatives, strict=True):
                begins, falls = zero if low == 0 else 0, ends and middle + half == last
                order = 1 if falls else begins
                # Taylor's polynomial of degree 3 with its rest: all over the box
                c = [(row * y)[0, 0].real for row, y in zip(powers[order : order + 5], terms, strict=True)]
                over = c[0] + x * (c[1] + x / 2 * (c[2] + x / 3 * (c[3] + x / 4 * c[4])))
                if (over < 0 and not begins) if falls else over > 0:
                    break
            else:
                if middle < end and all((powers[0] * later)[0, 0].real < 0 for powers in derivatives):
                    says = f"{what} breaks off after {float(middle):.9g} of {float(end):.9g} rad"
                    raise NotProvenError(says, "disproven")
                undecided += [(low, state), (middle, later)]
        boxes = undecided
    if boxes:
        raise NotProvenError(f"{what} is undecided after {float(boxes[0][0]):.9g} of {float(end):.9g} rad")
