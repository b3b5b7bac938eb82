"""Proofs that bouncing persists: upper bounds of Gamma_down, from the fold at which cycles end."""

import math
from typing import NamedTuple

import numpy as np
from flint import arb

from kernel.branches.folds import Cycle, Fold
from kernel.proofs.balls import NotProvenError
from kernel.proofs.branches import ProvenBranch
from kernel.proofs.cycles import Guess, Law, jacobian, prove_cycle

#: How far above the fold of a word a stable cycle is shown.
_ABOVE = 1e-9
#: Steps off the fold, in units of the root of _ABOVE, at which a stable cycle is looked for.
_STEPS = (1.0, 0.3, 3.0, 10.0, 0.1, 30.0)


class ProvenThreshold(NamedTuple):
    """Bouncing persists at `at_most`: Gamma_down is no higher."""

    at_most: arb
    flight_time: arb  # rad, of the first flight of the cycle there
    says: str


def prove_down(omega: float | str, xi: float | str, fold: Fold) -> ProvenThreshold:
    """That a stable cycle exists just above a fold, on the ideal plate. Raises `NotProvenError`."""
    if fold.cycle.letters == "Ss":
        down = ProvenBranch(omega, xi, fold.periods).down(fold.flight_time)
        says = (
            f"for every Gamma from down_at_most to {float(down.below.lower()):.9g} a stable cycle "
            f"(1,{fold.periods}) exists"
        )
        return ProvenThreshold(down.above, down.fold.flight_time, says)
    gamma = fold.gamma + _ABOVE
    guess, law = guess_of_cycle(fold.cycle), Law()
    across = np.linalg.svd(jacobian(law, fold.gamma, omega, xi, guess))[2][-1]
    why = NotProvenError("nothing was tried")
    for step in _STEPS:
        for side in (1.0, -1.0):
            try:
                beside = _moved(guess, side * step * math.sqrt(_ABOVE) * across)
                cycle = prove_cycle(law, gamma, omega, xi, beside)
                says = f"at Gamma = down_at_most a stable cycle of the word {fold.cycle.word} exists"
                return ProvenThreshold(arb(gamma), cycle.flight_times[0], says)
            except NotProvenError as failed:
                why = failed
    raise why


def guess_of_cycle(cycle: Cycle) -> Guess:
    """A cycle of `kernel.branches`."""
    gap1, q, q1, c, s, *durations = cycle.unknowns.tolist()
    return Guess(cycle.letters, cycle.periods, gap1, q, q1, math.atan2(s, c), durations)


def _moved(guess: Guess, by: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Guess:
    """A guess whose unknowns (q, q', phase, durations) are moved."""
    durations = [t + step for t, step in zip(guess.durations, by[3:].tolist(), strict=True)]
    q, q1, phase = (x + step for x, step in zip((guess.q, guess.q1, guess.phase), by.tolist(), strict=False))
    return guess._replace(q=q, q1=q1, phase=phase, durations=durations)
