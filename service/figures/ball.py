"""Figs. 3 and 4: rigid springs compared with a bouncing ball."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import xarray
from numpy.typing import NDArray

from kernel.params import Outcome
from kernel.restitution import restitution_of
from service.client import Job
from service.figures.canvas import Drawing, flight_scales, new_drawing, panel_title, plot_flights
from service.figures.caption import Caption, Claim, compared, left_open, mode
from service.presets import MICRO_FLIGHT

#: rad; smaller differences of flight times are invisible in the figure.
VISIBLE: Final = 0.05

#: Modes of the inelastic ball and the Γ at which they end (docs/model.md, section 5; from reference 4 of the
#: paper).
INELASTIC: Final = {(1, 1): 3.72419, (2, 2): 4.60334, (1, 2): 6.59382}

#: The range of Γ of Fig. 4 that is searched for flight times that do not occur.
GAP_RANGE: Final = (4.7, 5.3)


class Comparison(NamedTuple):
    """Two diagrams compared cell by cell, where both are periodic."""

    periodic: int  # cells periodic in both
    same: int  # of these, cells in the same mode
    deviations: NDArray[
        np.float64
    ]  # (same,) rad; largest difference between the sorted flight times of a cycle

    def __str__(self) -> str:
        return f"{self.same} of {self.periodic} periodic cells are in the same mode"


def draw_inelastic(spring: Job, ball: Job, deep: Job) -> Drawing:
    """Fig. 3: the spring, the completely inelastic ball, and the spring on a deeper contact."""
    of_spring, of_ball, of_deep = (_diagram(job) for job in (spring, ball, deep))
    shows = (
        "A rigid spring (ℰ = ξ/Ω = 650, ξ = 10) and the completely inelastic ball (ε = 0), Γ ramped up. "
        "Contact of the spring: adhesive, e = 0, 10⁻⁶ A deep."
    )
    claims = (
        _indistinguishable(compare(of_spring, of_ball)),
        *(_ends(of_spring, *end) for end in INELASTIC.items()),
        _only_when_shallow(compare(of_deep, of_ball.sel(gamma=of_deep.gamma, method="nearest"))),
    )
    titles = (r"spring, $\mathcal{E} = 650$, $\xi = 10$", r"ball, $\epsilon = 0$")
    return _draw(Caption(3, shows, claims), (of_spring, of_ball), titles)


def draw_elastic(spring: Job, ball: Job, own: Job) -> Drawing:
    """Fig. 4: the spring, the ball of restitution 0.15, and the ball of restitution f(ξ)."""
    of_spring, of_ball, of_own = (_diagram(job) for job in (spring, ball, own))
    shows = (
        "A rigid spring of low viscosity (ℰ = 650, ξ = 0.5) and the partially elastic ball (ε = 0.15), "
        f"Γ ramped up; flights under {MICRO_FLIGHT} rad are left out. Contact of the spring: adhesive, "
        "e = 0, 10⁻⁶ A deep."
    )
    claims = (
        _small_differences(compare(of_spring, of_ball)),
        _forbidden(of_spring, of_ball),
        _own_restitution(compare(of_spring, of_ball), compare(of_spring, of_own)),
    )
    titles = (r"spring, $\mathcal{E} = 650$, $\xi = 0.5$", r"ball, $\epsilon = 0.15$")
    return _draw(Caption(4, shows, claims), (of_spring, of_ball), titles)


def compare(first: xarray.Dataset, second: xarray.Dataset) -> Comparison:
    """Compare two diagrams over the same values of Γ."""
    both = (first.outcome.values == Outcome.PERIODIC) & (second.outcome.values == Outcome.PERIODIC)
    same = (
        both
        & (first.bounces.values == second.bounces.values)
        & (first.periods.values == second.periods.values)
    )
    deviations = [
        np.max(np.abs(_cycle(first, int(cell)) - _cycle(second, int(cell)))) for cell in np.flatnonzero(same)
    ]
    return Comparison(int(both.sum()), int(same.sum()), np.array(deviations))


def _cycle(diagram: xarray.Dataset, cell: int) -> NDArray[np.float64]:
    """The flight times of one cycle, sorted."""
    times = diagram.flight_time.values[cell]
    return np.sort(times[np.isfinite(times)][-int(diagram.bounces.values[cell]) :])


def _diagram(job: Job) -> xarray.Dataset:
    return job.diagram(min_flight=MICRO_FLIGHT)


def _draw(caption: Caption, diagrams: Sequence[xarray.Dataset], titles: Sequence[str]) -> Drawing:
    drawing, area = new_drawing(3.9, caption)
    top = 1.06 * max(float(diagram.flight_time.max()) for diagram in diagrams)
    panels = area.subplots(2, 1, sharex=True, sharey=True)
    for axes, diagram, title in zip(panels, diagrams, titles, strict=True):
        plot_flights(axes, diagram, markersize=1.6)
        values = diagram.gamma.values
        flight_scales(axes, float(values[0]), float(values[-1]), top)
        panel_title(axes, title)
    panels[-1].set_xlabel(r"$\Gamma$", labelpad=1)
    return drawing


def _indistinguishable(comparison: Comparison) -> Claim:
    median, p95 = np.median(comparison.deviations), np.quantile(comparison.deviations, 0.95)
    return compared(
        bool(comparison.same > 0.95 * comparison.periodic and p95 < VISIBLE),
        f"{comparison}, their flight times {median:.3f} rad apart (median; 95th percentile {p95:.3f})",
    )


def _ends(spring: xarray.Dataset, ending: tuple[int, int], printed: float) -> Claim:
    in_mode = (spring.bounces.values == ending[0]) & (spring.periods.values == ending[1])
    if not in_mode.any():
        return compared(False, f"no cell of the spring is in {mode(*ending)}")
    last = float(spring.gamma.values[in_mode].max())
    return compared(
        abs(last - printed) < 0.06, f"{mode(*ending)} ends at Γ = {last:.2f} (the ball's: {printed})"
    )


def _only_when_shallow(deep: Comparison) -> Claim:
    return left_open(
        "the depth of the contact decides it: 10⁻³ A deep, it is softer than the spring's damper, the spring "
        f"meets the plate as a whole and hops, and {deep}"
    )


def _small_differences(comparison: Comparison) -> Claim:
    median = np.median(comparison.deviations)
    return compared(
        bool(comparison.same > 0.6 * comparison.periodic and median < VISIBLE),
        f"{comparison}, their flight times {median:.4f} rad apart (median)",
    )


def _forbidden(first: xarray.Dataset, second: xarray.Dataset) -> Claim:
    """The paper: "forbidden zones exist in both diagrams"."""
    times = np.sort(np.concatenate([_times(diagram) for diagram in (first, second)]))
    if len(times) < 2:
        return compared(False, "nothing bounces where forbidden zones were searched for")
    gap = int(np.argmax(np.diff(times)))
    low, high = times[gap], times[gap + 1]
    gamma_range = "{} to {}".format(*GAP_RANGE)
    return compared(
        high - low > 1.0,
        f"forbidden zones: for Γ = {gamma_range}, no flight in either lasts {low:.1f} to {high:.1f} rad",
    )


def _times(diagram: xarray.Dataset) -> NDArray[np.float64]:
    """The flight times of the cells with Γ in GAP_RANGE."""
    times = diagram.flight_time.sel(gamma=slice(*GAP_RANGE)).values
    return np.asarray(times[np.isfinite(times)])


def _own_restitution(printed: Comparison, own: Comparison) -> Claim:
    printed_median, own_median = np.median(printed.deviations), np.median(own.deviations)
    f = float(restitution_of(np.array([0.5]))[0])
    return left_open(
        "the restitution ε = f(ξ) of the spring's ball: half that of a contact damped like the spring gives "
        f"f(0.5) = {f:.4f}, {'' if own_median < printed_median else 'not '}closer than 0.15 "
        f"(median {own_median:.4f} rad instead of {printed_median:.4f})",
    )
