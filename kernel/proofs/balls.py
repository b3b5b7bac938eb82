"""Ball arithmetic: proofs that functions are positive throughout a phase (docs/proofs.md).

Every number is a ball, a midpoint with a radius. A comparison is true only if it holds for the whole ball.
Needs the extra `proofs`.
"""

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from itertools import product
from typing import Any, Final, TypeVar

from flint import acb_mat, arb, arb_mat, ctx

Result = TypeVar("Result")

#: A linear function (1, n) of the state that is positive inside a phase, the order of its zero at the
#: beginning, 0 for none, and whether it is zero at the end.
Condition = tuple[arb_mat, int, bool]

PRECISIONS: Final = (192, 384, 1024)  # bits of the arithmetic, tried in turn
_ONE_PROOF: Final = threading.Lock()  # FLINT has one precision for all threads of a process
_DEPTH: Final = 40  # halvings of a phase until its conditions count as undecided


class NotProvenError(Exception):
    """A statement has no proof.

    verdict: `disproven` if the contrary is proven, `not proven` if neither is, `not covered` if no proof here
    describes the motion.
    """

    def __init__(self, says: str, verdict: str = "not proven") -> None:
        super().__init__(says)
        self.verdict = verdict


def first_proven(*ways: Callable[[], Result]) -> Result:
    """The result of the first way that succeeds, each with more and more bits. Raises `NotProvenError`."""
    failed = NotProvenError("no way was given")
    for prove, bits in product(ways, PRECISIONS):
        if bits > PRECISIONS[0] and failed.verdict != "not proven":
            continue  # more bits cannot change it
        with _ONE_PROOF, ctx.workprec(bits):
            try:
                return prove()
            except NotProvenError as error:
                failed = error
            except ZeroDivisionError:
                failed = NotProvenError("equations that may be singular")
    raise failed


def exact(number: float) -> arb:
    """A double, taken as its shortest decimal: 0.6 is 6/10."""
    return arb(repr(float(number)))


def bounds(ball: arb, digits: int = 18) -> tuple[str, str]:
    """Two decimals of this many digits that enclose the ball."""
    middle, radius = ball.mid().fmpq(), ball.rad().fmpq()
    low, high = (
        Context(prec=digits, rounding=rounding).divide(Decimal(int(end.p)), Decimal(int(end.q)))
        for end, rounding in ((middle - radius, ROUND_FLOOR), (middle + radius, ROUND_CEILING))
    )
    return str(low), str(high)


def flow(a: Any, t: arb) -> Any:
    """exp(a t), for the middle of t apart: the exponential of a wide ball is far too wide."""
    return (a * t.mid()).exp() * (a * (t - t.mid())).exp()


def check_positive(a: Any, conditions: Sequence[Condition], start: Any, end: arb, what: str) -> None:
    """Prove that at every instant of (0, end) one of the conditions is positive, by bisection.

    a (n, n), start (n, 1): the motion is exp(a x) start. A condition that is zero at an end is decided there
    by its derivative. what: name of the motion in errors. Raises `NotProvenError`, with the verdict
    `disproven` if all conditions are negative at an instant.
    """
    if not end > 0:
        raise NotProvenError(f"{what} may take no time")
    rows = [condition[0] for condition in conditions]
    # along eigenvectors, if they exist, decayed parts do not limit the width of a box
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
                # Taylor's polynomial of degree 3 with its remainder, over the whole box
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
