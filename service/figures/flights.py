"""Figs. 2, 3, 4, 7 and 8: bifurcation diagrams."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from numpy.typing import NDArray

from kernel.labels import CHAOTIC, QUASI_PERIODIC
from kernel.params import Outcome
from kernel.restitution import restitution_of
from service.client import Client, Job
from service.figures.drawing import Caption, Claim, Drawing, compared, left_open, named, percent
from service.pictures import GREY, PERIOD, SYMBOLS, draw_diagram
from service.presets import (
    CONTACTS,
    ELASTIC,
    GAMMAS,
    INSETS,
    LONG_SETTLE,
    MICRO_FLIGHT,
    OMEGAS,
    SHORT_SETTLE,
    SOFT,
)

#: Rest length of the drawn spring of Fig. 2, in plate amplitudes; the motion does not depend on it.
LENGTH: Final = 1.6
PERIODS: Final = 6


def figure_2(client: Client, rest: Job, ramped: Job) -> Drawing:
    """The diagram above the four insets: from rest, and ramped up behind it."""
    diagrams = [job.diagram().assign_coords(direction=name) for job, name in ((ramped, "up"), (rest, "rest"))]
    both = xarray.concat(diagrams, "direction", combine_attrs="override")
    motions = {gamma: motion(client, gamma) for gamma in INSETS}

    def draw(area: SubFigure) -> None:
        areas: Any = area.subfigures(2, 1, height_ratios=(3.3, 2.9))
        above, below = areas
        axes = above.subplots()
        draw_diagram(axes, both)
        # Between the marks of (b) and (c), above all flights.
        between: Any = {"bbox_to_anchor": (2.32, 1.0), "bbox_transform": axes.get_xaxis_transform()}
        legend = axes.legend(loc="upper left", markerscale=3, handletextpad=0.2, frameon=False, **between)
        legend.set_zorder(4)
        axes.set_xlabel(SYMBOLS["gamma"])
        panels = below.subplots(2, 2, sharex=True, sharey=True)
        for letter, (gamma, motion), panel in zip("abcd", motions.items(), panels.flat, strict=True):
            _draw_motion(panel, motion)
            panel.set_title(rf"({letter})  {SYMBOLS['gamma']} = {gamma}", loc="left", fontsize=10)
            axes.axvline(gamma, color=GREY, linewidth=0.6, linestyle=(0, (3, 3)), zorder=2)
            axes.annotate(letter, (gamma, 1), (3, -4), xycoords=("data", "axes fraction"),
                          textcoords="offset points", va="top", color="0.35")  # fmt: skip
        below.supylabel(r"$z\omega^2\!/g\Gamma$", fontsize=12)
        below.supxlabel("plate periods", fontsize=10)

    shows = (
        "Flight times φ of the bouncing spring at Ω = 0.5, ξ = 0.26, from rest (black) and with Γ ramped up "
        "(blue); below, its motion from rest (gray) above the plate (black) once settled, drawn with a rest "
        "length of 1.6 A. Contact: adhesive, e = 0, 10⁻³ A deep; faint lines: whole plate periods."
    )
    modes_up, modes = ({gamma: _mode(diagram, gamma) for gamma in INSETS} for diagram in diagrams)
    claims = [_claim(gamma, modes[gamma], "") for gamma in INSETS]
    ramped_up = ", when Γ is ramped up as the paper says it was"
    claims += [_claim(gamma, mode, ramped_up) for gamma, mode in modes_up.items() if mode != modes[gamma]]
    return Drawing(Caption(2, shows, tuple(claims)), 6.2, draw)


def motion(client: Client, gamma: float, settle: int = 200) -> xarray.Dataset:
    """The motion in one of Fig. 2's insets, after this many plate periods from rest."""
    cell = {"gamma": gamma, "omega": 0.5, "xi": 0.26, "model": SOFT, "settle": settle}
    return client.trajectory(cell | {"periods": PERIODS, "samples": 100})


