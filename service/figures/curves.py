"""Curves of events over Ω, where hysteresis ends, and the energy of the cycles at which bouncing ends."""

from functools import lru_cache
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from kernel.branches.curves import Curves, Parameter
from kernel.branches.curves import curves as bifurcation_curves
from kernel.branches.energy import Energy
from kernel.branches.events import Kind
from kernel.branches.tips import Tip, deepest, end_of_hysteresis, soft_landing, tip
from kernel.threshold import threshold
from service.figures.canvas import (
    BLUE,
    GREEN,
    ORANGE,
    RED,
    Drawing,
    minor_ticks,
    new_drawing,
    split,
    styled,
)
from service.figures.caption import Caption, Claim, computed, percent
from service.figures.prediction import OMEGAS, predictions
from service.presets import XI

#: Ω of the curves, and Γ in the frame.
RANGE: Final = (0.25, 0.86)
FRAME: Final = (0.42, 1.45)

#: Kinds of curves: colour, line style and name.
LINES: Final = {
    Kind.FOLD: (BLUE, "-", "fold"),
    Kind.FLIP: (ORANGE, (0, (5, 1.5)), "flip"),
    Kind.NEIMARK_SACKER: (GREEN, (0, (1, 1)), "Neimark–Sacker"),
}
POINTS: Final = {
    Kind.CUSP: (BLUE, "o", "cusp"),
    Kind.BOGDANOV_TAKENS: (GREEN, "D", "Bogdanov–Takens"),
}

#: Minima of the descending threshold that are drawn.
TIPS: Final = (1, 2, 3, 4)


@lru_cache
def event_curves() -> Curves:
    """Fold, flip and Neimark–Sacker curves of (1, 1) over Ω."""
    return bifurcation_curves(Parameter.OMEGA, XI, *RANGE, 1, tuple(LINES), lines=13)


@styled
def draw() -> Drawing:
    """Above, the curves over Ω; below, the tips over ξ, which end where they reach Γ_th."""
    found = event_curves()
    ends = [end_of_hysteresis(j, 1) for j in TIPS]
    drawing, area = new_drawing(5.1, _caption(found, ends))
    above, below = split(area, 3.2, 1.9)
    axes = above.subplots()
    grid = np.linspace(*RANGE, 600)
    axes.plot(grid, threshold(grid, XI), color="0.7", linewidth=2.6, label=r"$\Gamma_{\mathrm{th}}$, Eq. 25")
    for kind, (colour, style, name) in LINES.items():
        label: str | None = name
        for curve in found.curves:
            if curve.kind != kind:
                continue
            gamma = np.where(curve.admissible == 0, curve.gamma, np.nan)
            axes.plot(curve.omega, gamma, color=colour, linestyle=style, label=label)
            label = None
    for kind, (colour, marker, name) in POINTS.items():
        keep = (found.points.kind == kind) & (found.points.admissible == 0)
        axes.plot(found.points.omega[keep], found.points.gamma[keep], linestyle="none", marker=marker,
                  label=name, markersize=4.4, markerfacecolor="white", markeredgecolor=colour,
                  zorder=5)  # fmt: skip
    for j in TIPS:
        at = tip(j, 1, XI)
        axes.annotate(rf"$\Omega_{{{j}1}}$", (at.omega, at.gamma), (0, -9), textcoords="offset points",
                      fontsize=8, ha="center")  # fmt: skip
    axes.set_xlim(*RANGE)
    axes.set_ylim(*FRAME)
    axes.set_xlabel(r"$\Omega$", labelpad=1)
    axes.set_ylabel(r"$\Gamma$")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, columnspacing=1.6, handlelength=2)
    minor_ticks(axes)
    _draw_ends(below.subplots(), ends)
    return drawing


def _draw_ends(axes: Axes, ends: list[Tip]) -> None:
    """How far each tip lies below Γ_th, over ξ."""
    colours = (BLUE, ORANGE, GREEN, RED)
    for j, end, colour in zip(TIPS, ends, colours, strict=True):
        xi = np.linspace(0.004, end.xi, 24)
        depth = [_depth(deepest(j, 1, float(value))) for value in xi]
        axes.plot(xi, depth, color=colour, label=rf"$\Omega_{{{j}1}}$")
        axes.plot([end.xi], [_depth(end)], marker="o", markersize=4, markerfacecolor="white",
                  markeredgecolor=colour, zorder=5)  # fmt: skip
    axes.axvline(XI, color="0.8", linewidth=0.8, zorder=0)
    axes.set_xlim(0, 0.12)
    axes.set_ylim(0, 1)
    axes.set_xlabel(r"$\xi$", labelpad=1)
    axes.set_ylabel(r"$1 - \Gamma_{\mathrm{down}}/\Gamma_{\mathrm{th}}$")
    axes.legend(loc="upper right", ncols=2)
    minor_ticks(axes)


