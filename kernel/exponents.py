"""Lyapunov exponents: variations carried through a cell's contacts, flights and events (docs/model.md).

At every full plate period the variations are orthonormalised (Gram and Schmidt), and the logarithms of their
lengths are summed with the weight (t (1 - t))**2, t being the part of the window that has passed. The weights
make the mean over a window of N periods of a quasi-periodic motion converge as N**-3 instead of N**-1, and
that of a chaotic one as that over 0.7 N periods without them.

Five parts of the window, each a third of it and overlapping the next by half, have such means too. Their
scatter gives the error. Thirds distinguish most tori from slow chaos; fewer or shorter parts do so less
often.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from kernel import interface
from kernel.interface import Phase, plate_phase
from kernel.numerics.elementary import TWO_PI
from kernel.numerics.first_root import HORIZON, ROOT
from kernel.numerics.jit import inlined, jit
from kernel.params import KernelInputError
from kernel.portable_math import log

#: A variation is lost if less than this part of it is independent of those before it. Rounding leaves about
#: 1e-16 of a direction that an event removes; a rest of 1e-12 still has four digits.
LOST: Final = 1e-12

ALIGN: Final = 1.5  # windows in which variations turn to the directions of growth; 1 is not enough
PARTS: Final = 5  # overlapping thirds of the window, whose means give the first exponent's error
SHORTEST: Final = 40  # plate periods; the parts of a shorter window would be correlated
#: The variance of the means of parts expected over that of the window's. Neighbours correlate by 0.2.
SPREAD: Final = 3.0 * (1.0 - 2.0 / PARTS * 0.201)


class Variations(NamedTuple):
    """The variations of one cell. Arrays of n exponents."""

    vectors: Any  # (n, 4) float64, of (gap, gap', q, q') in plate amplitudes
    sums: Any  # (n,) float64, weighted sums of the logarithms of their growth; -inf once one was lost
    weight: Any  # (1,) float64, sum of the weights
    parts: Any  # (2, PARTS) float64, sums of the first vector's weighted logarithms and of their weights


def allocate_variations(plate: Any, exponents: int) -> Variations:
    """Room for this many exponents. Raises KernelInputError if the plate's model has fewer."""
    most = interface.dimension(plate)
    if exponents > most:
        raise KernelInputError("exponents", f"must be at most {most} for this contact, got {exponents}")
    return Variations(np.zeros((exponents, 4)), np.zeros(exponents), np.zeros(1), np.zeros((2, PARTS)))


@jit
def _replace(vectors: Any, k: int) -> None:
    """Give vector k a new direction, orthogonal to those before it."""
    # of the four vectors (+-1, +-1, +-1, +-1)/2 the one least in their span; none lies in the two dimensions
    # of a rigid contact or of a ball
    best, chosen = math.inf, 0
    for candidate in range(4):
        inside = 0.0
        for j in range(k):
            inside += _hadamard(vectors[j], candidate) ** 2
        if inside < best:
            best, chosen = inside, candidate
    for i in range(4):
        vectors[k, i] = 0.5 * _sign(chosen, i)
    for j in range(k):
        _remove(vectors, k, j)
    _scale(vectors, k, 1.0 / math.sqrt(_square(vectors, k)))


@inlined
def _sign(row: int, column: int) -> float:
    """An element of the Hadamard matrix of order 4."""
    return 1.0 if (row & column) % 3 == 0 else -1.0


@inlined
def _hadamard(vector: Any, row: int) -> float:
    """The part of a vector (4,) along half of a row of the Hadamard matrix."""
    total: float = 0.0
    for i in range(4):
        total += 0.5 * _sign(row, i) * vector[i]
    return total


@inlined
def _square(vectors: Any, k: int) -> float:
    square: float = vectors[k, 0] ** 2 + vectors[k, 1] ** 2 + vectors[k, 2] ** 2 + vectors[k, 3] ** 2
    return square


@inlined
def _scale(vectors: Any, k: int, factor: float) -> None:
    for i in range(4):
        vectors[k, i] *= factor


@inlined
def _remove(vectors: Any, k: int, j: int) -> None:
    """Subtract from vector k its part along vector j, whose length is 1."""
    along = 0.0
    for i in range(4):
        along += vectors[j, i] * vectors[k, i]
    for i in range(4):
        vectors[k, i] -= along * vectors[j, i]