def _draw_motion(axes: Axes, motion: xarray.Dataset) -> None:
    """Draw the spring as a gray band between its masses, and the plate in black."""
    periods = motion.phase.values / PERIOD
    lower, upper = motion.z2.values, motion.z1.values - motion.attrs["rest_length"] + LENGTH
    axes.fill_between(periods, lower, upper, color="0.78", linewidth=0)
    axes.plot(periods, np.stack([lower, upper], axis=1), color="0.55", linewidth=0.7)
    axes.plot(periods, motion.plate.values, color="black", linewidth=1.2)
    axes.set_xlim(0, PERIODS)


def _claim(gamma: float, computed: str, condition: str) -> Claim:
    printed = INSETS[gamma]
    expected = named(*printed) if printed else "aperiodic"
    wrong = "" if computed == expected else f", not {expected}"
    return compared(not wrong, f"{computed} at Γ = {gamma}{condition}{wrong}")


def _mode(diagram: xarray.Dataset, gamma: float) -> str:
    cell = diagram.sel(gamma=gamma, method="nearest")
    if int(cell.outcome) == Outcome.PERIODIC:
        return named(int(cell.bounces), int(cell.periods))
    return Outcome(int(cell.outcome)).name.lower().replace("_", " ")


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
    deviations: NDArray[np.float64]  # (same,) rad; largest difference of the sorted flights of a cycle

    def __str__(self) -> str:
        return f"{self.same} of {self.periodic} periodic cells are in the same mode"


def figure_3(spring: Job, ball: Job, deep: Job) -> Drawing:
    """The spring, the completely inelastic ball, and the spring on a deeper contact."""
    of_spring, of_ball, of_deep = (job.diagram(min_flight=MICRO_FLIGHT) for job in (spring, ball, deep))
    both = compare(of_spring, of_ball)
    on_deep = compare(of_deep, of_ball.sel(gamma=of_deep.gamma, method="nearest"))
    median, p95 = np.quantile(both.deviations, (0.5, 0.95))
    shows = (
        "A rigid spring (ℰ = ξ/Ω = 650, ξ = 10) and the completely inelastic ball (ε = 0), Γ ramped up. "
        "Contact of the spring: adhesive, e = 0, 10⁻⁶ A deep."
    )
    claims = (
        compared(
            both.same > 0.95 * both.periodic and p95 < VISIBLE,
            f"{both}, their flight times {median:.3f} rad apart (median; 95th percentile {p95:.3f})",
        ),
        *(_ends(of_spring, *end) for end in INELASTIC.items()),
        left_open(
            "the depth of the contact decides it: 10⁻³ A deep, it is softer than the spring's damper, the "
            f"spring meets the plate as a whole and hops, and {on_deep}"
        ),
    )
    titles = (r"spring, $\mathcal{E} = 650$, $\xi = 10$", r"ball, $\epsilon = 0$")
    return _stack(Caption(3, shows, claims), (of_spring, of_ball), titles)


def figure_4(spring: Job, ball: Job, own: Job) -> Drawing:
    """The spring, the ball of restitution 0.15, and the ball of restitution f(ξ)."""
    of_spring, of_ball, of_own = (job.diagram(min_flight=MICRO_FLIGHT) for job in (spring, ball, own))
    both = compare(of_spring, of_ball)
    median, of_f = np.median(both.deviations), np.median(compare(of_spring, of_own).deviations)
    shows = (
        "A rigid spring of low viscosity (ℰ = 650, ξ = 0.5) and the partially elastic ball (ε = 0.15), "
        f"Γ ramped up; flights under {MICRO_FLIGHT} rad are left out. Contact of the spring: adhesive, "
        "e = 0, 10⁻⁶ A deep."
    )
    claims = (
        compared(
            both.same > 0.6 * both.periodic and median < VISIBLE,
            f"{both}, their flight times {median:.4f} rad apart (median)",
        ),
        _forbidden(of_spring, of_ball),
        left_open(
            "the restitution ε = f(ξ) of the spring's ball: half that of a contact damped like the spring "
            f"gives f(0.5) = {restitution_of(np.array([0.5]))[0]:.4f}, {'' if of_f < median else 'not '}"
            f"closer than 0.15 (median {of_f:.4f} rad instead of {median:.4f})"
        ),
    )
    titles = (r"spring, $\mathcal{E} = 650$, $\xi = 0.5$", r"ball, $\epsilon = 0.15$")
    return _stack(Caption(4, shows, claims), (of_spring, of_ball), titles)


