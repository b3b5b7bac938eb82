"""Branches of (1, 1) over Γ: stable and unstable cycles, their events, and what ramps find."""

from typing import Any, Final

import numpy as np
import xarray
from matplotlib.axes import Axes
from numpy.typing import NDArray

from kernel.branches.events import Branch, Events, Kind, branch_and_events
from kernel.branches.starts import cycles_at
from kernel.params import Cell
from kernel.threshold import threshold
from service.client import Job
from service.figures.canvas import (
    BLUE,
    GREEN,
    ORANGE,
    RED,
    Drawing,
    flight_scales,
    new_drawing,
    panel_title,
    plot_flights,
    styled,
)
from service.figures.caption import Caption, Claim, computed
from service.presets import BRANCH_OMEGAS, XI

#: Γ and flight times in the frame of each panel.
FRAMES: Final = ((0.45, 1.1, 6.6), (0.7, 1.5, 6.6), (0.45, 1.1, 6.6))

#: How cycles are drawn: those of the spring, stable and unstable, and those that it does not have.
CYCLES: Final[dict[str, dict[str, Any]]] = {
    "stable": {"linestyle": "-", "linewidth": 2.6, "alpha": 0.5},
    "unstable": {"linestyle": (0, (4, 2)), "linewidth": 1.1},
    "not admissible": {"linestyle": (0, (1, 2)), "linewidth": 0.8},
}

#: Colour, marker and name of the events that are marked.
MARKS: Final = {
    Kind.FOLD: (BLUE, "o", "fold"),
    Kind.FLIP: (ORANGE, "s", "flip"),
    Kind.NEIMARK_SACKER: (GREEN, "D", "Neimark–Sacker"),
    Kind.IMMEDIATE_TAKEOFF: (RED, "^", "take-off at once"),
    Kind.GRAZE_FLIGHT: (RED, "v", "graze in flight"),
    Kind.GRAZE_CONTACT: (RED, ">", "graze in contact"),
}


@styled
def draw(job: Job) -> Drawing:
    """A panel for each frequency."""
    drawn = [branch_and_events(omega, XI, 1, 1200) for omega in BRANCH_OMEGAS]
    drawing, area = new_drawing(5.6, _caption(drawn, job))
    panels = area.subplots(3, 1)
    for axes, letter, frame, (line, events) in zip(panels, "abc", FRAMES, drawn, strict=True):
        plot_branch(axes, line)
        for direction in ("up", "down"):
            plot_flights(axes, _along(job, line.omega, direction), markersize=1.2)
        _mark(axes, events)
        start = float(threshold(line.omega, XI))
        axes.plot([start], [0], marker="^", markersize=5, color="black", clip_on=False, zorder=6)
        axes.annotate(
            r"$\Gamma_{\mathrm{th}}$", (start, 0), (-21, 4), textcoords="offset points", fontsize=8.5
        )
        flight_scales(axes, *frame)
        panel_title(axes, rf"({letter})  $\Omega = {line.omega:g}$")
    _label_thresholds(panels[0], drawn[0][1])
    panels[-1].set_xlabel(r"$\Gamma$", labelpad=1)
    _legend(panels[-1])
    return drawing


def _along(job: Job, omega: float, direction: str) -> xarray.Dataset:
    return job.diagram(omega=omega, direction=direction)


def plot_branch(axes: Axes, line: Branch) -> None:
    """Stable cycles solid, unstable ones dashed, those that the spring does not have dotted."""
    admissible = line.admissible == 0
    kinds = {
        "not admissible": ~admissible,
        "unstable": admissible & ~line.stable,
        "stable": admissible & line.stable,
    }
    for name, keep in kinds.items():
        # a part of the branch reaches to its neighbours' first points, so that no gap is between them
        wide = keep | np.roll(keep, 1)
        wide[0] = keep[0]
        gamma = np.where(wide, line.gamma, np.nan)
        axes.plot(gamma, line.flight_time, color=BLUE, zorder=2, **CYCLES[name])


