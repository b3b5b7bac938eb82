"""Balls of numbers, matrices of them, and what is positive over a whole phase (docs/proofs.md).

Needs the extra `proofs` (python-flint). Every number here is a ball, a midpoint with a radius: a comparison
that is true holds for every number of the ball. What cannot be shown raises `NotProvenError`, which says
nothing about the truth; `DisprovenError` is raised where the contrary holds for certain.

State (gap, gap', q, q', c, s, 1) with c + i s = Gamma exp(i phi), lengths in g/omega**2: every phase, landing
and contact law is linear in it, so that a phase of t rad is the exponential of a matrix times t.
"""

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from typing import Any, Final, NamedTuple, TypeVar

from flint import acb_mat, arb, arb_mat, ctx, fmpq

Result = TypeVar("Result")

#: Bits of the arithmetic, tried in turn.
PRECISIONS: Final = (192, 384, 1024)

#: FLINT has one precision for all threads of a process: their proofs wait for each other.
_ONE_PROOF: Final = threading.Lock()

#: Halvings of a phase until its conditions count as undecided.
_DEPTH: Final = 40


class NotProvenError(Exception):
    """What could not be shown, as text. It says nothing about the truth."""


class DisprovenError(NotProvenError):
    """The contrary is proven."""


class NotCoveredError(NotProvenError):
    """A motion that no proof here describes."""


@contextmanager
def precision(bits: int) -> Iterator[None]:
    """Compute with this many bits."""
    before = ctx.prec
    ctx.prec = bits
    try:
        yield
    finally:
        ctx.prec = before


def with_enough_bits(prove: Callable[[], Result]) -> Result:
    """The result of `prove` at the first of PRECISIONS that suffices. Raises the last `NotProvenError`."""
    for bits in PRECISIONS:
        with _ONE_PROOF, precision(bits):
            try:
                return prove()
            except (DisprovenError, NotCoveredError):
                raise
            except NotProvenError:
                if bits == PRECISIONS[-1]:
                    raise
    raise AssertionError


def exact(number: float | str) -> arb:
    """A ball around a number: a decimal string is that decimal, a float its 53 bits."""
    if isinstance(number, str):
        fraction = Fraction(number)
        return arb(fmpq(fraction.numerator, fraction.denominator))
    return arb(number)


def matrix(rows: Sequence[Sequence[Any]]) -> arb_mat:
    """A matrix of balls from rows of numbers."""
    return arb_mat(len(rows), len(rows[0]), [arb(entry) for row in rows for entry in row])


def flight_rows(b: arb, w: arb) -> list[list[Any]]:
    """The rows of the motion in flight, y' = A y, for b = 2 xi/Omega and w = 1/Omega**2."""
    return [
        [0, 1, 0, 0, 0, 0, 0],
        [0, 0, w, b, 1, 0, -1],
        [0, 0, 0, 1, 0, 0, 0],
        [0, 0, -2 * w, -2 * b, 0, 0, 0],
        [0, 0, 0, 0, 0, -1, 0],
        [0, 0, 0, 0, 1, 0, 0],
        [0] * 7,
    ]


def column(values: Sequence[Any]) -> arb_mat:
    """A column of balls."""
    return matrix([[value] for value in values])


def entries(vector: arb_mat) -> list[arb]:
    """The entries of a column."""
    return [vector[i, 0] for i in range(vector.nrows())]


def identity(n: int) -> arb_mat:
    """The unit matrix."""
    return matrix([[int(i == j) for j in range(n)] for i in range(n)])


def total(terms: Iterable[arb]) -> arb:
    """The sum of balls."""
    return sum(terms, arb(0))


def around(middle: arb, radius: arb | float) -> arb:
    """The ball wider by a radius."""
    return arb(middle.mid(), arb(radius).abs_upper() + middle.rad())


def hull(low: arb | float, high: arb | float) -> arb:
    """The ball that holds two numbers and all between."""
    return arb(low).union(arb(high))


def opposite(x: arb, y: arb) -> bool:
    """Whether two balls have opposite signs. Their product may hold zero all the same."""
    return bool((x < 0 and y > 0) or (x > 0 and y < 0))


def above(ball: arb) -> float:
    """A double not below any number of the ball."""
    value = float(ball.mid())
    while not arb(value) >= ball:
        value += max(abs(value), 1e-300) * 2.0**-52 + float(ball.rad())
    return value


def flow(a: arb_mat, t: arb) -> arb_mat:
    """exp(a t). The exponential of a wide ball is far too wide: its middle goes apart."""
    whole = (a * t.mid()).exp()
    return whole if t.is_exact() else whole * (a * (t - t.mid())).exp()


def bounds(ball: arb, digits: int) -> tuple[str, str]:
    """Decimals of this many digits below and above every number of the ball."""
    middle, radius = (_fraction(number) for number in (ball.mid(), ball.rad()))
    return _decimal(middle - radius, digits, ROUND_FLOOR), _decimal(middle + radius, digits, ROUND_CEILING)


def _fraction(exact: arb) -> Fraction:
    mantissa, exponent = exact.man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def _decimal(fraction: Fraction, digits: int, rounding: str) -> str:
    quotient = Context(prec=digits, rounding=rounding).divide
    return str(quotient(Decimal(fraction.numerator), Decimal(fraction.denominator)))


def contracts(tangent: arb_mat, squarings: int = 50) -> bool:
    """Whether a power of a matrix has a norm < 1 for certain: then its spectral radius is < 1."""
    for _ in range(squarings):
        norm = max((total(abs(entry) for entry in row).upper() for row in tangent.tolist()), key=float)
        if norm < 1:
            return True
        if not norm < 1e100:
            return False
        tangent = tangent * tangent
    return False