def _stack(caption: Caption, diagrams: Sequence[xarray.Dataset], titles: Sequence[str]) -> Drawing:
    """Panels above each other, on the same scales."""
    longest = max(float(diagram.flight_time.max()) for diagram in diagrams)

    def draw(area: SubFigure) -> None:
        panels: Sequence[Axes] = list(area.subplots(len(diagrams), 1, sharex=True, sharey=True))
        for axes, diagram, title in zip(panels, diagrams, titles, strict=True):
            draw_diagram(axes, diagram, longest)
            axes.set_title(title, loc="left", fontsize=10)
            axes.label_outer()

    return Drawing(caption, 0.3 + 2.0 * len(diagrams), draw)


def compare(first: xarray.Dataset, second: xarray.Dataset) -> Comparison:
    """Compare two diagrams over the same values of Γ."""
    both = (first.outcome.values == Outcome.PERIODIC) & (second.outcome.values == Outcome.PERIODIC)
    same = both & (first.bounces.values == second.bounces.values)
    same &= first.periods.values == second.periods.values
    deviations = [
        np.max(np.abs(_cycle(first, int(cell)) - _cycle(second, int(cell)))) for cell in np.flatnonzero(same)
    ]
    return Comparison(int(both.sum()), int(same.sum()), np.array(deviations))


def _cycle(diagram: xarray.Dataset, cell: int) -> NDArray[np.float64]:
    """The flight times of one cycle, sorted."""
    times = diagram.flight_time.values[cell]
    return np.sort(times[np.isfinite(times)][-int(diagram.bounces.values[cell]) :])


def _ends(spring: xarray.Dataset, ending: tuple[int, int], printed: float) -> Claim:
    in_mode = (spring.bounces.values == ending[0]) & (spring.periods.values == ending[1])
    if not in_mode.any():
        return compared(False, f"no cell of the spring is in {named(*ending)}")
    last = float(spring.gamma.values[in_mode].max())
    return compared(
        abs(last - printed) < 0.06, f"{named(*ending)} ends at Γ = {last:.2f} (the ball's: {printed})"
    )


def _forbidden(*diagrams: xarray.Dataset) -> Claim:
    """The paper: "forbidden zones exist in both diagrams"."""
    times = [diagram.flight_time.sel(gamma=slice(*GAP_RANGE)).values.ravel() for diagram in diagrams]
    sorted_times = np.sort(np.concatenate(times))
    gaps = np.diff(sorted_times[np.isfinite(sorted_times)])
    if not len(gaps):
        return compared(False, "nothing bounces where forbidden zones were searched for")
    low, high = sorted_times[np.argmax(gaps) :][:2]
    gamma_range = "{} to {}".format(*GAP_RANGE)
    return compared(
        high - low > 1.0,
        f"forbidden zones: for Γ = {gamma_range}, no flight in either lasts {low:.1f} to {high:.1f} rad",
    )


#: Labels of cells that bounce.
BOUNCING: Final = (Outcome.PERIODIC, Outcome.APERIODIC, Outcome.SETTLING, QUASI_PERIODIC, CHAOTIC)

#: Chaos begins where nearly all cells over this range of Γ are chaotic.
CHAOTIC_RANGE: Final = 0.5
#: A share of cells above this is nearly all of them: windows of periodic motion lie between chaotic cells.
MOSTLY: Final = 0.85
#: Below this Ω the paper's diagrams are chaotic.
LOW: Final = 0.4
#: rad; a flight shorter than this is drawn on the axis.
HOP: Final = 0.15

#: Modes with a smaller share of the periodic cells are not listed.
RARE: Final = 0.05

CONTACT: Final = (
    "Contact: adhesive, e = 0, 10⁻³ A deep; faint lines: whole plate periods. Chaotic is what has a positive "
    "Lyapunov exponent."
)