def _mark(axes: Axes, events: Events) -> None:
    """The events of admissible cycles."""
    for kind, (colour, marker, _) in MARKS.items():
        keep = (events.kind == kind) & (events.admissible == 0)
        axes.plot(events.gamma[keep], events.flight_time[keep], linestyle="none", marker=marker, markersize=4,
                  markerfacecolor="white", markeredgecolor=colour, markeredgewidth=1, zorder=6)  # fmt: skip


def _label_thresholds(axes: Axes, events: Events) -> None:
    """The names of the two folds of the S."""
    folds = np.flatnonzero((events.kind == Kind.FOLD) & (events.admissible == 0))
    for i, name, offset in zip(folds, ("jump", "down"), ((6, -3), (-30, -4)), strict=True):
        text = rf"$\Gamma_{{\mathrm{{{name}}}}}$"
        axes.annotate(
            text, (events.gamma[i], events.flight_time[i]), offset, textcoords="offset points", fontsize=8.5
        )


def _legend(axes: Axes) -> None:
    for name, style in CYCLES.items():
        axes.plot([], [], color=BLUE, label=name, **style)
    for colour, marker, name in MARKS.values():
        axes.plot([], [], linestyle="none", marker=marker, markersize=4, markerfacecolor="white",
                  markeredgecolor=colour, label=name)  # fmt: skip
    axes.legend(loc="upper left", ncols=3, fontsize=6.6, columnspacing=1.0, handlelength=1.8)


def _caption(drawn: list[tuple[Branch, Events]], job: Job) -> Caption:
    shows = (
        f"The branch (1, 1) in closed form at ξ = {XI:g}, and the flights that a ramp up and down finds "
        "(dots). (a) Below the cusp the branch is S-shaped; (b) between two Bogdanov–Takens points its "
        "lower fold is unstable on both sides, and a torus bounces; (c) beyond the cusp the branch rises "
        "monotonically."
    )
    return Caption("branches", shows, (_on_folds(drawn[0][1]), _on_branch(drawn, job)))


def _on_folds(events: Events) -> Claim:
    folds = events.gamma[(events.kind == Kind.FOLD) & (events.admissible == 0)]
    return computed(
        f"at Ω = {events.omega[0]:g} bouncing begins at Γ_th = {float(threshold(events.omega[0], XI)):.6f}, "
        f"leaps at {folds.max():.6f} and ends at {folds.min():.6f}"
    )


def _on_branch(drawn: list[tuple[Branch, Events]], job: Job) -> Claim:
    """How far the simulated (1, 1) cells lie from the branch."""
    gaps = {
        line.omega: np.concatenate([distances(line, _along(job, line.omega, way)) for way in ("up", "down")])
        for line, _ in drawn
    }
    counts = ", ".join(f"{len(each)} at Ω = {omega:g}" for omega, each in gaps.items())
    worst = max(float(each.max(initial=0.0)) for each in gaps.values())
    return computed(
        f"the ramps find the mode (1, 1) in cells, {counts}: all within {_power(worst)} rad of the branch"
    )


def _power(value: float) -> str:
    """The next power of ten, at least 10⁻⁶: a mode is found within that."""
    exponent = max(int(np.ceil(np.log10(max(value, 1e-12)))), -6)
    return f"10{'⁻' if exponent < 0 else ''}{'⁰¹²³⁴⁵⁶'[abs(exponent)]}"


def distances(line: Branch, diagram: xarray.Dataset) -> NDArray[np.float64]:
    """|flight time − that of the nearest cycle| of every simulated cell in the mode (1, 1)."""
    cells = np.flatnonzero((diagram.bounces.values == 1) & (diagram.periods.values == 1))
    found = []
    for i in cells:
        times = diagram.flight_time.values[i]
        last = times[np.isfinite(times)][-1]
        known = cycles_at(Cell(float(diagram.gamma[i]), line.omega, line.xi), 1).flight_time
        found.append(np.abs(known - last).min(initial=np.inf))
    return np.array(found)
