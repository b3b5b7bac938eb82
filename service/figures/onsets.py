"""Figs. 5, 6 and 9: the bouncing threshold by Eq. 25 and as computed, with Γ increased and decreased."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from numpy.typing import NDArray

from kernel.threshold import threshold
from service.client import Client, Job
from service.figures.drawing import Caption, Claim, Drawing, compared, left_open, percent
from service.pictures import ATTRACTORS, LINES, SYMBOLS
from service.presets import DAMPINGS, GAMMAS, OMEGAS, SOFT, XI

#: Line style and marker of each damping.
LINE_STYLES: Final[Any] = (("-", "o"), ((0, (5, 1.5)), "s"), ((0, (1, 1)), "^"), ("-.", "D"))
MAX_GAMMA: Final = 3.0
MAX_OMEGA: Final = 2.0
#: Effort of the searches where the closed form does not decide: some two seconds of a core each.
SEARCH_EFFORT: Final = 10
OMEGA_GRID: Final = np.linspace(0.005, MAX_OMEGA, 1500)


def figure_5(job: Job) -> Drawing:
    """The curves of four dampings, with the computed thresholds as markers."""
    onsets = {xi: job.threshold(xi=xi) for xi in DAMPINGS}

    def draw(area: SubFigure) -> None:
        axes = area.subplots()
        for (xi, onset), (line, mark), colour in zip(onsets.items(), LINE_STYLES, ATTRACTORS, strict=False):
            style: Any = {"color": colour, "markersize": 4, "markerfacecolor": "white"}
            axes.plot(OMEGA_GRID, threshold(OMEGA_GRID, xi), linestyle=line, **style)
            inside = onset.sel(omega=onset.up <= MAX_GAMMA)  # whole marks at the frame, none outside it
            axes.plot(
                inside.omega, inside.up, linestyle="none", marker=mark, clip_on=False, zorder=3, **style
            )
            axes.plot([], [], linestyle=line, marker=mark, label=rf"{SYMBOLS['xi']} = {xi:g}", **style)
        axes.legend(loc="upper left", frameon=False)
        _scales(axes, MAX_OMEGA, MAX_GAMMA)

    return Drawing(_dampings_caption(onsets), 3.9, draw)


def figure_6(job: Job) -> Drawing:
    """One curve, and the sections of Figs. 7 and 8; Ω is the vertical axis, as in the paper."""
    onset = job.threshold(xi=XI)

    def draw(area: SubFigure) -> None:
        axes = area.subplots()
        axes.plot(threshold(OMEGA_GRID, XI), OMEGA_GRID, color="black")
        red, blue = ATTRACTORS[5], ATTRACTORS[0]
        sections = ((7, OMEGAS, axes.axhline, "--", red), (8, GAMMAS, axes.axvline, ":", blue))
        for figure, values, line, style, colour in sections:
            for letter, value in zip("abc", values, strict=True):
                line(value, color=colour, linestyle=style, linewidth=1)
                corner = (0.05, value) if figure == 7 else (value, 0.05)
                axes.annotate(f"{figure}{letter}", corner, (3, 3), textcoords="offset points", color=colour)
        axes.plot([], [], color=red, linestyle="--", label=r"$(\Gamma, \varphi)$, Fig. 7")
        axes.plot([], [], color=blue, linestyle=":", label=r"$(\Omega, \varphi)$, Fig. 8")
        axes.plot(onset.up, onset.omega, "ko", markersize=4, markerfacecolor="white", label="computed")
        axes.legend(loc="upper left", framealpha=1, edgecolor="none")
        _scales(axes, 3.4, MAX_OMEGA)
        axes.set(xlabel=SYMBOLS["gamma"], ylabel=SYMBOLS["omega"])

    return Drawing(_sections_caption(onset), 3.9, draw)


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


def _scales(axes: Axes, right: float, top: float) -> None:
    axes.set(xlim=(0, right), ylim=(0, top), xlabel=SYMBOLS["omega"], ylabel=r"$\Gamma_{\mathrm{th}}$")
    axes.minorticks_on()


def _dampings_caption(onsets: dict[float, xarray.Dataset]) -> Caption:
    shows = (
        "Bouncing threshold Γ_th against Ω for four dampings ξ: Eq. 25 (lines), and the Γ at which a spring "
        "on an ideal plate began to bounce, ramped up from rest in steps of 0.5 % (marks)."
    )
    worst = max(max_relative_difference(onset) for onset in onsets.values())
    lows = {xi: extremum(xi) for xi in (0.2, 0.05, 0.01)}
    omegas = [omega for omega, _ in lows.values()]
    near = ", ".join(f"{gamma:.3f} at Ω = {omega:.3f} (ξ = {xi:g})" for xi, (omega, gamma) in lows.items())
    dip, low = extremum(1.0)
    tops = [(xi, digits, *extremum(xi, upper=True)) for xi, digits in ((0.05, 3), (0.2, 2))]
    where = " and ".join(
        f"{gamma:.{digits}f} at Ω = {omega:.4f} (ξ = {xi:g})" for xi, digits, omega, gamma in tops
    )
    claims = (
        compared(worst < 0.02, f"onsets and Eq. 25 are at most {percent(worst, 1)} apart"),
        compared(omegas == sorted(omegas), f"the minimum moves to Ω = 1 as ξ decreases: {near}"),
        # The paper: "For ξ = 1, the threshold remains constant and equals to Γ_th = 1".
        compared(
            np.all(np.abs(threshold(OMEGA_GRID, 1.0) - 1) < 0.01),
            f"for ξ = 1, Γ_th is not constantly 1: {low:.3f} at Ω = {dip:.3f}, 1 at √(4/3) as for every ξ, "
            f"{threshold(MAX_OMEGA, 1.0):.3f} at Ω = {MAX_OMEGA:g}, {threshold(4.0, 1.0):.3f} at Ω = 4, "
            f"{threshold(1e3, 1.0):.3f} far beyond",
        ),
        # For ξ < 1/√6, near √2 and above Γ_th(√2) = √(1 + 1/(8ξ²)).
        left_open(f"beyond the minimum the threshold has a maximum, {where}, and falls to 2 from there on"),
        *_as_printed(),
    )
    return Caption(5, shows, claims)


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
    pairs = zip(onset.omega.values, onset.up.values, strict=True)
    computed = ", ".join(f"{up:.3f} at Ω = {omega:g}" for omega, up in pairs)
    (low, gamma), worst = extremum(XI), max_relative_difference(onset)
    lowest = OMEGA_GRID[np.argmin(threshold(OMEGA_GRID, XI))]
    maximum, _ = extremum(XI, upper=True)
    again = OMEGA_GRID[(maximum < OMEGA_GRID) & (threshold(OMEGA_GRID, XI) < GAMMAS[-1])]
    claims = (
        compared(worst < 0.02, f"bouncing begins at Γ = {computed}, at most {percent(worst, 1)} from Eq. 25"),
        compared(abs(lowest - 1) < 0.05, f"a minimum due to resonance, Γ_th = {gamma:.4f} at Ω = {low:.4f}"),
        left_open(
            f"the threshold falls again beyond Ω = {maximum:.2f}: at Γ = {GAMMAS[-1]:g} springs bounce from "
            f"Ω = {again.min():.2f} on once more"
        ),
    )
    return Caption(6, shows, claims)


#: The top of the frame of Fig. 9, above the Γ where the curves differ.
HYSTERESIS_TOP: Final = 1.6
#: Least depth of a minimum, in Γ: shallower ones come from the steps of the grid.
MIN_DEPTH: Final = 0.02
#: Thresholds count as different if they are more steps of Γ apart than this.
STEPS_APART: Final = 3
#: Below this Ω the threshold depends on where the ramp down begins.
SLOW: Final = 0.5


#: Where folds of the paper's own contact are drawn, in pieces that are followed apart, and up to which Γ.
FOLDS_OVER: Final = (0.25, 0.35, 0.45, 0.6, 0.8)
FOLDS_TOP: Final = 1.0


def figure_9(client: Client, job: Job, lower: Job) -> Drawing:
    """Up and down, with Eq. 25, the folds of the contact that the paper computed with, and searched ends."""
    loop, from_lower = job.threshold(xi=XI), lower.threshold(xi=XI)
    undecided = loop.omega.values[np.isin(loop.cause.values, ("unresolved", "not searched"))]
    searched = [
        client.threshold(omega=omega, xi=XI, search=True, effort=SEARCH_EFFORT, progress=False)
        for omega in undecided.tolist()
    ]
    contact = {name: value for name, value in SOFT.items() if name != "kind"}
    folds = [
        client.curves(
            xi=XI, omega_start=low, omega_stop=high, modes="1-1", kinds="fold", gamma_max=FOLDS_TOP,
            model=SOFT["kind"], **contact,
        )
        for low, high in pairwise(FOLDS_OVER)
    ]  # fmt: skip

    def draw(area: SubFigure) -> None:
        axes = area.subplots()
        axes.plot(loop.omega, loop.up, color=LINES["up"], linewidth=3, label=r"$\Gamma$ increased")
        down: Any = {"markersize": 2, "linewidth": 0.8, "label": r"$\Gamma$ decreased"}
        axes.plot(loop.omega, loop.down, "s-", color=LINES["down"], **down)
        for fold in folds:
            axes.plot(fold.omega.values.T, fold.gamma.values.T, color=LINES["branch"], linewidth=0.7)
        axes.plot([], [], color=LINES["branch"], linewidth=0.7, label="folds, soft contact")
        mark: Any = {"fillstyle": "none", "markersize": 5, "label": "searched"}
        ends = [[float(end[name]) for end in searched] for name in ("omega", "down")]
        axes.plot(*ends, "D", color=LINES["threshold"], **mark)
        onset: Any = {"linewidth": 0.9, "label": "Eq. 25"}
        axes.plot(OMEGA_GRID, threshold(OMEGA_GRID, XI), "--", color=LINES["threshold"], **onset)
        axes.legend(loc="upper left", frameon=False)
        _scales(axes, float(loop.omega[-1]), HYSTERESIS_TOP)
        axes.set_ylabel(SYMBOLS["gamma"])

    return Drawing(_hysteresis_caption(loop, from_lower, job.spec), 3.9, draw)


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
    """How far the values rise above the first one before they fall below it; NaN is left out."""
    below = np.flatnonzero(values < values[0])
    return float(np.nanmax(values[: below[0]] if len(below) else values) - values[0])


def _hysteresis_caption(loop: xarray.Dataset, lower: xarray.Dataset, spec: Mapping[str, Any]) -> Caption:
    gamma, (peak, highest) = spec["gamma"], extremum(XI, upper=True)
    step = (gamma["stop"] - gamma["start"]) / (gamma["num"] - 1)
    shows = (
        "Threshold at ξ = 0.05 with Γ increased (blue: lowest Γ that bounces) and decreased (orange: last Γ "
        f"that bounces) in steps of {step:.2g}, each until its cycle is certified, on an ideal plate; thin, "
        "folds of its cycles (1,1) on the paper's soft contact; diamonds, where a search found that bouncing "
        "ends, as no cycle in closed form decides it; dashed, Eq. 25. Its maximum, "
        f"{highest:.1f} at Ω = {peak:.3f}, lies outside the frame."
    )
    worst, gain = max_relative_difference(loop), 1.0 - (loop.down / loop.up).values
    most, lows = int(np.nanargmax(gain)), minima(loop.down.values, MIN_DEPTH)
    claims = (
        compared(worst < 0.03, f"the curve with Γ increased is Eq. 25 (at most {percent(worst, 1)} apart)"),
        compared(
            gain[most] > 0.1,
            f"bouncing goes on below it, most at Ω = {float(loop.omega[most]):.2f}: down to "
            f"Γ = {float(loop.down[most]):.3f} instead of {float(loop.up[most]):.3f}",
        ),
        compared(
            len(lows) > 1,
            f"decreased, it has {len(lows)} minima: "
            f"Ω = {', '.join(f'{omega:.2f}' for omega in loop.omega.values[lows])}",
        ),
        _coexist(loop, lower, step),
    )
    return Caption(9, shows, claims)


def _coexist(loop: xarray.Dataset, lower: xarray.Dataset, step: float) -> Claim:
    """Not in the paper: whether the threshold depends on the "large amplitude" at the start."""
    same = loop.down.sel(omega=lower.omega, method="nearest").values
    moved = np.abs(lower.down.values - same) > STEPS_APART * step
    both = np.isfinite(lower.down.values) & np.isfinite(same)
    slow, fast = both & (lower.omega.values < SLOW), both & (lower.omega.values >= SLOW)
    return left_open(
        "the amplitude that the ramp down begins with, which may matter where modes coexist: from "
        f"Γ = 1.2 instead of 3, {moved[slow].sum()} of {slow.sum()} thresholds below Ω = 0.5 and "
        f"{moved[fast].sum()} of {fast.sum()} from 0.5 to 0.8 are others"
    )
