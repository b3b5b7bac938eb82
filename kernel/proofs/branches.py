"""Proofs on an ideal plate with e = 0: folds and flips of the cycles (1,k), upper bounds of Gamma_down.

The tangent map of a cycle (1,k) depends on its flight time T alone, and Jury's conditions of it have no poles
on [0, 2 pi k]: their zeros can be counted. A fold is a simple zero of 1 - tr + det, by the implicit function
theorem: the equations of a cycle with T given are regular, and Gamma is stationary along them just where
those with Gamma given are singular.
"""

from functools import partial
from typing import Final

from flint import arb, arb_mat, arb_series, ctx

from kernel.cycles.folds import Cycle, Fold
from kernel.proofs.balls import NotProvenError, flow, with_enough_bits
from kernel.proofs.cycles import START, STEPS, Cycles, Guess, Law, Proven, amplitude

#: How far an event may lie from its guess, rad.
_NEAR: Final = 1e-9
#: Flight times beside a fold over which stability is shown in one ball: at most, and at least.
_WIDEST: Final = 1e-3
_NARROWEST: Final = 1e-12
#: How far from the fold of a longer word stability is shown, tried in turn.
_ASIDE: Final = (1e-6, -1e-6, 1e-5, -1e-5, 1e-4, -1e-4)
#: The narrowest stretch that is divided in the search for all zeros.
_SHORTEST: Final = 1e-9

#: Jury's conditions: 1 - tr + det is zero at folds, 1 + tr + det at flips, 1 - det at tori.
FOLDS, FLIPS, TORI = range(3)


def prove_event(which: int, omega: float | str, xi: float | str, periods: int, flight_time: float) -> Proven:
    """The fold or flip of (1, periods) beside a flight time. Raises `NotProvenError`."""

    def prove() -> Proven:
        branch = _Branch(omega, xi, periods)
        t = branch.zero(which, arb(flight_time, _NEAR))
        return Proven("exactly one event lies here", amplitude(branch.box(t)), [t])

    return with_enough_bits(prove)


def all_events(which: int, omega: float | str, xi: float | str, periods: int) -> list[arb]:
    """Flight times, a ball each, of every fold or flip of (1, periods), in order. Raises `NotProvenError`.

    Zeros of a Jury condition on [0, 2 pi k]: flips beside poles of Gamma count too.
    """
    return with_enough_bits(lambda: _Branch(omega, xi, periods).zeros(which))


def prove_down(omega: float | str, xi: float | str, fold: Fold) -> Proven:
    """That stable cycles exist just above a fold, from `gamma` on. Raises `NotProvenError`."""
    if fold.cycle.letters == "Ss":
        return with_enough_bits(lambda: _Branch(omega, xi, fold.periods).down(fold.flight_time))
    why = NotProvenError()
    for step in _ASIDE:
        try:
            return with_enough_bits(partial(_beside, omega, xi, fold, step))
        except NotProvenError as error:
            why = error
    raise why


def _beside(omega: float | str, xi: float | str, fold: Fold, step: float) -> Proven:
    """That the cycle of a word is stable whose first flight differs by a step from that at the fold."""
    cycles = Cycles(Law(), omega, xi, guess_of_cycle(fold.cycle))
    says = f"a stable cycle of the word {fold.cycle.word} exists at down_at_most"
    return cycles.stable(cycles.box(arb(fold.flight_time) + step, by_flight=True), says)


def guess_of_cycle(cycle: Cycle) -> Guess:
    """A cycle of `kernel.cycles`."""
    return Guess(cycle.letters, cycle.periods, cycle.unknowns.tolist())


