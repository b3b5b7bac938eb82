"""Fig. 2: a bifurcation diagram, and the motion at four of its Γ."""

from collections.abc import Mapping
from typing import Final

import numpy as np
import xarray
from matplotlib.axes import Axes

from kernel.params import Outcome
from service.client import Client, Job
from service.figures.canvas import GREY, RED, TURN, Drawing, dots, flights_over, label, page, split, styled
from service.figures.caption import Caption, Claim, mode
from service.presets import INSETS, SOFT

OMEGA: Final = 0.5
XI: Final = 0.26
PERIODS: Final = 6

#: Length at rest of the drawn spring, plate amplitudes: it plays no part in the motion.
LENGTH: Final = 1.6


@styled
def draw(client: Client, job: Job, ramped: Job) -> Drawing:
    """The diagram from rest above the four insets; the ramp is only spoken of."""
    diagram, up = job.diagram(), ramped.diagram()
    motions = {gamma: _motion(client, gamma) for gamma in INSETS}
    drawing, room = page(5.0, _caption(diagram, up))
    above, below = split(room, 2.7, 2.3)
    axes = above.subplots()
    dots(axes, diagram, size=0.7)
    values = diagram.gamma.values
    flights_over(axes, float(values[0]), float(values[-1]), 1.06 * float(diagram.flight_time.max()))
    axes.set_xlabel(r"$\Gamma$", labelpad=1)
    panels = below.subplots(2, 2, sharex=True, sharey=True)
    for letter, gamma, panel in zip("abcd", INSETS, panels.flat, strict=True):
        _draw_motion(panel, motions[gamma])
        label(panel, rf"({letter})  $\Gamma = {gamma}$")
        axes.axvline(gamma, color=RED, linewidth=0.6, linestyle=(0, (3, 3)), zorder=2)
        axes.annotate(letter, (gamma, 1), (3, -3), xycoords=("data", "axes fraction"),
                      textcoords="offset points", va="top", color=RED)  # fmt: skip
    below.supylabel(r"$z\omega^2\!/g\Gamma$", fontsize=10)
    below.supxlabel("plate periods", fontsize=9)
    return drawing


def _motion(client: Client, gamma: float) -> xarray.Dataset:
    cell = {"gamma": gamma, "omega": OMEGA, "xi": XI, "model": SOFT}
    return client.trajectory({**cell, "settle": 200, "periods": PERIODS, "samples": 100})


def _draw_motion(axes: Axes, motion: xarray.Dataset) -> None:
    """The spring as a gray band from mass to mass, the plate in black."""
    turns = motion.phase.values / TURN
    lower, upper = motion.z2.values, motion.z1.values - motion.attrs["rest_length"] + LENGTH
    axes.fill_between(turns, lower, upper, color="0.78", linewidth=0)
    axes.plot(turns, lower, color=GREY, linewidth=0.7)
    axes.plot(turns, upper, color=GREY, linewidth=0.7)
    axes.plot(turns, motion.plate.values, color="black", linewidth=1.2)
    axes.set_xlim(0, PERIODS)


def _caption(diagram: xarray.Dataset, up: xarray.Dataset) -> Caption:
    shows = (
        "Flight times φ of the bouncing spring at Ω = 0.5, ξ = 0.26, from rest; below, its motion (gray) "
        "above the plate (black) once settled, drawn with a rest length of 1.6 A. Contact: adhesive, e = 0, "
        "10⁻³ A deep; faint lines: whole plate periods."
    )
    rest, ramp = _modes(diagram), _modes(up)
    claims = [_claim(gamma, rest[gamma], INSETS[gamma], "") for gamma in INSETS]
    claims += [
        _claim(gamma, ramp[gamma], INSETS[gamma], ", when Γ is ramped up as the paper says it was")
        for gamma in INSETS
        if ramp[gamma] != rest[gamma]
    ]
    return Caption(2, shows, tuple(claims))


def _claim(gamma: float, found: str, printed: tuple[int, int] | None, how: str) -> Claim:
    expected = mode(*printed) if printed else "aperiodic"
    holds = found == expected
    return Claim(holds, f"{found} at Γ = {gamma}{how}" + ("" if holds else f", not {expected}"))


def _modes(diagram: xarray.Dataset) -> Mapping[float, str]:
    """The mode at each inset's Γ, in words."""
    cells = {gamma: diagram.sel(gamma=gamma, method="nearest") for gamma in INSETS}
    return {gamma: _mode(cell) for gamma, cell in cells.items()}


def _mode(cell: xarray.Dataset) -> str:
    if int(cell.outcome) == Outcome.PERIODIC:
        return mode(int(cell.bounces), int(cell.periods))
    return str(Outcome(int(np.asarray(cell.outcome))).name.lower().replace("_", " "))
