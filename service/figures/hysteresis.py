"""Fig. 9: where bouncing begins on the way up, and where it ends on the way down."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import xarray
from numpy.typing import NDArray

from kernel.threshold import threshold
from service.client import Job
from service.figures.canvas import BLUE, Drawing, minor_ticks, page, styled
from service.figures.caption import Caption, Claim
from service.figures.thresholds import FINE, apart, extremum
from service.presets import XI

#: Higher than where the curves part, Γ.
TOP: Final = 1.6
#: Minima less deep than this are steps of the grid.
DEPTH: Final = 0.02
#: Two thresholds further apart than this are two, in steps of Γ.
APART: Final = 3
#: Below this Ω it matters where the ramp down began.
SLOW: Final = 0.5


@styled
def draw(job: Job, lower: Job) -> Drawing:
    """Up in gray, down in black, as printed; Eq. 25 under them."""
    loop, from_lower = job.threshold(xi=XI), lower.threshold(xi=XI)
    gamma = job.spec["gamma"]
    step = (gamma["stop"] - gamma["start"]) / (gamma["num"] - 1)
    drawing, room = page(3.1, _caption(loop, from_lower, step, job.spec["settle"] + job.spec["observe"]))
    axes = room.subplots()
    omega = loop.omega.values
    axes.plot(omega, loop.up.values, color="0.7", linewidth=3, label=r"$\Gamma$ increased")
    axes.plot(omega, loop.down.values, color="black", marker="s", markersize=2, linewidth=0.8,
              label=r"$\Gamma$ decreased")  # fmt: skip
    axes.plot(FINE, threshold(FINE, XI), color=BLUE, linewidth=0.9, linestyle=(0, (4, 2)), label="Eq. 25")
    axes.set_xlim(0, float(loop.omega[-1]))
    axes.set_ylim(0, TOP)
    axes.set_xlabel(r"$\Omega$", labelpad=1)
    axes.set_ylabel(r"$\Gamma$")
    axes.legend(loc="upper left")
    minor_ticks(axes)
    return drawing


def minima(values: NDArray[np.float64], depth: float) -> list[int]:
    """Places of the local minima that the values rise from by `depth` or more on both sides."""
    return [
        place
        for place in range(1, len(values) - 1)
        if values[place] <= values[place - 1]
        and values[place] < values[place + 1]
        and min(_rise(values[place::-1]), _rise(values[place:])) >= depth
    ]


def _rise(values: NDArray[np.float64]) -> float:
    """How high the values rise over the first one before they fall below it."""
    below = np.flatnonzero(values < values[0])
    return float(np.max(values[: below[0]] if len(below) else values) - values[0])


def _caption(loop: xarray.Dataset, lower: xarray.Dataset, step: float, periods: int) -> Caption:
    at, highest = extremum(XI, upper=True)
    shows = (
        f"Threshold at ξ = 0.05 with Γ increased (gray: lowest Γ that bounces) and decreased (black: last Γ "
        f"that bounces) in steps of {step:.2g}, {periods} plate periods each, on an ideal plate; dashed, "
        f"Eq. 25. Its maximum, {highest:.1f} at Ω = {at:.3f}, lies outside the frame."
    )
    return Caption(9, shows, (_on_eq_25(loop), _lower(loop), _several(loop), _coexist(loop, lower, step)))


def _on_eq_25(loop: xarray.Dataset) -> Claim:
    worst = apart(loop)
    return Claim(worst < 0.03, f"the gray curve is Eq. 25 (at most {100 * worst:.1f} % apart)")


def _lower(loop: xarray.Dataset) -> Claim:
    gain = 1.0 - (loop.down / loop.up).values
    at = int(np.nanargmax(gain))
    return Claim(
        bool(gain[at] > 0.1),
        f"bouncing goes on below it, most at Ω = {float(loop.omega[at]):.2f}: down to "
        f"Γ = {float(loop.down[at]):.3f} instead of {float(loop.up[at]):.3f}",
    )


def _several(loop: xarray.Dataset) -> Claim:
    places = minima(loop.down.values, DEPTH)
    told = ", ".join(f"{float(loop.omega[place]):.2f}" for place in places)
    return Claim(len(places) > 1, f"decreased, it has {len(places)} minima: Ω = {told}")


def _coexist(loop: xarray.Dataset, lower: xarray.Dataset, step: float) -> Claim:
    """Not in the paper: whether it matters how large the "large amplitude" was."""
    same = loop.down.sel(omega=lower.omega, method="nearest").values
    moved = np.abs(lower.down.values - same) > APART * step
    slow = lower.omega.values < SLOW
    told: Sequence[int] = (
        int(moved[slow].sum()),
        int(slow.sum()),
        int(moved[~slow].sum()),
        int((~slow).sum()),
    )
    return Claim(
        False,  # left open, whatever comes of it
        "the amplitude that the ramp down begins with is not stated; where modes coexist it may matter: from "
        f"Γ = 1.2 instead of 3, {told[0]} of {told[1]} thresholds below Ω = 0.5 and {told[2]} of {told[3]} "
        "from 0.5 to 0.8 are others",
    )