@jit
def begin_window(variations: Variations) -> None:
    """Begin the sums anew; the variations stay."""
    variations.sums[:] = 0.0
    variations.weight[0] = 0.0
    variations.parts[:] = 0.0


@jit
def start_variations(variations: Variations) -> None:
    """Begin a cell."""
    begin_window(variations)
    for k in range(len(variations.sums)):
        _replace(variations.vectors, k)


@jit
def _orthonormalise(variations: Variations, t: float) -> None:
    """Orthonormalise the vectors and add the logarithms of their lengths, that of the first also to parts.

    t: the part of the window that has passed, < 0 before it.
    """
    vectors, sums, weight = variations.vectors, variations.sums, _weight(t)
    variations.weight[0] += weight
    for k in range(len(sums)):
        whole = _square(vectors, k)
        for j in range(k):
            _remove(vectors, k, j)
        left = _square(vectors, k)
        if left > LOST * LOST * whole:
            if weight > 0.0:
                growth = 0.5 * log(left)
                sums[k] += weight * growth
                for part in range(PARTS if k == 0 else 0):
                    weight_there = _weight(3.0 * t - 0.5 * part)
                    variations.parts[0, part] += weight_there * growth
                    variations.parts[1, part] += weight_there
            _scale(vectors, k, 1.0 / math.sqrt(left))
        else:
            if weight > 0.0:
                sums[k] = -math.inf
            _replace(vectors, k)


@inlined
def _weight(t: float) -> float:
    """The weight after the part `t` of a window; 0 outside the window."""
    return (t * (1.0 - t)) ** 2 if 0.0 < t < 1.0 else 0.0


@jit
def carry(cell: Any, before: Any, run: Any, p: Phase, window: Any, variations: Variations) -> None:
    """Carry the variations over the contact or flight `p` that follows `run`, and through its end.

    run: `cell.Progress`, which `interface.replay` has made of `before`; window: `cell.Window`. Variations
    begin ALIGN times `observe` plate periods before the window.
    """
    vectors = variations.vectors
    if run.period != before.period or run.phase != before.phase:
        vectors[:] = 0.0
        if run.period >= run.settle:
            variations.sums[:] = -math.inf
    early = math.ceil(run.settle - ALIGN * window.observe) - run.period  # plate periods to the beginning
    if early > 0 and p.ending != HORIZON:
        return
    left = run.end - run.period  # plate periods to the run's end
    turns = left if p.ending == HORIZON else min(math.floor((run.phase + p.tau) * (1.0 / TWO_PI)), left)
    first = max(early, 0)  # within a contact or flight that lasts to the run's end
    done = TWO_PI * first - run.phase if first > 0 else 0.0
    for turn in range(first + 1, turns + 2):
        end = TWO_PI * turn - run.phase if turn <= turns else p.tau
        if end > done:
            if run.in_flight:
                interface.carry_in_flight(cell, vectors, end - done)
            else:
                interface.carry_in_contact(cell, vectors, end - done)
            done = end
        if turn <= turns:
            _orthonormalise(variations, (run.period + turn - run.settle - 0.5) / window.observe)
    if p.ending == ROOT:
        if run.in_flight:
            interface.carry_through_landing(cell, vectors, plate_phase(run.phase), run.state, p)
        else:
            interface.carry_through_takeoff(cell, vectors, p)


@jit
def write_exponents(lyapunov: Any, ending: int, variations: Variations) -> None:
    """Write a cell's exponents to `lyapunov` (n,), per plate period; NaN if its run did not reach its end."""
    for k in range(len(lyapunov)):
        lyapunov[k] = variations.sums[k] / variations.weight[0] if ending == HORIZON else math.nan


@jit
def exponent_error(ending: int, variations: Variations, observe: int) -> float:
    """The standard error of a cell's first exponent, from its means over PARTS; NaN where it has none.

    The parts have the window's weights, so that the estimate falls as fast as the error does, on a torus and
    in chaos. A lost direction has no error.
    """
    if ending != HORIZON or observe < SHORTEST or math.isinf(variations.sums[0]):
        return math.nan
    total, square = 0.0, 0.0
    for part in range(PARTS):
        mean = variations.parts[0, part] / variations.parts[1, part]
        # Welford's update of the sum of squares about the mean
        square += part * (mean - total / max(part, 1)) ** 2 / (part + 1)
        total += mean
    return math.sqrt(square / ((PARTS - 1) * SPREAD))