class Condition(NamedTuple):
    """A linear function of the state that is positive inside a phase."""

    row: arb_mat  # (1, n)
    zero: int  # order of its zero where the phase begins, 0 for none
    ends: bool  # whether it is zero where the phase ends


class _Powers:
    """row . exp(a x) start and its derivatives by x, from powers of the matrix."""

    def __init__(self, a: arb_mat, rows: Sequence[arb_mat], start: arb_mat) -> None:
        self._a, self._start, self._weights = a, start, []
        for row in rows:
            powers = [row]
            for _ in range(7):
                powers.append(powers[-1] * a)
            self._weights.append([power.tolist()[0] for power in powers])

    def move(self, middle: arb, half: arb) -> None:
        """To the box of this middle and half width."""
        state = (self._a * middle).exp() * self._start
        self._half, self._state = half, entries(state)
        self._near = entries((self._a * arb(0, half)).exp() * state)

    def value(self, i: int) -> arb:
        """Of row i at the middle."""
        return total(p * q for p, q in zip(self._weights[i][0], self._state, strict=True))

    def over(self, i: int, order: int) -> arb:
        """The derivative of an order over the box, by a Taylor polynomial of degree 3 with its rest."""
        weights = self._weights[i]
        terms = [total(p * q for p, q in zip(weights[order + j], self._state, strict=True)) for j in range(4)]
        rest = total(p * q for p, q in zip(weights[order + 4], self._near, strict=True))
        return _polynomial(arb(0, self._half), terms, rest)


class _Modes:
    """The same by eigenvectors: a motion that has decayed does not limit the width of a box."""

    def __init__(self, a: arb_mat, rows: Sequence[arb_mat], start: arb_mat) -> None:
        self._rates, vectors = acb_mat(a).eig(right=True)
        amplitudes = vectors.inv() * acb_mat(start)
        n = len(self._rates)
        self._weights = [
            [(acb_mat(row) * vectors)[0, j] * amplitudes[j, 0] for j in range(n)] for row in rows
        ]

    def move(self, middle: arb, half: arb) -> None:
        self._half = half
        self._grown = [(rate * middle).exp() for rate in self._rates]
        self._slow = [bool(abs(rate) * half < 1) for rate in self._rates]
        self._within = [
            ((abs(rate) if slow else abs(rate.real)) * half).exp()
            for rate, slow in zip(self._rates, self._slow, strict=True)
        ]

    def value(self, i: int) -> arb:
        return total((w * z).real for w, z in zip(self._weights[i], self._grown, strict=True))

    def over(self, i: int, order: int) -> arb:
        terms, rest, fast = [arb(0)] * 4, arb(0), arb(0)
        for weight, grown, rate, slow, within in zip(
            self._weights[i], self._grown, self._rates, self._slow, self._within, strict=True
        ):
            term = weight * grown * rate**order
            if not slow:
                fast = fast + abs(term) * within
                continue
            for j in range(4):
                terms[j] = terms[j] + term.real
                term = term * rate
            rest = rest + abs(term) * within
        return arb(0, fast.abs_upper()) + _polynomial(arb(0, self._half), terms, arb(0, rest.abs_upper()))


def _polynomial(x: arb, terms: Sequence[arb], rest: arb) -> arb:
    """Taylor's, of degree 3."""
    return terms[0] + x * (terms[1] + x / 2 * (terms[2] + x / 3 * (terms[3] + x / 4 * rest)))


def check_positive(
    a: arb_mat, conditions: Sequence[Condition], start: arb_mat, end: arb, *, stiff: bool = False
) -> None:
    """Prove that at every instant of (0, end) one of the conditions is positive.

    a (n, n), start (n, 1): the motion is exp(a x) start. By bisection. Where a condition is zero at an end,
    its derivative has the sign that makes it positive inside. stiff: by eigenvectors, where there are any.
    Raises `DisprovenError` if all are negative somewhere, `NotProvenError` if a box is undecided.
    """
    rows = [condition.row for condition in conditions]
    motion: _Modes | _Powers
    try:
        motion = (_Modes if stiff else _Powers)(a, rows, start)
    except (ValueError, ZeroDivisionError):  # eigenvalues that are not apart
        motion = _Powers(a, rows, start)
    last = above(end)
    boxes = [(0.0, last, 0)]
    while boxes:
        low, high, level = boxes.pop()
        middle = arb(0.5 * (low + high))
        motion.move(middle, hull(arb(high) - middle, middle - arb(low)).abs_upper())
        if middle < end and all(motion.value(i) < 0 for i in range(len(rows))):
            raise DisprovenError(f"broken {float(middle):.9g} rad after it begins, of {last:.9g}")
        if any(
            _holds(motion, i, condition, low == 0.0, high == last) for i, condition in enumerate(conditions)
        ):
            continue
        if level == _DEPTH:
            raise NotProvenError(f"undecided {low:.9g} rad after it begins, of {last:.9g}")
        half = 0.5 * (low + high)
        boxes += [(low, half, level + 1), (half, high, level + 1)]


def _holds(motion: _Modes | _Powers, i: int, condition: Condition, first: bool, last: bool) -> bool:
    """Whether a condition is positive over the box, by a derivative's sign where it is zero at one end."""
    if last and condition.ends:
        return not (first and condition.zero) and bool(motion.over(i, 1) < 0)
    return bool(motion.over(i, condition.zero if first else 0) > 0)