def _depth(at: Tip) -> float:
    """1 - Γ/Γ_th at a tip."""
    return 1.0 - at.gamma / float(threshold(at.omega, at.xi))


def _caption(found: Curves, ends: list[Tip]) -> Caption:
    shows = (
        f"Where cycles (1, 1) fold, double their period or become tori at ξ = {XI:g}, and the points "
        "at which these curves meet; only cycles that the spring has. Below: how far the folds of each "
        "minimum reach under Γ_th; circles: where hysteresis with rest ends."
    )
    last = ", ".join(f"{end.xi:.5f}" for end in ends)
    return Caption("curves", shows, (_on_points(found), computed(f"the minima end at ξ = {last}")))


def _on_points(found: Curves) -> Claim:
    points = found.points
    names = {Kind.CUSP: "cusps", Kind.BOGDANOV_TAKENS: "Bogdanov–Takens points"}
    texts = [
        f"{name} at Ω = " + ", ".join(f"{value:.5f}" for value in points.omega[points.kind == kind])
        for kind, name in names.items()
    ]
    return computed("; ".join(texts))


def energies() -> tuple[NDArray[np.float64], list[Energy]]:
    """Ω and energy of the cycles at the folds of `predictions`."""
    folds = [(each.omega, each.energy) for each in predictions() if each.energy is not None]
    return np.array([omega for omega, _ in folds]), [balance for _, balance in folds]


def impact_share(balance: Energy) -> float:
    """The part of what a cycle loses that its impact takes."""
    return float((balance.impact / (balance.impact + balance.dashpot))[0])


@styled
def draw_energy() -> Drawing:
    """Above, Γ_down; below, what impact and dashpot take at the cycle that ends there."""
    omega, balances = energies()
    share = np.array([impact_share(balance) for balance in balances])
    drawing, area = new_drawing(3.9, _energy_caption(omega, share))
    axes, shares = area.subplots(2, 1, height_ratios=(1.6, 2.1))
    grid = np.linspace(OMEGAS[0], 0.75, 400)
    axes.plot(grid, threshold(grid, XI), color="0.7", linewidth=2.6)
    # a run of folds is drawn as one line, interrupted where bouncing does not end at a fold
    line = np.array([each.down if each.fold is not None else np.nan for each in predictions()])
    axes.plot(OMEGAS, line, color=BLUE)
    parts = np.full(len(OMEGAS), np.nan)
    parts[np.searchsorted(OMEGAS, omega)] = share
    shares.fill_between(OMEGAS, 0, 100 * parts, color=RED, alpha=0.75, linewidth=0, label="impact")
    shares.fill_between(OMEGAS, 100 * parts, 100, color=BLUE, alpha=0.35, linewidth=0, label="dashpot")
    for each in (axes, shares):
        for j in TIPS:
            each.axvline(soft_landing(j, 1)[0], color="black", linewidth=0.7, linestyle=(0, (2, 2)), zorder=4)
        each.set_xlim(OMEGAS[0], 0.75)
        minor_ticks(each)
    axes.set_ylim(0.45, 1.05)
    axes.set_ylabel(r"$\Gamma$")
    axes.tick_params(labelbottom=False)
    for j in TIPS:
        axes.annotate(rf"$\Omega_{{{j}1}}$", (soft_landing(j, 1)[0], 1.05), (0, 2), ha="center", fontsize=8,
                      textcoords="offset points", annotation_clip=False)  # fmt: skip
    shares.set_ylim(0, 100)
    shares.set_xlabel(r"$\Omega$", labelpad=1)
    shares.set_ylabel("lost per cycle (%)")
    shares.legend(loc="lower right", frameon=True, framealpha=1, edgecolor="none")
    return drawing


def _energy_caption(omega: NDArray[np.float64], share: NDArray[np.float64]) -> Caption:
    shows = (
        f"Above: Γ_th (gray) and the lower fold, Γ_down (blue), at ξ = {XI:g}. Below: where the energy goes "
        "that the plate gives to the cycle at that fold. Dashed: the frequencies Ω_j1 at which a spring "
        "without damping hops on a plate at rest and lands softly."
    )
    claims = []
    for j in TIPS[:2]:
        near = np.abs(omega - soft_landing(j, 1)[0])
        at = int(np.argmin(np.where(near < 0.03, share, np.inf)))
        claims.append(
            computed(f"the impact takes least, {percent(share[at])}, at Ω = {omega[at]:.3f} next to Ω_{j}1")
        )
    return Caption("energy", shows, tuple(claims))
