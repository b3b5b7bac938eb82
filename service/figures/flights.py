"""Figs. 2, 3, 4, 7 and 8: bifurcation diagrams."""

from collections import Counter
from collections.abc import Mapping, Sequence
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
from service.figures.drawing import Caption, Claim, Drawing, compared, left_open, mode, percent
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
from service.views.diagram import PERIOD, draw_flights, draw_legend
from service.views.style import BLUE, SYMBOLS

#: Rest length of the drawn spring of Fig. 2, in plate amplitudes; the motion does not depend on it.
LENGTH: Final = 1.6
PERIODS: Final = 6


def figure_2(client: Client, rest: Job, ramped: Job) -> Drawing:
    """The diagram above the four insets: from rest, and ramped up behind it."""
    diagrams = [
        job.diagram().assign_coords(direction=name)
        for job, name in ((ramped, f"{SYMBOLS['gamma']} ramped up"), (rest, "from rest"))
    ]
    both = xarray.concat(diagrams, "direction", combine_attrs="override")
    motions = {gamma: _motion(client, gamma) for gamma in INSETS}

    def draw(area: SubFigure) -> None:
        above, below = _split(area, 3.3, 2.9)
        axes = above.subplots()
        draw_flights(axes, both)
        # Between the marks of (b) and (c), above all flights.
        draw_legend(axes, bbox_to_anchor=(2.32, 1.0), bbox_transform=axes.get_xaxis_transform())
        axes.set_xlabel(SYMBOLS["gamma"])
        panels = below.subplots(2, 2, sharex=True, sharey=True)
        for letter, (gamma, motion), panel in zip("abcd", motions.items(), panels.flat, strict=True):
            _draw_motion(panel, motion)
            panel.set_title(rf"({letter})  {SYMBOLS['gamma']} = {gamma}", loc="left", fontsize=10)
            axes.axvline(gamma, color=BLUE, linewidth=0.6, linestyle=(0, (3, 3)), zorder=2)
            axes.annotate(letter, (gamma, 1), (3, -4), xycoords=("data", "axes fraction"),
                          textcoords="offset points", va="top", color=BLUE)  # fmt: skip
        below.supylabel(r"$z\omega^2\!/g\Gamma$", fontsize=12)
        below.supxlabel("plate periods", fontsize=10)

    return Drawing(_caption(diagrams[1], diagrams[0]), 6.2, draw)


def _split(area: SubFigure, above: float, below: float) -> Any:
    return area.subfigures(2, 1, height_ratios=(above, below))


def _motion(client: Client, gamma: float) -> xarray.Dataset:
    cell = {"gamma": gamma, "omega": 0.5, "xi": 0.26, "model": SOFT}
    return client.trajectory({**cell, "settle": 200, "periods": PERIODS, "samples": 100})


def _draw_motion(axes: Axes, motion: xarray.Dataset) -> None:
    """Draw the spring as a gray band between its masses, and the plate in black."""
    periods = motion.phase.values / PERIOD
    lower, upper = motion.z2.values, motion.z1.values - motion.attrs["rest_length"] + LENGTH
    axes.fill_between(periods, lower, upper, color="0.78", linewidth=0)
    axes.plot(periods, np.stack([lower, upper], axis=1), color="0.55", linewidth=0.7)
    axes.plot(periods, motion.plate.values, color="black", linewidth=1.2)
    axes.set_xlim(0, PERIODS)


