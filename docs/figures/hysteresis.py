"""Draw figure-hysteresis.png here: the thresholds of Fig. 9 in closed form, and as ramps find them.

python docs/figures/hysteresis.py
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray
from matplotlib.figure import Figure

from bouncing_spring import run
from kernel.cycles.starts import start_on_stable_cycle
from kernel.cycles.thresholds import UNRESOLVED, thresholds
from kernel.params import Cell, Outcome
from kernel.threshold import threshold
from service.presets import FIGURES

XI = 0.05
#: Frequencies of the ramps that start on a cycle just above its fold, and their steps in Γ.
OMEGAS = tuple(round(0.27 + 0.01 * i, 2) for i in range(44))
STEP = 1e-5


def seeded(omega: float) -> dict[str, Any] | None:
    """The ramp down to the fold at which bouncing ends; None where it does not end at a fold of (1, k)."""
    end = thresholds(omega, XI)
    if end.fold is None or not end.cause.startswith("fold (1,"):
        return None
    # half a step beside the fold: rounding would decide a cell at the fold itself
    low, high = end.fold.gamma - 5.5 * STEP, end.fold.gamma + 24.5 * STEP
    if start_on_stable_cycle(Cell(high, omega, XI), end.fold.periods) is None:
        return None
    start = {"bounces": 1, "periods": end.fold.periods}
    return {
        "gamma": {"start": low, "stop": high, "num": 31}, "omega": omega, "xi": XI,
        "protocol": {"kind": "ramp", "axis": "gamma", "direction": "down", "start": start},
        "model": {"kind": "rigid"}, "keep": 1,
    }  # fmt: skip


def last_bouncing(spec: Mapping[str, Any]) -> xarray.DataArray:
    """The lowest Γ at which a ramp down bounces, per Ω."""
    sweep = run(spec).sel(direction="down").squeeze("xi")
    return sweep.gamma.where(sweep.outcome != Outcome.AT_REST).min("gamma")


def draw(
    num: int = 121, omegas: Sequence[float] = OMEGAS, loop: Mapping[str, Any] = FIGURES[8].sweeps[0]
) -> tuple[Figure, list[float]]:
    """The figure, and how far from the fold each ramp from its cycle ends.

    `num`: predicted frequencies; `omegas`: those of ramps from the cycle; `loop`: the ramps of Fig. 9.
    """
    grid = np.linspace(0.25, 0.85, num)
    predicted = [thresholds(float(omega), XI) for omega in grid]
    ramps = {omega: spec for omega in omegas if (spec := seeded(omega))}
    folds = [thresholds(omega, XI).down for omega in ramps]
    ends = [float(last_bouncing(spec)[0]) - fold for spec, fold in zip(ramps.values(), folds, strict=True)]

    figure = Figure(figsize=(6.4, 7.2), layout="constrained")
    axes, below = figure.subplots(2, sharex=True, height_ratios=(3, 1))
    axes.plot(grid, threshold(grid, XI), color="0.7", linewidth=3, label=r"$\Gamma_\mathrm{th}$, Eq. 25")
    axes.plot(grid, [end.jump for end in predicted], "C1--", label=r"$\Gamma_\mathrm{jump}$, upper fold")
    down = [np.nan if end.fold is None else end.down for end in predicted]
    axes.plot(grid, down, "C0", label=r"$\Gamma_\mathrm{down}$, lower fold")
    unresolved = [end.cause == UNRESOLVED for end in predicted]
    axes.fill_between(grid, 0, 1, where=unresolved, step="mid", color="0.8", label="unresolved",
                      transform=axes.get_xaxis_transform())  # fmt: skip
    fig_9 = last_bouncing(loop)
    axes.plot(fig_9.omega, fig_9, "ks", markersize=3, label="ramp down of Fig. 9")
    axes.plot(list(ramps), folds, "C3o", mfc="white", label="ramp from the cycle")
    axes.set(xlim=(0.25, 0.85), ylim=(0.45, 1.2), ylabel=r"$\Gamma$")
    axes.legend()
    below.axhspan(-2, 2, color="0.9")
    below.plot(list(ramps), np.array(ends) / STEP, "C3o", mfc="white")
    below.set(ylim=(-5, 5), xlabel=r"$\Omega$", ylabel=r"$\Gamma$ − fold  ($10^{-5}$)")
    return figure, ends


if __name__ == "__main__":
    figure, ends = draw()
    near = sum(abs(end) <= 2 * STEP for end in ends)
    text = f"{near} of {len(ends)} ramps from the cycle end within 2·10⁻⁵ of the fold"
    figure.savefig("figure-hysteresis.png", dpi=150, metadata={"Description": text})