class _Branch:
    """The branch (1, periods), at the present precision."""

    def __init__(self, omega: float | str, xi: float | str, periods: int) -> None:
        self._periods, self._whole = periods, 2 * periods * arb.pi()
        self._cycles = Cycles(Law(), omega, xi, Guess("Ss", periods, [0] * (START + 2)))
        fly, stick, b = self._cycles.flight, self._cycles.contact, self._cycles.b
        # a landing, of variations at fixed phase
        land = arb_mat([[0] * 7, [0] * 7, [1, 0, 1, *[0] * 4], [-b, 1, 0, 1, 0, 0, 0], *[[0] * 7] * 3])
        self._land, self._land_by_t = land, land * fly - stick * land
        self._of = arb_mat([[0, 0, 1, *[0] * 4], [0, 0, 0, 1, 0, 0, 0]])

    def box(self, t: arb) -> list[arb]:
        """The cycles with flight times in a ball. With T given their equations are linear: any guess does."""
        self._cycles.guess[START:] = [self._whole.mid() - t.mid(), t.mid()]
        return self._cycles.box(t, by_flight=True)

    def down(self, flight_time: float) -> Proven:
        """Stable cycles at every Gamma from just above a fold."""
        fold, reach = self.zero(FOLDS, arb(flight_time, _NEAR)), _WIDEST
        side = 1 if self._jury(fold)[FOLDS][1] > 0 else -1
        near = fold.mid() + side * arb(2) ** (-ctx.prec // 3)
        while True:
            try:
                low, high = self._stable_between(near, fold.mid() + side * arb(reach), side)
                break
            except NotProvenError:
                reach *= 0.25
                if reach < _NARROWEST:
                    raise
        what = f"a stable cycle (1,{self._periods}) exists"
        return Proven(f"{what} for every Gamma from down_at_most to {float(high):.9g}", low, [fold])

    def _stable_between(self, near: arb, far: arb, side: int) -> tuple[arb, arb]:
        """The Gamma between which cycles of all flight times between are stable and admissible."""
        beside = near.union(far)
        folds, flips, tori = self._jury(beside)
        if not (self._jury(near)[FOLDS][0] > 0 and folds[1] * side > 0):
            raise NotProvenError("1 - tr + det may not grow away from the fold")
        if not (flips[0] > 0 and tori[0] > 0):
            raise NotProvenError("the other multiplier may not be inside the unit circle")
        self._cycles.check_admissible(self.box(beside))
        low, high = amplitude(self.box(near)).upper(), amplitude(self.box(far)).lower()
        if not low < high:
            raise NotProvenError("the fold is no minimum of Gamma")
        return low, high

    def zero(self, which: int, t: arb) -> arb:
        """The only zero of a condition in a ball, as sharp as the precision allows (interval Newton)."""
        if not t.contains(self._newton(which, t)):
            raise NotProvenError("no simple zero is near")
        for _ in range(STEPS):
            t = self._newton(which, t)
        return t

    def _newton(self, which: int, t: arb) -> arb:
        """Where zeros in a ball lie, if any. If that is inside the ball, there is exactly one."""
        return t.mid() - self._jury(t.mid())[which][0] / self._jury(t)[which][1]

    def zeros(self, which: int) -> list[arb]:
        """A ball for every zero of a condition on [0, 2 pi k], in order."""
        stretches, zeros = [arb(0).union(self._whole)], list[arb]()
        while stretches:
            t = stretches.pop()
            value, slope = self._jury(t)[which]
            if value != 0 or self._jury(t.mid())[which][0] + slope * (t - t.mid()) != 0:
                continue
            if slope != 0 and t.contains(self._newton(which, t)):
                zeros.append(self.zero(which, t))
            elif t.rad() < _SHORTEST:
                raise NotProvenError(f"a zero that may be double, near {float(t):.9g} rad")
            else:
                stretches += [t.mid().union(t.upper()), t.lower().union(t.mid())]
        return zeros

    def _jury(self, t: arb) -> list[tuple[arb, arb]]:
        """Jury's conditions of the tangent map of (q, q'), and their derivatives by T."""
        before = flow(self._cycles.flight, t) * self._of.transpose()
        after = self._of * flow(self._cycles.contact, self._whole - t)
        maps = after * self._land * before, after * self._land_by_t * before
        a, b, c, d = (arb_series(list(pair)) for pair in zip(*(x.entries() for x in maps), strict=True))
        trace, det = a + d, a * d - b * c
        return [(condition[0], condition[1]) for condition in (1 - trace + det, 1 + trace + det, 1 - det)]
