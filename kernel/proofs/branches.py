"""Proofs on an ideal plate with e = 0: folds and flips of the cycles (1,k), upper bounds of Gamma_down.

The tangent map of a cycle (1,k) depends on its flight time T alone. Jury's conditions of it have no poles on
[0, 2 pi k], so that their zeros can be counted. A fold is a simple zero of 1 - tr + det, by the implicit
function theorem: the equations of a cycle with T given are regular, and Gamma is stationary exactly where the
equations with Gamma given are singular.
"""

from functools import partial
from typing import Final

import numpy as np
from flint import arb, arb_mat, arb_series, ctx

from kernel.cycles.events import Kind
from kernel.cycles.folds import Cycle, Fold
from kernel.proofs.balls import NotProvenError, bounds, first_proven, flow
from kernel.proofs.cycles import START, Cycles, Law, Proven, amplitude

#: Largest distance of an event from its guess, and the narrowest stretch that is divided, rad.
_NEAR: Final = 1e-9
#: Distances from a fold up to which stability is shown, rad, tried in turn.
_ABOVE: Final = (1e-3, 1e-4, 1e-5, 1e-6)
#: The same for a longer word, whose stable cycles may be on either side.
_BESIDE: Final = (1e-6, -1e-6, 1e-5, -1e-5, 1e-4, -1e-4)


def prove_down(omega: float, xi: float, fold: Fold) -> Proven:
    """Prove that a stable cycle exists at `gamma`, near a fold. Raises `NotProvenError`.

    For cycles of one flight: that one exists at every Gamma just above the fold.
    """
    prove, asides = (_above, _ABOVE) if fold.cycle.letters == "Ss" else (_beside, _BESIDE)
    return first_proven(*(partial(prove, omega, xi, fold, aside) for aside in asides))


def _above(omega: float, xi: float, fold: Fold, aside: float) -> Proven:
    """Prove that stable cycles exist from the Gamma of a fold to that of a flight time `aside`, rad."""
    branch = Branch(omega, xi, fold.periods)
    _, low, (t,) = branch.event(Kind.FOLD, fold.flight_time)
    far = t + aside if branch.jury(t)[Kind.FOLD][1] > 0 else t - aside
    high, beside = amplitude(branch.box(far, by_flight=True)), branch.jury(t.union(far))
    others = beside[Kind.FLIP][0] > 0 and beside[Kind.NEIMARK_SACKER][0] > 0
    if not (others and beside[Kind.FOLD][1] != 0 and low < high):
        raise NotProvenError("cycles beside the fold may not be stable, or at lower Gamma")
    branch.check_admissible(branch.box(t.union(far), by_flight=True))
    says = f"a stable cycle (1,{fold.periods}) exists for every Gamma from down_at_most"
    return Proven(f"{says} to {bounds(high, 9)[0]}", low, [t])


def _beside(omega: float, xi: float, fold: Fold, aside: float) -> Proven:
    """Prove that a stable cycle exists whose first flight is `aside`, rad, longer than at the fold."""
    cycles = Cycles(Law(), omega, xi, fold.cycle)
    says = f"a stable cycle of the word {fold.cycle.word} exists at down_at_most"
    return cycles.stable(cycles.box(arb(fold.flight_time + aside), by_flight=True), says)


class Branch(Cycles):
    """The branch (1, periods), at the present precision. A given flight time needs no guess of the cycle."""

    def __init__(self, omega: float, xi: float, periods: int) -> None:
        super().__init__(Law(), omega, xi, Cycle("Ss", periods, np.ones(START + 2)))

    def event(self, kind: Kind, flight_time: float) -> Proven:
        """Prove that exactly one fold or flip lies near a flight time, rad. Raises `NotProvenError`."""
        zeros = self.zeros(kind, arb(flight_time, _NEAR))
        if len(zeros) != 1:
            raise NotProvenError("no event is near")
        return Proven("exactly one event lies here", amplitude(self.box(zeros[0], by_flight=True)), zeros)

    def zeros(self, kind: Kind, stretch: arb | None = None) -> list[arb]:
        """Flight times, rad, of all folds or flips in a stretch, in order; each is a ball.

        stretch: by default [0, 2 pi k]. A ball that Newton's operator maps into itself has exactly one zero.
        Flips near poles of Gamma count too. Raises `NotProvenError`.
        """
        stretches, zeros = [arb(0).union(self.whole) if stretch is None else stretch], list[arb]()
        while stretches:
            t = stretches.pop()
            (value, slope), middle = self.jury(t)[kind], self.jury(t.mid())[kind][0]
            if value != 0 or middle + slope * (t - t.mid()) != 0:
                continue
            if slope != 0 and t.contains(t.mid() - middle / slope):
                for _ in range(ctx.prec.bit_length()):
                    t = t.mid() - self.jury(t.mid())[kind][0] / self.jury(t)[kind][1]
                zeros.append(t)
            elif t.rad() < _NEAR:
                raise NotProvenError(f"a zero that may be double, near {float(t):.9g} rad")
            else:
                stretches += [t.mid().union(t.upper()), t.lower().union(t.mid())]
        return zeros

    def jury(self, t: arb) -> dict[Kind, tuple[arb, arb]]:
        """Jury's conditions of the tangent map of (q, q') (> 0: it contracts), and derivatives by T."""
        # the landing of variations at fixed phase
        land = arb_mat([[0] * 7, [0] * 7, [1, 0, 1, *[0] * 4], [-self.b, 1, 0, 1, 0, 0, 0], *[[0] * 7] * 3])
        projection = arb_mat([[0, 0, 1, *[0] * 4], [0, 0, 0, 1, 0, 0, 0]])
        before = flow(self.flight, t) * projection.transpose()
        after = projection * flow(self.contact, self.whole - t)
        maps = after * land * before, after * (land * self.flight - self.contact * land) * before
        a, b, c, d = (arb_series(list(pair)) for pair in zip(*(x.entries() for x in maps), strict=True))
        trace, det = a + d, a * d - b * c
        conditions = {Kind.FOLD: 1 - trace + det, Kind.FLIP: 1 + trace + det, Kind.NEIMARK_SACKER: 1 - det}
        return {kind: (condition[0], condition[1]) for kind, condition in conditions.items()}