def figure_7(job: Job, short: Job, settled: Job, *others: Job) -> Drawing:
    """Along Γ; the jobs after the first are cells around Γ = 2 at Ω = 1, in the order of the preset."""
    below, resonant, beyond = diagrams = [job.diagram(omega=omega) for omega in OMEGAS]
    shows = (
        "Flight times φ against Γ at ξ = 0.05 for (a) Ω = 0.67, below resonance, (b) 1.00, at resonance, and "
        f"(c) 1.24, beyond it, Γ ramped up. {CONTACT}"
    )
    longest = [_longest(diagram, 3.0, 0.1) for diagram in diagrams]
    near_four = resonant.sel(gamma=slice(3.75, 4.25))
    at_four, at_all = chaotic(near_four), chaotic(beyond)
    begins = _beginning_of_chaos(below)
    claims = (
        compared(
            _falls(longest),
            f"flights shorten as Ω increases: around Γ = 3 the longest last {_listed(longest)} rad",
        ),
        compared(2.5 <= begins <= 3.5, f"(a) is chaotic beyond Γ ≈ {begins:.1f}"),
        compared(
            at_four > 0.5,
            f"(b) is {'' if at_four > 0.5 else 'hardly '}chaotic around Γ = 4: {percent(at_four)} of the "
            f"cells within 0.25 are, and {percent(share_of(near_four, QUASI_PERIODIC))} are quasi-periodic",
        ),
        compared(
            at_all < 0.05,
            f"(c) is not chaotic ({percent(at_all, 1) if at_all else 'none'} of its bouncing cells are)",
        ),
        _one_period(below),
        _no_chaos_at_two([near_two.diagram() for near_two in (short, settled, *others)]),
    )
    titles = [f"({x})  {SYMBOLS['omega']} = {omega:.2f}" for x, omega in zip("abc", OMEGAS, strict=True)]
    return _stack(Caption(7, shows, claims), diagrams, titles)


def figure_8(job: Job) -> Drawing:
    """Along Ω."""
    diagrams = {gamma: job.diagram("omega", gamma=gamma) for gamma in GAMMAS}
    first = diagrams[GAMMAS[0]]
    last = float(first.omega.values[np.isin(first.label.values, BOUNCING)].max())
    shows = (
        f"Flight times φ against Ω at ξ = 0.05 for (a) Γ = 1, (b) Γ = 2 and (c) Γ = 3, Ω ramped up. {CONTACT}"
    )
    claims = (
        compared(
            abs(last - np.sqrt(4 / 3)) < 0.01,
            f"in (a) bouncing ends at Ω = {last:.3f}, where Γ_th = 1 (√(4/3) = 1.155 for every ξ)",
        ),
        *(_chaos_when_slow(diagram, gamma) for gamma, diagram in diagrams.items()),
        *(_longer_when_slow(diagram, gamma) for gamma, diagram in diagrams.items()),
    )
    titles = [f"({x})  {SYMBOLS['gamma']} = {gamma:g}" for x, gamma in zip("abc", GAMMAS, strict=True)]
    return _stack(Caption(8, shows, claims), list(diagrams.values()), titles)


def share_of(diagram: xarray.Dataset, label: int) -> float:
    """The share of the bouncing cells that has this label."""
    labels = diagram.label.values
    return float(np.sum(labels == label) / max(int(np.isin(labels, BOUNCING).sum()), 1))


def chaotic(diagram: xarray.Dataset) -> float:
    """The share of the bouncing cells that is chaotic, by the largest Lyapunov exponent."""
    return share_of(diagram, CHAOTIC)


def _longest(diagram: xarray.Dataset, value: float, distance: float) -> float:
    """The longest flight of the cells within a distance of a value of the axis, rad."""
    near = np.abs(diagram[diagram.attrs["along"]].values - value) <= distance
    return float(np.nanmax(diagram.flight_time.values[near], initial=0.0))


def _falls(times: Sequence[float]) -> bool:
    return all(np.diff(times) < 0)


def _listed(times: Sequence[float]) -> str:
    return ", ".join(f"{time:.1f}" for time in times)


def _beginning_of_chaos(diagram: xarray.Dataset) -> float:
    """The first Γ from which on nearly all cells of CHAOTIC_RANGE are chaotic; infinite if there is none."""
    values = diagram.gamma.values
    starts = values[values < values[-1] - CHAOTIC_RANGE]
    parts = ((float(start), diagram.sel(gamma=slice(start, start + CHAOTIC_RANGE))) for start in starts)
    return next((start for start, part in parts if chaotic(part) > MOSTLY), np.inf)


