"""Fig. 9: the threshold with Γ increased, and with Γ decreased."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import xarray
from numpy.typing import NDArray

from kernel.threshold import threshold
from service.client import Job
from service.figures.canvas import BLUE, Drawing, minor_ticks, new_drawing
from service.figures.caption import Caption, Claim, compared, left_open, percent
from service.figures.thresholds import OMEGA_GRID, extremum, max_relative_difference
from service.presets import XI

#: The top of the frame, above the Γ where the curves differ.
MAX_GAMMA: Final = 1.6
#: Shallower minima, in Γ, come from the steps of the grid.
MIN_DEPTH: Final = 0.02
#: Thresholds count as different if they are more steps of Γ apart than this.
STEPS_APART: Final = 3
#: Below this Ω the threshold depends on where the ramp down begins.
SLOW: Final = 0.5


def draw(job: Job, lower: Job) -> Drawing:
    """Up in gray and down in black, as printed, with Eq. 25."""
    loop, from_lower = job.threshold(xi=XI), lower.threshold(xi=XI)
    step = gamma_step(job.spec)
    drawing, area = new_drawing(3.1, _caption(loop, from_lower, step, job.spec))
    axes = area.subplots()
    omega = loop.omega.values
    axes.plot(omega, loop.up.values, color="0.7", linewidth=3, label=r"$\Gamma$ increased")
    axes.plot(omega, loop.down.values, color="black", marker="s", markersize=2, linewidth=0.8,
              label=r"$\Gamma$ decreased")  # fmt: skip
    axes.plot(
        OMEGA_GRID,
        threshold(OMEGA_GRID, XI),
        color=BLUE,
        linewidth=0.9,
        linestyle=(0, (4, 2)),
        label="Eq. 25",
    )
    axes.set_xlim(0, float(loop.omega[-1]))
    axes.set_ylim(0, MAX_GAMMA)
    axes.set_xlabel(r"$\Omega$", labelpad=1)
    axes.set_ylabel(r"$\Gamma$")
    axes.legend(loc="upper left")
    minor_ticks(axes)
    return drawing


def gamma_step(spec: Mapping[str, Any]) -> float:
    """The step of a ramp over a range of Γ."""
    gamma = spec["gamma"]
    return float((gamma["stop"] - gamma["start"]) / (gamma["num"] - 1))


def minima(values: NDArray[np.float64], depth: float) -> list[int]:
    """Indices of the local minima from which the values rise by `depth` or more on both sides."""
    return [
        i
        for i in range(1, len(values) - 1)
        if values[i] <= values[i - 1]
        and values[i] < values[i + 1]
        and min(_rise(values[i::-1]), _rise(values[i:])) >= depth
    ]


def _rise(values: NDArray[np.float64]) -> float:
    """How far the values rise above the first one before they fall below it; NaN among them is no value."""
    below = np.flatnonzero(values < values[0])
    return float(np.nanmax(values[: below[0]] if len(below) else values) - values[0])


def _caption(loop: xarray.Dataset, lower: xarray.Dataset, step: float, spec: Mapping[str, Any]) -> Caption:
    at, highest = extremum(XI, upper=True)
    shows = (
        "Threshold at ξ = 0.05 with Γ increased (gray: lowest Γ that bounces) and decreased (black: last Γ "
        f"that bounces) in steps of {step:.2g}, {spec['settle'] + spec['observe']} plate periods each and up "
        f"to {spec['settle_until']:,} while flights still settle, on an ideal plate; dashed, Eq. 25. Its "
        f"maximum, {highest:.1f} at Ω = {at:.3f}, lies outside the frame."
    )
    return Caption(9, shows, (_on_eq_25(loop), _lower(loop), _several(loop), _coexist(loop, lower, step)))


def _on_eq_25(loop: xarray.Dataset) -> Claim:
    worst = max_relative_difference(loop)
    return compared(worst < 0.03, f"the gray curve is Eq. 25 (at most {percent(worst, 1)} apart)")


def _lower(loop: xarray.Dataset) -> Claim:
    gain = 1.0 - (loop.down / loop.up).values
    at = int(np.nanargmax(gain))
    return compared(
        bool(gain[at] > 0.1),
        f"bouncing goes on below it, most at Ω = {float(loop.omega[at]):.2f}: down to "
        f"Γ = {float(loop.down[at]):.3f} instead of {float(loop.up[at]):.3f}",
    )


def _several(loop: xarray.Dataset) -> Claim:
    indices = minima(loop.down.values, MIN_DEPTH)
    omegas = ", ".join(f"{float(loop.omega[i]):.2f}" for i in indices)
    return compared(len(indices) > 1, f"decreased, it has {len(indices)} minima: Ω = {omegas}")


def _coexist(loop: xarray.Dataset, lower: xarray.Dataset, step: float) -> Claim:
    """Not in the paper: whether the threshold depends on the "large amplitude" at the start."""
    same = loop.down.sel(omega=lower.omega, method="nearest").values
    moved = np.abs(lower.down.values - same) > STEPS_APART * step
    known = np.isfinite(lower.down.values) & np.isfinite(same)
    slow, fast = (known & side for side in (lower.omega.values < SLOW, lower.omega.values >= SLOW))
    of_slow = f"{moved[slow].sum()} of {slow.sum()}"
    of_fast = f"{moved[fast].sum()} of {fast.sum()}"
    return left_open(
        "the amplitude that the ramp down begins with, which may matter where modes coexist: from "
        f"Γ = 1.2 instead of 3, {of_slow} thresholds below Ω = 0.5 and {of_fast} "
        "from 0.5 to 0.8 are others",
    )
