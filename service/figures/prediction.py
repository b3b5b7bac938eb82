"""The thresholds of Fig. 9 as the closed form predicts them, and as ramps find them."""

from functools import lru_cache
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from kernel.branches.thresholds import UNRESOLVED, Thresholds, thresholds
from kernel.threshold import threshold
from service.client import Job
from service.figures.canvas import BLUE, GREY, ORANGE, RED, Drawing, minor_ticks, new_drawing, styled
from service.figures.caption import Caption, Claim, computed
from service.figures.hysteresis import gamma_step
from service.presets import SEEDED_STEP, XI

#: Frequencies at which the thresholds are predicted.
OMEGAS: Final = np.round(np.linspace(0.25, 0.85, 121), 4)
#: A ramp confirms a fold within this, in Γ.
CONFIRMED: Final = 2e-5
FRAME: Final = (0.45, 1.2)


@lru_cache
def predictions() -> tuple[Thresholds, ...]:
    """The thresholds at OMEGAS."""
    return tuple(thresholds(float(omega), XI) for omega in OMEGAS)


@styled
def draw(loop: Job, *seeded: Job) -> Drawing:
    """Above, Γ over Ω: predicted curves, and what ramps find; below, how far apart they are at the folds."""
    omega, distance = distances(seeded)
    drawing, area = new_drawing(4.4, _caption(loop, omega, distance))
    axes, residuals = area.subplots(2, 1, height_ratios=(3.1, 1.1))
    _draw_predictions(axes)
    found = loop.threshold(xi=XI)
    axes.plot(found.omega, found.down, linestyle="none", marker="s", markersize=2.2, color="black",
              label="ramp down of Fig. 9", zorder=3)  # fmt: skip
    axes.plot(omega, _folds(omega), linestyle="none", marker="o", markersize=3.6, markerfacecolor="white",
              markeredgecolor=RED, markeredgewidth=0.9, label="ramp from the cycle", zorder=4)  # fmt: skip
    axes.set_xlim(OMEGAS[0], OMEGAS[-1])
    axes.set_ylim(*FRAME)
    axes.set_ylabel(r"$\Gamma$")
    axes.tick_params(labelbottom=False)
    axes.legend(loc="lower left", ncols=1, handlelength=1.6)
    minor_ticks(axes)
    residuals.axhspan(-CONFIRMED / SEEDED_STEP, CONFIRMED / SEEDED_STEP, color="0.9", zorder=0)
    residuals.axhline(0, color=BLUE, linewidth=0.8)
    residuals.plot(omega, distance / SEEDED_STEP, linestyle="none", marker="o", markersize=3.2,
                   markerfacecolor="white", markeredgecolor=RED, markeredgewidth=0.9)  # fmt: skip
    residuals.set_xlim(OMEGAS[0], OMEGAS[-1])
    residuals.set_ylim(-5, 5)
    residuals.set_xlabel(r"$\Omega$", labelpad=1)
    residuals.set_ylabel(r"$\Gamma$ − fold  ($10^{-5}$)")
    minor_ticks(residuals)
    return drawing


def distances(seeded: tuple[Job, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ω of each seeded ramp, and how far the last Γ that bounces is above the fold; both (n,)."""
    rows = [job.threshold(xi=XI) for job in seeded]
    omega = np.array([float(row.omega[0]) for row in rows])
    return omega, np.array([float(row.down[0]) for row in rows]) - _folds(omega)


def _folds(omega: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([_fold(float(value)) for value in omega])


@lru_cache(maxsize=256)
def _fold(omega: float) -> float:
    return thresholds(omega, XI).down


def _draw_predictions(axes: Axes) -> None:
    """Γ_th, Γ_jump and Γ_down, with the frequencies at which the branches do not decide shaded."""
    found = predictions()
    jump = np.array([each.jump for each in found])
    down = np.array([each.down if each.fold is not None else np.nan for each in found])  # of words too
    grid = np.linspace(OMEGAS[0], OMEGAS[-1], 600)
    axes.plot(grid, threshold(grid, XI), color="0.7", linewidth=2.6, label=r"$\Gamma_{\mathrm{th}}$, Eq. 25")
    axes.plot(OMEGAS, jump, color=ORANGE, linestyle=(0, (4, 1.5)),
              label=r"$\Gamma_{\mathrm{jump}}$, upper fold")  # fmt: skip
    axes.plot(OMEGAS, down, color=BLUE, label=r"$\Gamma_{\mathrm{down}}$, lower fold")
    half = 0.5 * (OMEGAS[1] - OMEGAS[0])
    label: str | None = "unresolved"
    for each in found:
        if each.cause == UNRESOLVED:
            axes.axvspan(
                each.omega - half, each.omega + half, color=GREY, alpha=0.25, linewidth=0, label=label
            )
            label = None


def _caption(loop: Job, omega: NDArray[np.float64], distance: NDArray[np.float64]) -> Caption:
    unresolved = sum(each.cause == UNRESOLVED for each in predictions())
    shows = (
        f"The three thresholds at ξ = {XI:g} on an ideal plate, predicted in closed form. Squares: the last "
        "Γ that bounces on the ramp down of Fig. 9. Circles: ramps that start on the cycle just above its "
        f"predicted fold and descend in steps of {SEEDED_STEP:.0e}; below, where they end. Shaded: "
        f"{unresolved} of {len(OMEGAS)} frequencies at which the branches (1, k) do not decide."
    ).replace("1e-05", "10⁻⁵")
    return Caption("hysteresis", shows, (_on_folds(omega, distance), _on_ramp(loop)))


def _on_folds(omega: NDArray[np.float64], distance: NDArray[np.float64]) -> Claim:
    inside = np.abs(distance) <= CONFIRMED
    worst = float(np.max(np.abs(distance), initial=0.0))
    at = f", the farthest {1e5 * worst:.1f}·10⁻⁵ away" if len(distance) else ""
    return computed(
        f"{int(inside.sum())} of {len(omega)} ramps from the cycle end within 2·10⁻⁵ of the fold{at}"
    )


def _on_ramp(loop: Job) -> Claim:
    """The ramp of Fig. 9 against the prediction, wherever there is one."""
    found = loop.threshold(xi=XI)
    step = gamma_step(loop.spec)
    known = [each for each in predictions() if each.cause != UNRESOLVED]
    at = np.array([each.omega for each in known])
    near = np.abs(found.omega.values[:, None] - at).argmin(axis=1)
    same = np.isclose(found.omega.values, at[near]) & np.isfinite(found.down.values)
    off = found.down.values[same] - np.array([known[i].down for i in near])[same]
    lower, higher = int((off < -step).sum()), int((off > step).sum())
    return computed(
        f"the ramp of Fig. 9 ends within a step of the prediction at {int(same.sum()) - lower - higher} of "
        f"{int(same.sum())} frequencies, above it at {higher}, where it is on another cycle, and below it at "
        f"{lower}"
    )
