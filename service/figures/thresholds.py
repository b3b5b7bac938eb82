"""Figs. 5 and 6: the bouncing threshold by Eq. 25 and as computed, and the sections of Figs. 7 and 8."""

from typing import Any, Final

import numpy as np
import xarray
from matplotlib.axes import Axes

from kernel.threshold import threshold
from service.client import Job
from service.figures.canvas import BLUE, GREEN, ORANGE, RED, Drawing, minor_ticks, new_drawing
from service.figures.caption import Caption, Claim, compared, left_open, percent
from service.presets import DAMPINGS, GAMMAS, OMEGAS, XI

#: Colour, line style and marker of each damping.
LINE_STYLES: Final = (
    (BLUE, "-", "o"),
    (RED, (0, (5, 1.5)), "s"),
    (GREEN, (0, (1, 1)), "^"),
    (ORANGE, "-.", "D"),
)
MAX_GAMMA: Final = 3.0
MAX_OMEGA: Final = 2.0
OMEGA_GRID: Final = np.linspace(0.005, MAX_OMEGA, 1500)


def draw_dampings(job: Job) -> Drawing:
    """Fig. 5: the curves of four dampings, with the computed thresholds as markers."""
    onsets = {xi: job.threshold(xi=xi) for xi in DAMPINGS}
    drawing, area = new_drawing(2.9, _dampings_caption(onsets))
    axes = area.subplots()
    for (xi, onset), (colour, line, mark) in zip(onsets.items(), LINE_STYLES, strict=True):
        axes.plot(OMEGA_GRID, threshold(OMEGA_GRID, xi), color=colour, linestyle=line)
        inside = onset.sel(omega=onset.up <= MAX_GAMMA)  # whole marks at the frame, none outside it
        axes.plot(inside.omega, inside.up, linestyle="none", marker=mark, markersize=3.6, clip_on=False,
                  markerfacecolor="white", markeredgecolor=colour, markeredgewidth=0.9, zorder=3)  # fmt: skip
        axes.plot([], [], color=colour, linestyle=line, marker=mark, markersize=3.6,
                  markerfacecolor="white", label=rf"$\xi = {xi:g}$")  # fmt: skip
    axes.legend(loc="upper left")
    _scales(axes)
    return drawing


def draw_sections(job: Job) -> Drawing:
    """Fig. 6: one curve, and the sections of Figs. 7 and 8; Ω is the vertical axis, as in the paper."""
    onset = job.threshold(xi=XI)
    drawing, area = new_drawing(3.1, _sections_caption(onset))
    axes = area.subplots()
    axes.plot(threshold(OMEGA_GRID, XI), OMEGA_GRID, color="black")
    for letter, omega in zip("abc", OMEGAS, strict=True):
        axes.axhline(omega, color=RED, linestyle=(0, (5, 2)), linewidth=1)
        _annotate(axes, f"7{letter}", (0, omega), (9, 2), RED, xycoords=("axes fraction", "data"))
    for letter, gamma in zip("abc", GAMMAS, strict=True):
        axes.axvline(gamma, color=GREEN, linestyle=(0, (1, 1.2)), linewidth=1.4)
        _annotate(axes, f"8{letter}", (gamma, 0), (3, 3), GREEN, xycoords=("data", "axes fraction"))
    axes.plot([], [], color=RED, linestyle=(0, (5, 2)), label=r"$(\Gamma, \varphi)$, Fig. 7")
    axes.plot([], [], color=GREEN, linestyle=(0, (1, 1.2)), label=r"$(\Omega, \varphi)$, Fig. 8")
    axes.plot(onset.up, onset.omega, linestyle="none", marker="o", markersize=4, markerfacecolor="white",
              markeredgecolor="black", label="computed", zorder=4)  # fmt: skip
    axes.legend(loc="upper left", frameon=True, framealpha=1, edgecolor="none", borderpad=0.2)
    axes.set_xlim(0, 3.4)
    axes.set_ylim(0, MAX_OMEGA)
    axes.set_xlabel(r"$\Gamma$", labelpad=1)
    axes.set_ylabel(r"$\Omega$")
    minor_ticks(axes)
    return drawing


def _annotate(
    axes: Axes, text: str, at: tuple[float, float], offset: tuple[int, int], colour: str, **options: Any
) -> None:
    axes.annotate(text, at, offset, textcoords="offset points", color=colour, fontsize=8, **options)


def max_relative_difference(onset: xarray.Dataset) -> float:
    """The largest relative difference between a computed threshold and Eq. 25."""
    return float(np.nanmax(np.abs(onset.up / onset.analytic - 1.0)))


def extremum(xi: float, *, upper: bool = False) -> tuple[float, float]:
    """Ω and Γ_th at the minimum of Eq. 25, or at its maximum, which exists for ξ < 1/√6 only.

    2(1 − 6ξ²)Ω² = 3 ∓ √(1 + 48ξ²).
    """
    root = np.sqrt(1 + 48 * xi**2)
    omega = float(np.sqrt((3 + (root if upper else -root)) / (2 * (1 - 6 * xi**2))))
    return omega, float(threshold(omega, xi))


def _scales(axes: Axes) -> None:
    axes.set_xlim(0, MAX_OMEGA)
    axes.set_ylim(0, MAX_GAMMA)
    axes.set_xlabel(r"$\Omega$", labelpad=1)
    axes.set_ylabel(r"$\Gamma_{\mathrm{th}}$")
    minor_ticks(axes)