def _one_period(diagram: xarray.Dataset) -> Claim:
    """The paper: "follows a (1, 1) mode in a large interval of Γ". A hop may be too short to see in it."""
    repeats = (diagram.periods.values == 1) & (diagram.bounces.values <= 2) & (diagram.gamma.values > 1.0)
    if not repeats.any():
        return compared(False, "(a) never repeats after one plate period")
    cells = diagram.isel(gamma=repeats)
    values, double = cells.gamma.values, cells.bounces.values == 2
    shown = f"Γ from {values.min():.2f} to {values.max():.2f}"
    text = f"in (a), once settled, one bounce a plate period for {shown}"
    hop = 0.0
    if double.any():
        hop = float(np.max(np.nanmin(cells.flight_time.values[double], axis=1)))
        last = values[double].max()
        text += f", strictly (2, 1) up to {last:.2f}: a hop of at most {hop:.2f} rad follows it"
    return compared(hop < HOP and values.max() - values.min() > 1.0, text)


def _no_chaos_at_two(diagrams: Sequence[xarray.Dataset]) -> Claim:
    """The paper: "chaotic behaviors for Γ ≃ 2"; the order of the diagrams is that of the preset."""
    hardly_settled = 1.0 - share_of(diagrams[0], Outcome.PERIODIC)
    stepped = float(np.mean(diagrams[-1].outcome.values != Outcome.PERIODIC))
    _, settled, *others = map(chaotic, diagrams[:-1])
    soft, elastic = others[: len(CONTACTS)], others[len(CONTACTS) :]
    on_contacts = ", ".join(f"{percent(x)} ({name})" for name, x in zip(CONTACTS, soft, strict=True))
    with_rebound = ", ".join(f"{percent(x)} with e = {e}" for e, x in zip(ELASTIC, elastic, strict=True))
    gamma = diagrams[1].gamma.values
    return compared(
        settled > 0.5,
        f"at Γ = {gamma[0]:g} to {gamma[-1]:g}, (b) is {'' if settled > 0.5 else 'not '}chaotic: "
        f"{percent(settled)} of the cells are after {LONG_SETTLE} plate periods, {on_contacts}; "
        f"they repeat as {_commonest(diagrams[1])}. Not periodic are springs that still settle "
        f"({percent(hardly_settled)} after {SHORT_SETTLE} periods), rebound ({with_rebound}), or take "
        f"plain Euler steps of a twentieth of a contact ({percent(stepped)} with e = 10⁻⁶): the paper's "
        "chaos there can be its time step's",
    )


def _commonest(diagram: xarray.Dataset) -> str:
    """The most frequent modes of the periodic cells, most frequent first."""
    repeats = diagram.outcome.values == Outcome.PERIODIC
    pairs = zip(diagram.bounces.values[repeats], diagram.periods.values[repeats], strict=True)
    cells = Counter((int(bounces), int(periods)) for bounces, periods in pairs)
    return (
        ", ".join(named(*pair) for pair, n in cells.most_common(4) if n > RARE * repeats.sum()) or "nothing"
    )


def _chaos_when_slow(diagram: xarray.Dataset, gamma: float) -> Claim:
    share = chaotic(diagram.isel(omega=diagram.omega.values < LOW))
    return compared(
        share > 0.5,
        f"at Γ = {gamma:g} low Ω is {'' if share > 0.5 else 'not '}chaotic ({percent(share)} of the cells "
        f"below {LOW:g})",
    )


def _longer_when_slow(diagram: xarray.Dataset, gamma: float) -> Claim:
    """The paper: the flight time increases for decreasing Ω."""
    times = [_longest(diagram, omega, 0.03) for omega in (0.1, 0.5, 1.0)]
    return compared(
        _falls(times),
        f"at Γ = {gamma:g} flights are {'' if _falls(times) else 'not '}longer at low Ω (up to "
        f"{_listed(times)} rad at 0.1, 0.5, 1)",
    )
