"""Folds at which stable cycles end on the way down, and the lifetime of bouncing below a fold."""

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from kernel.cycles.closed_form import TWO_PI, floquet, gamma_and_slope, orbit
from kernel.cycles.energy import Energy, energy
from kernel.cycles.events import Events, Kind
from kernel.cycles.roots import Floats
from kernel.cycles.spring import Spring

#: Flights longer than this, rad, count in the name of a cycle with rebound.
MICRO_FLIGHT: Final = 0.05

#: Step of derivatives at a fold, relative to T. Their relative error is its square.
_DIFFERENCE: Final = 1e-4


class Cycle(NamedTuple):
    """A cycle by its segments (see `kernel.cycles.segments`), without its equations."""

    letters: str
    periods: int
    unknowns: Floats  # (m,) gap', q, q', c, s at the start, and the durations

    @property
    def word(self) -> str:
        """The letters of its flights, on an ideal plate without restitution; empty for other contacts.

        A cycle may begin with any flight. The alphabetically last word gives it one name.
        """
        word = self.letters.replace("S", "") if set(self.letters) <= set("Ssz") else ""
        return max((word[i:] + word[:i] for i in range(len(word))), default="")

    @property
    def name(self) -> str:
        """Word, bounces and plate periods, such as `zs (2,2)` or `(1,1)`."""
        times = self.unknowns[-len(self.letters) :]
        flights = [t for t, letter in zip(times, self.letters, strict=True) if letter not in "SC"]
        bounces = len(self.word) or max(sum(t > MICRO_FLIGHT for t in flights), 1)
        return f"{self.word if bounces > 1 else ''} ({bounces},{self.periods})".strip()


class Fold(NamedTuple):
    """A minimum of Gamma along a branch. Primes are derivatives by T, or along the branch."""

    cycle: Cycle
    flight_time: float  # rad, of the first flight
    gamma: float
    other_multiplier: complex  # the largest that is not 1
    curvature: float  # Gamma'' > 0
    slope: float  # of the multiplier that is 1
    violations: int  # 0, or the bits of a Reason
    energy: Energy | None  # of the cycle, on an ideal plate without restitution

    @property
    def periods(self) -> int:
        """Plate periods of the cycle."""
        return self.cycle.periods

    @property
    def holds(self) -> bool:
        """Whether a stable cycle of the spring ends here."""
        return not self.violations and abs(self.other_multiplier) < 1.0

    @property
    def name(self) -> str:
        """The fold as a cause of a threshold: `fold (1,2)`, or `fold of word zs (2,2)`."""
        return f"fold {'of word ' if len(self.cycle.word) > 1 else ''}{self.cycle.name}"


def lifetime(fold: Fold, below: float) -> float:
    """Plate periods for which bouncing lasts at Gamma = fold.gamma - below, below > 0.

    It lingers at the ghost of the fold. Let x be a slow coordinate, such as a flight time. At a distance
    delta below the fold it moves by -delta lambda'/Gamma'' + lambda' x**2/2 per cycle, lambda' = d lambda/dT,
    and passes in N = (pi/|lambda'|) sqrt(2 Gamma''/delta) cycles. The law holds for delta -> 0, and for any
    coordinate along the branch.
    """
    cycles = math.pi / abs(fold.slope) * math.sqrt(2.0 * fold.curvature / below)
    return cycles * fold.periods


def minima(k: Spring, events: Events, below: float) -> Iterator[Fold]:
    """The folds of a (1,k) branch that are minima of Gamma, below a Gamma."""
    for i in np.flatnonzero((events.kind == Kind.FOLD) & (events.gamma < below)):
        t, n = float(events.flight_time[i]), int(events.periods[i])
        step = _DIFFERENCE * t
        _, (before, after) = gamma_and_slope(k, n, np.array([t - step, t + step]))
        curvature = float(after - before) / (2.0 * step)
        if not curvature > 0.0:
            continue
        f = floquet(k, n, np.array([t]))
        other = float(f.det[0])  # det is the product of both multipliers, and one is 1
        slope = float((f.trace1[0] - f.det1[0]) / (1.0 - other))
        balance = energy(float(np.real(k.omega)), float(np.real(k.xi)), n, np.array([t]))
        yield Fold(
            one_flight(k, n, t), t, float(events.gamma[i]), other, curvature, slope,
            int(events.violations[i]), balance,
        )  # fmt: skip


def one_flight(k: Spring, periods: int, flight_time: float) -> Cycle:
    """The cycle of one flight of flight_time rad in `periods` plate periods."""
    x = orbit(k, periods, np.array([flight_time]))
    landing = (x.c[0] + 1j * x.s[0]) * np.exp(1j * flight_time)
    start = [0.0, x.q_land[0], x.v_land[0], landing.real, landing.imag]
    return Cycle("Ss", periods, np.array([*start, TWO_PI * periods - flight_time, flight_time]))