def _dampings_caption(onsets: dict[float, xarray.Dataset]) -> Caption:
    shows = (
        "Bouncing threshold Γ_th against Ω for four dampings ξ: Eq. 25 (lines), and the Γ at which a spring "
        "on an ideal plate began to bounce, ramped up from rest in steps of 0.5 % (marks)."
    )
    worst = max(max_relative_difference(onset) for onset in onsets.values())
    lows = {xi: extremum(xi) for xi in (0.2, 0.05, 0.01)}
    omegas = [omega for omega, _ in lows.values()]
    near = ", ".join(f"{gamma:.3f} at Ω = {omega:.3f} (ξ = {xi:g})" for xi, (omega, gamma) in lows.items())
    claims = (
        compared(worst < 0.02, f"onsets and Eq. 25 are at most {percent(worst, 1)} apart"),
        compared(omegas == sorted(omegas), f"the minimum moves to Ω = 1 as ξ decreases: {near}"),
        _not_constant(),
        _unmentioned_maximum(),
        *_as_printed(),
    )
    return Caption(5, shows, claims)


def _not_constant() -> Claim:
    """The paper: "For ξ = 1, the threshold remains constant and equals to Γ_th = 1"."""
    omega, low = extremum(1.0)
    return compared(
        bool(np.all(np.abs(threshold(OMEGA_GRID, 1.0) - 1) < 0.01)),
        f"for ξ = 1, Γ_th is not constantly 1: {low:.3f} at Ω = {omega:.3f}, 1 at √(4/3) as for every ξ, "
        f"{threshold(MAX_OMEGA, 1.0):.3f} at Ω = {MAX_OMEGA:g}, {threshold(4.0, 1.0):.3f} at Ω = 4, "
        f"{threshold(1e3, 1.0):.3f} far beyond",
    )


def _unmentioned_maximum() -> Claim:
    """Eq. 25 has a maximum for ξ < 1/√6, near √2 and above Γ_th(√2) = √(1 + 1/(8ξ²))."""
    tops = [(xi, digits, *extremum(xi, upper=True)) for xi, digits in ((0.05, 3), (0.2, 2))]
    where = " and ".join(
        f"{gamma:.{digits}f} at Ω = {omega:.4f} (ξ = {xi:g})" for xi, digits, omega, gamma in tops
    )
    return left_open(f"beyond the minimum the threshold has a maximum, {where}, and falls to 2 from there on")


def _as_printed() -> list[Claim]:
    """Eqs. 22 and 24 exactly as printed, compared with the phases by Eqs. 20 and 23 at ξ = 0.05."""
    w, x = OMEGA_GRID**2, (2 * XI * OMEGA_GRID) ** 2
    phase = np.angle((1 + 2j * XI * OMEGA_GRID) / (1 - w + 2j * XI * OMEGA_GRID))
    eq_22 = -np.arccos(np.sqrt((1 - w + x) ** 2) / np.sqrt((1 + x) * ((1 - w) ** 2 + x)))
    error_22 = np.abs(eq_22 - phase)
    wrong = OMEGA_GRID[error_22 > 1e-6]
    takeoff = np.arctan2(2 * XI * OMEGA_GRID**3, 2 + (8 * XI**2 - 3) * w + w**2)
    eq_24 = np.arctan(np.tan(takeoff))
    shifted = OMEGA_GRID[np.abs(eq_24 - takeoff) > 1]
    return [
        compared(
            not len(wrong),
            f"Eq. 22 as printed squares a bracket and takes its root: at ξ = {XI:g} it is up to "
            f"{error_22.max():.2f} rad off above Ω = {wrong.min(initial=MAX_OMEGA):.2f}",
        ),
        compared(
            not len(shifted),
            "Eq. 24 needs the two-argument arctangent: else it is off by π from "
            f"Ω = {shifted.min(initial=MAX_OMEGA):.2f} to {shifted.max(initial=0.0):.2f}",
        ),
    ]


def _sections_caption(onset: xarray.Dataset) -> Caption:
    shows = (
        "Bouncing threshold at ξ = 0.05 (black), and the sections shown in Figs. 7 and 8: dashed, at "
        "constant Ω; dotted, at constant Γ. Circles: where the springs of Fig. 7 began to bounce, ramped up."
    )
    computed = ", ".join(
        f"{float(up):.3f} at Ω = {float(omega):g}"
        for omega, up in zip(onset.omega.values, onset.up.values, strict=True)
    )
    (low, gamma), worst = extremum(XI), max_relative_difference(onset)
    lowest = OMEGA_GRID[np.argmin(threshold(OMEGA_GRID, XI))]
    claims = (
        compared(worst < 0.02, f"bouncing begins at Γ = {computed}, at most {percent(worst, 1)} from Eq. 25"),
        compared(
            bool(abs(lowest - 1) < 0.05),
            f"a minimum due to resonance, Γ_th = {gamma:.4f} at Ω = {low:.4f}",
        ),
        _second_onset(),
    )
    return Caption(6, shows, claims)


def _second_onset() -> Claim:
    """Not in the paper: the threshold decreases again beyond its maximum."""
    maximum, _ = extremum(XI, upper=True)
    again = OMEGA_GRID[(maximum < OMEGA_GRID) & (threshold(OMEGA_GRID, XI) < GAMMAS[-1])]
    where = f"from Ω = {again.min():.2f} on" if len(again) else f"beyond Ω = {MAX_OMEGA:g}"
    return left_open(
        f"the threshold falls again beyond Ω = {maximum:.2f}: at Γ = {GAMMAS[-1]:g} springs bounce {where} "
        "once more"
    )
