"""Figs. 5 and 6: where bouncing begins, by Eq. 25 and as computed, and the sections through the diagrams."""

from typing import Final

import numpy as np
import xarray
from matplotlib.axes import Axes

from kernel.threshold import threshold
from service.client import Job
from service.figures.canvas import BLUE, GREEN, ORANGE, RED, Drawing, minor_ticks, page, styled
from service.figures.caption import Caption, Claim
from service.figures.sweeps import DAMPINGS, GAMMAS, OMEGAS, XI

#: Colour, line and mark of each damping.
LOOKS: Final = ((BLUE, "-", "o"), (RED, (0, (5, 1.5)), "s"), (GREEN, (0, (1, 1)), "^"), (ORANGE, "-.", "D"))
TOP: Final = 3.0
LAST: Final = 2.0  # Ω
FINE: Final = np.linspace(0.005, LAST, 1500)


@styled
def draw_dampings(job: Job) -> Drawing:
    """Fig. 5: four curves, with the onsets computed on them."""
    onsets = {xi: job.threshold(xi=xi) for xi in DAMPINGS}
    drawing, room = page(2.9, _dampings_caption(onsets))
    axes = room.subplots()
    for (xi, onset), (colour, line, mark) in zip(onsets.items(), LOOKS, strict=True):
        axes.plot(FINE, threshold(FINE, xi), color=colour, linestyle=line)
        axes.plot(onset.omega, onset.up, linestyle="none", marker=mark, markersize=3.6,
                  markerfacecolor="white", markeredgecolor=colour, markeredgewidth=0.9, zorder=3)  # fmt: skip
        axes.plot([], [], color=colour, linestyle=line, marker=mark, markersize=3.6,
                  markerfacecolor="white", label=rf"$\xi = {xi:g}$")  # fmt: skip
    axes.legend(loc="upper left")
    _scales(axes)
    return drawing


@styled
def draw_sections(job: Job) -> Drawing:
    """Fig. 6: one curve, and the sections that Figs. 7 and 8 show."""
    onset = job.threshold(xi=XI)
    drawing, room = page(2.9, _sections_caption(onset))
    axes = room.subplots()
    axes.plot(FINE, threshold(FINE, XI), color="black")
    for omega in OMEGAS:
        axes.axvline(omega, color=RED, linestyle=(0, (5, 2)), linewidth=1)
    for gamma in GAMMAS:
        axes.axhline(gamma, color=GREEN, linestyle=(0, (1, 1.2)), linewidth=1.4)
    axes.plot([], [], color=RED, linestyle=(0, (5, 2)), label=r"$(\Gamma, \varphi)$, Fig. 7")
    axes.plot([], [], color=GREEN, linestyle=(0, (1, 1.2)), label=r"$(\Omega, \varphi)$, Fig. 8")
    axes.plot(onset.omega, onset.up, linestyle="none", marker="o", markersize=4, markerfacecolor="white",
              markeredgecolor="black", label="computed", zorder=4)  # fmt: skip
    axes.legend(loc="upper left", frameon=True, framealpha=1, edgecolor="none", borderpad=0.2)
    _scales(axes, top=3.4)
    return drawing


def apart(onset: xarray.Dataset) -> float:
    """The largest relative distance between an onset as computed and Eq. 25."""
    return float(np.nanmax(np.abs(onset.up / onset.analytic - 1.0)))


def _scales(axes: Axes, top: float = TOP) -> None:
    axes.set_xlim(0, LAST)
    axes.set_ylim(0, top)
    axes.set_xlabel(r"$\Omega$", labelpad=1)
    axes.set_ylabel(r"$\Gamma_{\mathrm{th}}$")
    minor_ticks(axes)


def _dampings_caption(onsets: dict[float, xarray.Dataset]) -> Caption:
    shows = (
        "Bouncing threshold Γ_th against Ω for four dampings ξ: Eq. 25 (lines), and the Γ at which a spring "
        "on an ideal plate began to bounce, ramped up from rest in steps of 0.5 % (marks)."
    )
    worst = max(apart(onset) for onset in onsets.values())
    lows = {xi: _lowest(xi) for xi in (0.2, 0.05, 0.01)}
    near = ", ".join(f"{gamma:.3f} at Ω = {omega:.3f} (ξ = {xi:g})" for xi, (omega, gamma) in lows.items())
    claims = (
        Claim(worst < 0.02, f"onsets and Eq. 25 are at most {100 * worst:.1f} % apart"),
        Claim(lows[0.01][0] > lows[0.2][0], f"the minimum moves to Ω = 1 as ξ decreases: {near}"),
        _not_constant(),
        Claim(
            False,
            "the text does not mention the maximum: Γ_th(√2) = √(1 + 1/8ξ²), "
            f"{threshold(np.sqrt(2), XI):.2f} at ξ = 0.05 and {threshold(np.sqrt(2), 0.01):.1f} at ξ = 0.01",
        ),
        Claim(
            False, "Eq. 22 as printed squares a bracket too many, Eq. 24 needs the two-argument arctangent"
        ),
    )
    return Caption(5, shows, claims)


def _not_constant() -> Claim:
    """The paper: "For ξ = 1, the threshold remains constant and equals to Γ_th = 1"."""
    omega, low = _lowest(1.0)
    return Claim(
        False,
        f"for ξ = 1, Γ_th is not constantly 1: {low:.3f} at Ω = {omega:.3f}, 1 at √(4/3) as for every ξ, "
        f"{threshold(LAST, 1.0):.3f} at Ω = {LAST:g}, {threshold(4.0, 1.0):.3f} at Ω = 4, 2 far beyond",
    )


def _lowest(xi: float) -> tuple[float, float]:
    """Ω and Γ at the minimum of Eq. 25, which is where 2(1 − 6ξ²)Ω² = 3 − √(1 + 48ξ²)."""
    omega = float(np.sqrt((3 - np.sqrt(1 + 48 * xi**2)) / (2 * (1 - 6 * xi**2))))
    return omega, float(threshold(omega, xi))


def _sections_caption(onset: xarray.Dataset) -> Caption:
    shows = (
        "Bouncing threshold at ξ = 0.05 (black), and the sections shown in Figs. 7 and 8: dashed, at "
        "constant Ω; dotted, at constant Γ. Circles: where the springs of Fig. 7 began to bounce, ramped up."
    )
    found = ", ".join(
        f"{float(up):.3f} at Ω = {float(omega):g}"
        for omega, up in zip(onset.omega.values, onset.up.values, strict=True)
    )
    (low, gamma), worst = _lowest(XI), apart(onset)
    claims = (
        Claim(worst < 0.02, f"bouncing begins at Γ = {found}, at most {100 * worst:.1f} % from Eq. 25"),
        Claim(True, f"a minimum due to resonance, Γ_th = {gamma:.4f} at Ω = {low:.4f}"),
        Claim(
            False,
            "with Ω along the bottom, as in Fig. 5, the (Γ, φ) sections are the upright lines; the paper's "
            "caption calls them horizontal",
        ),
    )
    return Caption(6, shows, claims)
