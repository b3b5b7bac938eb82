"""Where bouncing ends on the way down, and where flights leap on the way up (docs/hysteresis.md).

Rest ends at Gamma_th (Eq. 25) and bouncing exists above it. Below it bouncing lives on as long as a stable
cycle does. If that is a (1,k) cycle it ends at a fold, a minimum of Gamma along its branch, and

    Gamma_down = min(Gamma_th, the lowest admissible fold whose other multiplier is inside the unit circle).

The branches themselves show where this does not decide: a branch turns below the answer at a fold that is
not stable on either side (a torus lives near it), or not admissible (the branch goes on as another word), or
a stable cycle ends below the answer otherwise than at a fold. Then the answer is `unresolved`.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from kernel.branches.closed_form import floquet, gamma_slope, orbit, stable
from kernel.branches.energy import Energy, energy
from kernel.branches.events import Branch, Events, Kind, branch, branch_and_events, flight_times, fold_events
from kernel.branches.spring import Spring, spring
from kernel.threshold import threshold

#: Branches (1,1) to (1,k) are looked at.
PERIODS: Final = 6

#: Stable cycles are looked for on the grid up to this many times Gamma_th: one that ends at a fold below
#: Gamma_th has a neighbour on the grid that is higher by Gamma'' h**2/2 at most, some 1e-3.
_MARGIN: Final = 1.05

#: Step of the second derivative of Gamma, relative to T; its square is the relative error.
_DIFFERENCE: Final = 1e-4

EQ_25: Final = "Eq. 25"
UNRESOLVED: Final = "unresolved"


class Fold(NamedTuple):
    """A minimum of Gamma along a (1, periods) branch."""

    periods: int
    flight_time: float  # rad
    gamma: float
    other_multiplier: float  # the one that is not 1
    curvature: float  # d2Gamma/dT2, > 0
    slope: float  # d/dT of the multiplier that is 1
    admissible: int  # 0, or the bits of a Reason


class Thresholds(NamedTuple):
    """The thresholds of a spring under a plate."""

    omega: float
    xi: float
    gamma_th: float  # Eq. 25: rest ends on the way up
    jump: float  # the fold at which flights leap on the way up; NaN if there is none
    down: float  # bouncing ends on the way down; NaN if unresolved
    cause: str  # "Eq. 25", "fold (1,k)" or "unresolved"
    reason: str  # why it is unresolved, or empty
    fold: Fold | None  # at `down`
    energy: Energy | None  # of the cycle at the fold


def thresholds(omega: float, xi: float, periods: int = PERIODS) -> Thresholds:
    """The thresholds, from the branches (1,1) to (1, periods). Raises KernelInputError."""
    gamma_th = float(threshold(omega, xi))
    k = spring(omega, xi)
    jump, folds, ends = math.nan, [], []
    for n in range(1, periods + 1):
        if n > 1 and not _reaches(k, omega, xi, n, gamma_th):
            folds += _minima(k, fold_events(omega, xi, n, gamma_th), gamma_th)
            continue
        line, events = branch_and_events(omega, xi, n)
        folds += _minima(k, events, gamma_th)
        ends += _ends(line, events, gamma_th)
        if n == 1:
            jump = _jump(line, events)
    holding = [fold for fold in folds if not fold.admissible and abs(fold.other_multiplier) < 1.0]
    lowest = min(holding, key=lambda fold: fold.gamma, default=None)
    down = lowest.gamma if lowest else gamma_th
    reasons = [_why(fold) for fold in folds if fold not in holding and fold.gamma < down]
    reasons += [text for gamma, text in ends if gamma < down]
    if reasons:
        return Thresholds(
            omega, xi, gamma_th, jump, math.nan, UNRESOLVED, "; ".join(dict.fromkeys(reasons)), None, None
        )
    if lowest is None:
        return Thresholds(omega, xi, gamma_th, jump, gamma_th, EQ_25, "", None, None)
    balance = energy(omega, xi, lowest.periods, np.array([lowest.flight_time]))
    cause = f"fold (1,{lowest.periods})"
    return Thresholds(omega, xi, gamma_th, jump, down, cause, "", lowest, balance)


def lifetime(fold: Fold, below: float) -> float:
    """Plate periods that bouncing lives at Gamma = fold.gamma - below, below > 0: the ghost of the fold.

    Near a fold the slow coordinate x (a flight time) moves by lambda' x per cycle to lowest order in x, and
    delta below it by -delta lambda'/Gamma'' + lambda' x**2/2 with |lambda'| = |d lambda/dT|, which it crosses
    in N = (pi/|lambda'|) sqrt(2 Gamma''/delta) cycles. The law holds for delta -> 0.
    """
    cycles = math.pi / abs(fold.slope) * math.sqrt(2.0 * fold.curvature / below)
    return cycles * fold.periods


def _reaches(k: Spring, omega: float, xi: float, periods: int, below: float) -> bool:
    """Whether a branch has a stable admissible cycle below a Gamma, between folds that is: on its grid."""
    t = flight_times(omega, xi, periods)
    x, f = orbit(k, periods, t), floquet(k, periods, t)
    t = t[stable(f.trace, f.det) & (np.hypot(x.c, x.s) < _MARGIN * below)]
    return len(t) > 0 and bool((branch(omega, xi, periods, t).admissible == 0).any())


def _minima(k: Spring, events: Events, below: float) -> list[Fold]:
    """The folds below a Gamma that are minima of it."""
    found = []
    for i in np.flatnonzero((events.kind == Kind.FOLD) & (events.gamma < below)):
        t, n = float(events.flight_time[i]), int(events.periods[i])
        step = _DIFFERENCE * t
        before, after = gamma_slope(k, n, np.array([t - step, t + step]))
        f = floquet(k, n, np.array([t]))
        other = float(f.det[0])  # the product of both
        slope = float((f.trace1[0] - f.det1[0]) / (1.0 - other))
        fold = Fold(
            n, t, float(events.gamma[i]), other, float(after - before) / (2.0 * step), slope,
            int(events.admissible[i]),
        )  # fmt: skip
        if fold.curvature > 0.0:
            found.append(fold)
    return found


def _why(fold: Fold) -> str:
    """Why a fold below the answer does not decide."""
    name = f"the fold of (1,{fold.periods}) at Gamma = {fold.gamma:.6f}"
    if fold.admissible:
        return f"{name} is not admissible: the branch goes on as another word"
    return f"{name} is unstable on both sides: a torus may live near it"


def _ends(line: Branch, events: Events, below: float) -> list[tuple[float, str]]:
    """Where stable cycles end below a Gamma, on the way down, otherwise than at a fold: Gamma and how."""
    lives = line.stable & (line.admissible == 0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lives, [False]])))
    found = []
    for first, last in edges.reshape(-1, 2):
        for inside, outside in ((first, first - 1), (last - 1, last)):
            if not 0 <= outside < len(lives):
                continue  # T -> 0 is Eq. 25; at T -> 2 pi k a contact vanishes, far above
            low, high = sorted((line.flight_time[inside], line.flight_time[outside]))
            here = (events.flight_time >= low) & (events.flight_time <= high)
            if line.gamma[outside] > line.gamma[inside] or (here & (events.kind == Kind.FOLD)).any():
                continue
            for i in np.flatnonzero(here & (events.gamma < below)):
                text = f"(1,{line.periods}) ends at a {events.kind[i]} at Gamma = {events.gamma[i]:.6f}"
                found.append((float(events.gamma[i]), text))
    return found


def _jump(line: Branch, events: Events) -> float:
    """The fold that ends the cycles that begin at Gamma_th; NaN if they end otherwise."""
    lives = line.stable & (line.admissible == 0)
    if not lives[0] or lives.all():
        return math.nan
    last = int(np.argmin(lives))
    here = (events.flight_time >= line.flight_time[last - 1]) & (events.flight_time <= line.flight_time[last])
    folds = np.flatnonzero(here & (events.kind == Kind.FOLD))
    return float(events.gamma[folds[0]]) if len(folds) else math.nan