def _caption(diagram: xarray.Dataset, up: xarray.Dataset) -> Caption:
    shows = (
        "Flight times φ of the bouncing spring at Ω = 0.5, ξ = 0.26, from rest (red) and with Γ ramped up "
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


def figure_3(spring: Job, ball: Job, deep: Job) -> Drawing:
    """The spring, the completely inelastic ball, and the spring on a deeper contact."""
    of_spring, of_ball, of_deep = (job.diagram(min_flight=MICRO_FLIGHT) for job in (spring, ball, deep))
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
    return _stack(Caption(3, shows, claims), (of_spring, of_ball), titles)


def figure_4(spring: Job, ball: Job, own: Job) -> Drawing:
    """The spring, the ball of restitution 0.15, and the ball of restitution f(ξ)."""
    of_spring, of_ball, of_own = (job.diagram(min_flight=MICRO_FLIGHT) for job in (spring, ball, own))
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
    return _stack(Caption(4, shows, claims), (of_spring, of_ball), titles)


def _stack(caption: Caption, diagrams: Sequence[xarray.Dataset], titles: Sequence[str]) -> Drawing:
    """Panels above each other, on the same scales."""
    longest = max(float(diagram.flight_time.max()) for diagram in diagrams)

    def draw(area: SubFigure) -> None:
        panels: Sequence[Axes] = list(area.subplots(len(diagrams), 1, sharex=True, sharey=True))
        for axes, diagram, title in zip(panels, diagrams, titles, strict=True):
            draw_flights(axes, diagram, longest)
            axes.set_title(title, loc="left", fontsize=10)
        panels[-1].set_xlabel(SYMBOLS[diagrams[0].attrs["along"]])

    return Drawing(caption, 0.3 + 2.0 * len(diagrams), draw)


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


#: Labels of cells that bounce.
BOUNCING: Final = (Outcome.PERIODIC, Outcome.APERIODIC, Outcome.SETTLING, QUASI_PERIODIC, CHAOTIC)

#: Chaos begins where the cells over this range of Γ are chaotic, except in small windows.
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
    below, at, beyond = diagrams = [job.diagram(omega=omega) for omega in OMEGAS]
    shows = (
        "Flight times φ against Γ at ξ = 0.05 for (a) Ω = 0.67, below resonance, (b) 1.00, at resonance, and "
        f"(c) 1.24, beyond it, Γ ramped up. {CONTACT}"
    )
    claims = (
        _shorter(diagrams),
        _chaos_beyond_three(below),
        _chaos_at(at, 4.0),
        _no_chaos(beyond),
        _one_period(below),
        _no_chaos_at_two([near_two.diagram() for near_two in (short, settled, *others)]),
    )
    titles = [
        rf"({letter})  {SYMBOLS['omega']} = {omega:.2f}" for letter, omega in zip("abc", OMEGAS, strict=True)
    ]
    return _stack(Caption(7, shows, claims), diagrams, titles)


def figure_8(job: Job) -> Drawing:
    """Along Ω."""
    diagrams = {gamma: job.diagram("omega", gamma=gamma) for gamma in GAMMAS}
    shows = (
        f"Flight times φ against Ω at ξ = 0.05 for (a) Γ = 1, (b) Γ = 2 and (c) Γ = 3, Ω ramped up. {CONTACT}"
    )
    claims = (
        _stops_at(diagrams[GAMMAS[0]]),
        *(_chaos_when_slow(diagram, gamma) for gamma, diagram in diagrams.items()),
        *(_longer_when_slow(diagram, gamma) for gamma, diagram in diagrams.items()),
    )
    titles = [
        rf"({letter})  {SYMBOLS['gamma']} = {gamma:g}" for letter, gamma in zip("abc", GAMMAS, strict=True)
    ]
    return _stack(Caption(8, shows, claims), list(diagrams.values()), titles)


def share_of(diagram: xarray.Dataset, label: int, where: NDArray[np.bool_] | None = None) -> float:
    """The share of the bouncing cells that has this label; `where` selects cells."""
    labels = diagram.label.values if where is None else diagram.label.values[where]
    return float(np.sum(labels == label) / max(int(np.isin(labels, BOUNCING).sum()), 1))


def chaotic(diagram: xarray.Dataset, where: NDArray[np.bool_] | None = None) -> float:
    """The share of the bouncing cells that is chaotic, by the largest Lyapunov exponent."""
    return share_of(diagram, CHAOTIC, where)


def _near(diagram: xarray.Dataset, value: float, distance: float) -> NDArray[np.bool_]:
    along = diagram[str(diagram.flight_time.dims[0])].values
    return np.asarray(np.abs(along - value) <= distance)


def _longest(diagram: xarray.Dataset, where: NDArray[np.bool_]) -> float:
    times = diagram.flight_time.values[where]
    return float(np.max(times, where=np.isfinite(times), initial=0.0))


def _shorter(diagrams: Sequence[xarray.Dataset]) -> Claim:
    longest = [_longest(diagram, _near(diagram, 3.0, 0.1)) for diagram in diagrams]
    times = ", ".join(f"{time:.1f}" for time in longest)
    falling = longest[0] > longest[1] > longest[2]
    return compared(falling, f"flights shorten as Ω increases: around Γ = 3 the longest last {times} rad")


def _chaos_beyond_three(diagram: xarray.Dataset) -> Claim:
    values = diagram.gamma.values
    begins = next(
        (
            float(value)
            for value in values[values < values[-1] - CHAOTIC_RANGE]
            if chaotic(diagram, (values >= value) & (values <= value + CHAOTIC_RANGE)) > MOSTLY
        ),
        np.inf,
    )
    return compared(bool(2.5 <= begins <= 3.5), f"(a) is chaotic beyond Γ ≈ {begins:.1f}")


def _chaos_at(diagram: xarray.Dataset, gamma: float) -> Claim:
    near = _near(diagram, gamma, 0.25)
    share, tori = chaotic(diagram, near), share_of(diagram, QUASI_PERIODIC, near)
    mostly = share > 0.5
    verdict = "chaotic" if mostly else "hardly chaotic"
    return compared(
        mostly,
        f"(b) is {verdict} around Γ = {gamma:g}: {percent(share)} of the cells within 0.25 are, and "
        f"{percent(tori)} are quasi-periodic",
    )


def _no_chaos(diagram: xarray.Dataset) -> Claim:
    share = chaotic(diagram)
    cells = "none" if share == 0 else percent(share, 1)
    return compared(share < 0.05, f"(c) is not chaotic ({cells} of its bouncing cells are)")


def _one_period(diagram: xarray.Dataset) -> Claim:
    """The paper: "follows a (1, 1) mode in a large interval of Γ"; it may have a hop too short to see."""
    repeats = (diagram.periods.values == 1) & (diagram.bounces.values <= 2) & (diagram.gamma.values > 1.0)
    if not repeats.any():
        return compared(False, "(a) never repeats after one plate period")
    values, cells = diagram.gamma.values[repeats], diagram.isel(gamma=repeats)
    double = cells.bounces.values == 2
    hop = _longest_of_shorter(cells.flight_time.values[double])
    text = f"in (a) one bounce a plate period for Γ from {values.min():.2f} to {values.max():.2f}"
    if double.any():
        text += (
            f", strictly (2, 1) up to {values[double].max():.2f}: a hop of at most {hop:.2f} rad follows it"
        )
    return compared(hop < HOP and values.max() - values.min() > 1.0, text)


def _longest_of_shorter(times: NDArray[np.float64]) -> float:
    """Of cells that repeat two flights, the longest second one, rad."""
    return float(np.max(np.nanmin(times, axis=1))) if len(times) else 0.0


def _no_chaos_at_two(diagrams: Sequence[xarray.Dataset]) -> Claim:
    """The paper: "chaotic behaviors for Γ ≃ 2"; the order of the diagrams is that of the preset."""
    hardly_settled = 1.0 - share_of(diagrams[0], Outcome.PERIODIC)
    _, settled, *others = map(chaotic, diagrams)
    soft, elastic = others[: len(CONTACTS)], others[len(CONTACTS) :]
    on_contacts = ", ".join(f"{percent(share)} ({name})" for name, share in zip(CONTACTS, soft, strict=True))
    with_rebound = ", ".join(
        f"{percent(share)} with e = {e}" for e, share in zip(ELASTIC, elastic, strict=True)
    )
    gamma = diagrams[1].gamma.values
    return compared(
        settled > 0.5,
        f"at Γ = {gamma[0]:g} to {gamma[-1]:g}, (b) is {'' if settled > 0.5 else 'not '}chaotic: "
        f"{percent(settled)} of the cells are after {LONG_SETTLE} plate periods, {on_contacts}; "
        f"they repeat as {_commonest(diagrams[1])}. Not periodic are springs that still settle "
        f"({percent(hardly_settled)} after {SHORT_SETTLE} periods), or rebound ({with_rebound})",
    )


def _commonest(diagram: xarray.Dataset) -> str:
    """The most frequent modes of the periodic cells, most frequent first."""
    repeats = diagram.outcome.values == Outcome.PERIODIC
    pairs = zip(diagram.bounces.values[repeats], diagram.periods.values[repeats], strict=True)
    cells = Counter((int(bounces), int(periods)) for bounces, periods in pairs)
    return ", ".join(mode(*pair) for pair, n in cells.most_common(4) if n > RARE * repeats.sum()) or "nothing"


def _stops_at(diagram: xarray.Dataset) -> Claim:
    bounces = np.isin(diagram.label.values, BOUNCING)
    last = float(diagram.omega.values[bounces].max())
    return compared(
        abs(last - np.sqrt(4 / 3)) < 0.01,
        f"in (a) bouncing ends at Ω = {last:.3f}, where Γ_th = 1 (√(4/3) = 1.155 for every ξ)",
    )


def _chaos_when_slow(diagram: xarray.Dataset, gamma: float) -> Claim:
    share = chaotic(diagram, diagram.omega.values < LOW)
    mostly = share > 0.5
    verdict = "chaotic" if mostly else "not chaotic"
    return compared(
        mostly, f"at Γ = {gamma:g} low Ω is {verdict} ({percent(share)} of the cells below {LOW:g})"
    )


def _longer_when_slow(diagram: xarray.Dataset, gamma: float) -> Claim:
    """The paper: the flight time increases for decreasing Ω."""
    omegas = (0.1, 0.5, 1.0)
    times = [_longest(diagram, _near(diagram, omega, 0.03)) for omega in omegas]
    longest = ", ".join(f"{time:.1f}" for time in times)
    rising = times[0] > times[1] > times[2]
    trend = "longer" if rising else "not longer"
    return compared(
        rising, f"at Γ = {gamma:g} flights are {trend} at low Ω (up to {longest} rad at 0.1, 0.5, 1)"
    )
