"""Where a stable cycle ends on the way down, followed through the words that it becomes.

A cycle that loses a landing's force or splits a contact goes on as another word, one that flips as the same
word gone through twice. It ends at a fold of the last of them, or the theory of branches does not decide: at
a torus, at a flight that grazes, or where the next word is not stable or leads up again.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from kernel.branches.closed_form import floquet, gamma_slope
from kernel.branches.continuation import GAMMA, Point, Turn, folds_along, newton, start, turns_along, walk
from kernel.branches.energy import Energy, energy, word_energy
from kernel.branches.events import Events, Kind
from kernel.branches.spring import Spring, spring
from kernel.branches.words import (
    Word,
    doubled,
    from_branch,
    go_round,
    pieces,
    record,
    with_contact,
    with_hop,
    with_split_contact,
    without,
)
from kernel.params import KernelInputError

#: Words that a cycle is followed through, and flights of a word, at most: doublings crowd together.
WORDS: Final = 6
FLIGHTS: Final = 8

#: Orbits of one word on the way down.
_POINTS: Final = 200

#: A branch may rise by this part of Gamma, next to where its word begins.
_RISES: Final = 1e-4

#: Steps of derivatives at a fold: relative to T, and along the branch of a word. Their squares are the
#: relative errors.
_DIFFERENCE: Final = 1e-4
_ASIDE: Final = 1e-3


class Fold(NamedTuple):
    """A minimum of Gamma along a branch. Primes are derivatives by T, or along the branch of a word."""

    cycle: Word  # the orbit that turns
    flight_time: float  # rad, of the first flight
    gamma: float
    other_multiplier: float  # the one that is not 1
    curvature: float  # Gamma'' > 0
    slope: float  # of the multiplier that is 1
    admissible: int  # 0, or the bits of a Reason
    energy: Energy  # of the cycle

    @property
    def periods(self) -> int:
        """Plate periods of the cycle."""
        return self.cycle.periods

    @property
    def holds(self) -> bool:
        """Whether a stable cycle of the spring ends here."""
        return not self.admissible and abs(self.other_multiplier) < 1.0

    @property
    def name(self) -> str:
        """As `cause` spells it."""
        letters = self.cycle.letters
        if letters == "s":
            return f"fold (1,{self.periods})"
        return f"fold of word {letters} ({len(letters)},{self.periods})"


class End(NamedTuple):
    """Where a stable cycle ends on the way down."""

    gamma: float
    fold: Fold | None  # None where its only flight vanishes, at Eq. 25, and where it is not known
    reason: str  # why it is not known, or empty


def lifetime(fold: Fold, below: float) -> float:
    """Plate periods that bouncing lives at Gamma = fold.gamma - below, below > 0: the ghost of the fold.

    Near a fold the slow coordinate x (a flight time) moves by lambda' x per cycle to lowest order in x, and
    delta below it by -delta lambda'/Gamma'' + lambda' x**2/2 with |lambda'| = |d lambda/dT|, which it crosses
    in N = (pi/|lambda'|) sqrt(2 Gamma''/delta) cycles. The law holds for delta -> 0, and for any coordinate
    along the branch.
    """
    cycles = math.pi / abs(fold.slope) * math.sqrt(2.0 * fold.curvature / below)
    return cycles * fold.periods


def minima(k: Spring, events: Events, below: float) -> list[Fold]:
    """The folds of a (1,k) branch below a Gamma that are minima of it."""
    folds = []
    for i in np.flatnonzero((events.kind == Kind.FOLD) & (events.gamma < below)):
        t, n = float(events.flight_time[i]), int(events.periods[i])
        step = _DIFFERENCE * t
        before, after = gamma_slope(k, n, np.array([t - step, t + step]))
        curvature = float(after - before) / (2.0 * step)
        if not curvature > 0.0:
            continue
        f = floquet(k, n, np.array([t]))
        other = float(f.det[0])  # the product of both
        slope = float((f.trace1[0] - f.det1[0]) / (1.0 - other))
        omega, xi = float(np.real(k.omega)), float(np.real(k.xi))
        balance = energy(omega, xi, n, np.array([t]))
        cycle = from_branch(omega, xi, n, t)
        folds.append(
            Fold(
                cycle, t, float(events.gamma[i]), other, curvature, slope, int(events.admissible[i]), balance
            )
        )
    return folds


def descend(word: Word) -> End:
    """Follow a stable cycle down to its end. Raises KernelInputError if the word is not one."""
    gamma = word.gamma
    for _ in range(WORDS):
        name = f"{word.letters} ({len(word.letters)},{word.periods})"
        try:
            first = start(word)
        except KernelInputError:
            return End(gamma, None, f"no orbit of the word {name} was found at Gamma = {gamma:.6f}")
        gamma = first.gamma
        if word.direction is None and _slope(first) > 0.0:
            first = first._replace(tangent=-first.tangent)
        if not first.is_stable:
            return End(gamma, None, f"the word {name} is not stable at Gamma = {gamma:.6f}")
        line, end = walk(word, first, _POINTS, (GAMMA[0], gamma * (1.0 + _RISES)), stable_only=True)
        turn = next(turns_along(word, line), end)
        if turn is None:
            return End(line[-1].gamma, None, f"the word {name} leads up from Gamma = {gamma:.6f}")
        gamma = turn.word.gamma
        if turn.kind is Kind.FOLD:
            return End(gamma, _fold(turn), "")
        if turn.time == 0.0 and turn.word.letters == "s":
            return End(gamma, None, "")  # the only flight vanishes: Eq. 25
        following = _next(turn)
        if following is None:
            return End(gamma, None, f"{name} ends at a {turn.kind} at Gamma = {gamma:.6f}")
        word = following
        if len(word.letters) > FLIGHTS:
            break
    return End(gamma, None, f"a cascade of words at Gamma = {gamma:.6f}")


def lowest_cycles(word: Word, below: float) -> list[Fold]:
    """The folds on the branch of a word at which stable cycles end, as far as it stays below a Gamma.

    The branch is followed from the word's direction, its unstable parts too.
    """
    try:
        first = start(word)
    except KernelInputError:
        return []
    line, _ = walk(word, first, _POINTS, (GAMMA[0], below))
    folds = [_fold(turn) for turn in folds_along(word, line, below)]
    return [fold for fold in folds if fold.curvature > 0.0 and fold.holds]


def _next(turn: Turn) -> Word | None:
    """The word that a cycle becomes, or None if it is not known."""
    if turn.kind is Kind.FLIP:
        return doubled(turn.word)
    if turn.time == 0.0:  # a time has shrunk to nothing
        try:
            return without(turn.word, turn.piece)
        except KernelInputError:
            return None
    if turn.kind is Kind.IMMEDIATE_TAKEOFF:
        part = pieces(turn.word.letters)[turn.piece]
        if part.flies:
            return with_contact(turn.word, turn.piece)
        return with_hop(turn.word, (part.letter - 1) % len(turn.word.letters))
    if turn.kind is Kind.GRAZE_CONTACT and turn.time > 0.0:
        return with_split_contact(turn.word, turn.piece, turn.time)
    return None


def _slope(point: Point) -> float:
    """dGamma along the branch, times Gamma."""
    return float(point.u[2] * point.tangent[2] + point.u[3] * point.tangent[3])


def _fold(turn: Turn) -> Fold:
    """The record of a word's fold."""
    word = turn.word
    k, here = spring(word.omega, word.xi), record(word, word.unknowns[None])
    slope = go_round(k, word.letters, word.periods, word.unknowns[:, None]).slope[..., 0]
    along = np.linalg.svd(slope)[2][-1]
    gamma, other = float(here.gamma[0]), float(np.real(np.prod(here.multiplier[0])))
    sides = [newton(k, word, word.unknowns + step * along, along) for step in (-_ASIDE, _ASIDE)]
    curvature = by_step = math.nan
    if sides[0] is not None and sides[1] is not None:
        curvature = (sides[0].gamma + sides[1].gamma - 2.0 * gamma) / _ASIDE**2
        # 1 - tr + det = (1 - mu)(1 - other)
        low, high = (side.tests[0] for side in sides if side is not None)
        by_step = float((low - high) / (2.0 * _ASIDE * (1.0 - other)))
    return Fold(
        word, float(here.flight_time[0, 0]), gamma, other, curvature, by_step,
        int(here.admissible[0]), word_energy(here),
    )  # fmt: skip
