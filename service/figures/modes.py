"""Fig. 2: a bifurcation diagram, and the motion at four values of Γ."""

from collections.abc import Mapping
from typing import Final

import xarray
from matplotlib.axes import Axes

from kernel.params import Outcome
from service.client import Client, Job
from service.figures.canvas import (
    GREY,
    PERIOD,
    RED,
    Drawing,
    flight_scales,
    new_drawing,
    panel_title,
    plot_flights,
    split,
)
from service.figures.caption import Caption, Claim, compared, mode
from service.presets import INSETS, SOFT

OMEGA: Final = 0.5
XI: Final = 0.26
PERIODS: Final = 6

#: Of the flights on the ramp, behind those from rest.
RAMPED: Final = "0.66"

#: Rest length of the drawn spring, in plate amplitudes; the motion does not depend on it.
LENGTH: Final = 1.6


def draw(client: Client, job: Job, ramped: Job) -> Drawing:
    """The diagram above the four insets: from rest in black, and ramped up in grey behind it."""
    diagram, up = job.diagram(), ramped.diagram()
    motions = {gamma: _motion(client, gamma) for gamma in INSETS}
    drawing, area = new_drawing(5.0, _caption(diagram, up))
    above, below = split(area, 2.7, 2.3)
    axes = above.subplots()
    plot_flights(axes, up, colour=RAMPED, markersize=1.8)
    plot_flights(axes, diagram, markersize=1.4)
    values, longest = diagram.gamma.values, max(float(each.flight_time.max()) for each in (diagram, up))
    flight_scales(axes, float(values[0]), float(values[-1]), 1.06 * longest)
    for colour, label in (("black", "from rest"), (RAMPED, r"$\Gamma$ ramped up")):
        axes.plot(
            [], [], linestyle="none", marker=".", color=colour, markersize=5, markeredgewidth=0, label=label
        )
    # Between the marks of (b) and (c), above all flights.
    axes.legend(loc="upper left", bbox_to_anchor=(2.32, 1.0), handletextpad=0.1,
                bbox_transform=axes.get_xaxis_transform())  # fmt: skip
    axes.set_xlabel(r"$\Gamma$", labelpad=1)
    panels = below.subplots(2, 2, sharex=True, sharey=True)
    for letter, gamma, panel in zip("abcd", INSETS, panels.flat, strict=True):
        _draw_motion(panel, motions[gamma])
        panel_title(panel, rf"({letter})  $\Gamma = {gamma}$")
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
    """Draw the spring as a gray band between its masses, and the plate in black."""
    periods = motion.phase.values / PERIOD
    lower, upper = motion.z2.values, motion.z1.values - motion.attrs["rest_length"] + LENGTH
    axes.fill_between(periods, lower, upper, color="0.78", linewidth=0)
    axes.plot(periods, lower, color=GREY, linewidth=0.7)
    axes.plot(periods, upper, color=GREY, linewidth=0.7)
    axes.plot(periods, motion.plate.values, color="black", linewidth=1.2)
    axes.set_xlim(0, PERIODS)


def _caption(diagram: xarray.Dataset, up: xarray.Dataset) -> Caption:
    shows = (
        "Flight times φ of the bouncing spring at Ω = 0.5, ξ = 0.26, from rest (black) and with Γ ramped up "
        "(gray); below, its motion from rest (gray) above the plate (black) once settled, drawn with a rest "
        "length of 1.6 A. Contact: adhesive, e = 0, 10⁻³ A deep; faint lines: whole plate periods."
    )
    rest, ramp = _modes(diagram), _modes(up)
    claims = [_claim(gamma, rest[gamma], INSETS[gamma], "") for gamma in INSETS]
    claims += [
        _claim(gamma, ramp[gamma], INSETS[gamma], ", when Γ is ramped up as the paper says it was")
        for gamma in INSETS
        if ramp[gamma] != rest[gamma]
    ]
    return Caption(2, shows, tuple(claims))


def _claim(gamma: float, computed: str, printed: tuple[int, int] | None, condition: str) -> Claim:
    expected = mode(*printed) if printed else "aperiodic"
    holds = computed == expected
    return compared(holds, f"{computed} at Γ = {gamma}{condition}" + ("" if holds else f", not {expected}"))


def _modes(diagram: xarray.Dataset) -> Mapping[float, str]:
    """The mode, or the outcome, at the Γ of each inset."""
    cells = {gamma: diagram.sel(gamma=gamma, method="nearest") for gamma in INSETS}
    return {gamma: _mode(cell) for gamma, cell in cells.items()}


def _mode(cell: xarray.Dataset) -> str:
    if int(cell.outcome) == Outcome.PERIODIC:
        return mode(int(cell.bounces), int(cell.periods))
    return Outcome(int(cell.outcome)).name.lower().replace("_", " ")
