"""Figs. 3 and 4: springs so rigid that they bounce like a ball."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import xarray
from numpy.typing import NDArray

from kernel.params import Outcome
from kernel.restitution import restitution_of
from service.client import Job
from service.figures.canvas import Drawing, dots, flights_over, label, page, styled
from service.figures.caption import Caption, Claim, mode
from service.presets import MICRO_FLIGHT

#: Flight times closer than this are one in a picture, rad.
ALIKE: Final = 0.05

#: Modes of the inelastic ball and the Γ at which they end (MODEL section 5, after the paper's reference 4).
INELASTIC: Final = {(1, 1): 3.72419, (2, 2): 4.60334, (1, 2): 6.59382}

#: Γ between which both diagrams of Fig. 4 are looked through for flights that do not occur.
THROUGH: Final = (4.7, 5.3)


class Comparison(NamedTuple):
    """Cell by cell, of those periodic in both diagrams."""

    periodic: int  # in both
    same: int  # of these, in the same mode
    deviations: NDArray[np.float64]  # (same,) rad, the largest between the sorted flights of a cycle

    def __str__(self) -> str:
        return f"{self.same} of {self.periodic} periodic cells are in the same mode"


@styled
def draw_inelastic(spring: Job, ball: Job, deep: Job) -> Drawing:
    """Fig. 3: against the completely inelastic ball."""
    one, two, three = (_seen(job) for job in (spring, ball, deep))
    shows = (
        "A rigid spring (ℰ = ξ/Ω = 650, ξ = 10) and the completely inelastic ball (ε = 0), Γ ramped up. "
        "Contact of the spring: adhesive, e = 0, 10⁻⁶ A deep."
    )
    claims = (
        _indistinguishable(compare(one, two)),
        *(_ends(one, *end) for end in INELASTIC.items()),
        _only_when_shallow(compare(three, two.sel(gamma=three.gamma, method="nearest"))),
    )
    titles = (r"spring, $\mathcal{E} = 650$, $\xi = 10$", r"ball, $\epsilon = 0$")
    return _draw(Caption(3, shows, claims), (one, two), titles)


@styled
def draw_elastic(spring: Job, ball: Job, own: Job) -> Drawing:
    """Fig. 4: against the ball of restitution 0.15."""
    one, two, three = (_seen(job) for job in (spring, ball, own))
    shows = (
        "A rigid spring of low viscosity (ℰ = 650, ξ = 0.5) and the partially elastic ball (ε = 0.15), "
        f"Γ ramped up; flights under {MICRO_FLIGHT} rad are left out. Contact of the spring: adhesive, "
        "e = 0, 10⁻⁶ A deep."
    )
    claims = (
        _small_differences(compare(one, two)),
        _forbidden(one, two),
        _restitution_of_its_own(compare(one, two), compare(one, three)),
    )
    titles = (r"spring, $\mathcal{E} = 650$, $\xi = 0.5$", r"ball, $\epsilon = 0.15$")
    return _draw(Caption(4, shows, claims), (one, two), titles)


def compare(one: xarray.Dataset, other: xarray.Dataset) -> Comparison:
    """Two diagrams over the same Γ."""
    both = (one.outcome.values == Outcome.PERIODIC) & (other.outcome.values == Outcome.PERIODIC)
    same = both & (one.bounces.values == other.bounces.values) & (one.periods.values == other.periods.values)
    deviations = [
        np.max(np.abs(_cycle(one, int(cell)) - _cycle(other, int(cell)))) for cell in np.flatnonzero(same)
    ]
    return Comparison(int(both.sum()), int(same.sum()), np.array(deviations))


def _cycle(diagram: xarray.Dataset, cell: int) -> NDArray[np.float64]:
    """The flights of one cycle, sorted."""
    times = diagram.flight_time.values[cell]
    return np.sort(times[np.isfinite(times)][-int(diagram.bounces.values[cell]) :])


def _seen(job: Job) -> xarray.Dataset:
    return job.diagram(min_flight=MICRO_FLIGHT)


def _draw(caption: Caption, diagrams: Sequence[xarray.Dataset], titles: Sequence[str]) -> Drawing:
    drawing, room = page(3.9, caption)
    top = 1.06 * max(float(diagram.flight_time.max()) for diagram in diagrams)
    panels = room.subplots(2, 1, sharex=True, sharey=True)
    for axes, diagram, title in zip(panels, diagrams, titles, strict=True):
        dots(axes, diagram, size=0.8)
        values = diagram.gamma.values
        flights_over(axes, float(values[0]), float(values[-1]), top)
        label(axes, title)
    panels[-1].set_xlabel(r"$\Gamma$", labelpad=1)
    return drawing


def _indistinguishable(found: Comparison) -> Claim:
    middle, most = np.median(found.deviations), np.quantile(found.deviations, 0.95)
    return Claim(
        bool(found.same > 0.95 * found.periodic and most < ALIKE),
        f"{found}, their flight times {middle:.3f} rad apart (median; 95th percentile {most:.3f})",
    )


def _ends(spring: xarray.Dataset, which: tuple[int, int], printed: float) -> Claim:
    in_mode = (spring.bounces.values == which[0]) & (spring.periods.values == which[1])
    if not in_mode.any():
        return Claim(False, f"no cell of the spring is in {mode(*which)}")
    last = float(spring.gamma.values[in_mode].max())
    return Claim(abs(last - printed) < 0.06, f"{mode(*which)} ends at Γ = {last:.2f} (the ball's: {printed})")


def _only_when_shallow(deep: Comparison) -> Claim:
    return Claim(
        False,  # left open, whatever comes of it
        f"the contact's depth, which the paper leaves open, decides it: 10⁻³ A deep, it is softer than the "
        f"spring's damper, the spring meets the plate as a whole and hops, and {deep}",
    )


def _small_differences(found: Comparison) -> Claim:
    middle = np.median(found.deviations)
    return Claim(
        bool(found.same > 0.6 * found.periodic and middle < ALIKE),
        f"{found}, their flight times {middle:.4f} rad apart (median)",
    )


def _forbidden(one: xarray.Dataset, other: xarray.Dataset) -> Claim:
    """The paper: "forbidden zones exist in both diagrams"."""
    found = np.sort(np.concatenate([_times(diagram) for diagram in (one, other)]))
    if len(found) < 2:
        return Claim(False, "nothing bounces where forbidden zones were looked for")
    at = int(np.argmax(np.diff(found)))
    low, high = found[at], found[at + 1]
    where = "{} to {}".format(*THROUGH)
    return Claim(
        high - low > 1.0,
        f"forbidden zones: for Γ = {where}, no flight in either lasts {low:.1f} to {high:.1f} rad",
    )


def _times(diagram: xarray.Dataset) -> NDArray[np.float64]:
    """The flights of the cells looked through."""
    times = diagram.flight_time.sel(gamma=slice(*THROUGH)).values
    return np.asarray(times[np.isfinite(times)])


def _restitution_of_its_own(given: Comparison, own: Comparison) -> Claim:
    theirs, ours = np.median(given.deviations), np.median(own.deviations)
    f = float(restitution_of(np.array([0.5]))[0])
    return Claim(
        False,
        "ε = f(ξ), which the paper leaves open, is half the restitution of a contact damped like the spring: "
        f"f(0.5) = {f:.4f}, {'' if ours < theirs else 'not '}closer than 0.15 (median {ours:.4f} rad instead "
        f"of {theirs:.4f})",
    )
