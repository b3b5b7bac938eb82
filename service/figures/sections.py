"""Figs. 7 and 8: flight times along Γ at three Ω, and along Ω at three Γ, at ξ = 0.05."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

import numpy as np
import xarray
from matplotlib.axes import Axes
from numpy.typing import NDArray

from kernel.labels import CHAOTIC, QUASI_PERIODIC
from kernel.params import Outcome
from kernel.threshold import threshold
from service.client import Job
from service.figures.canvas import (
    BLUE,
    Drawing,
    flight_scales,
    new_drawing,
    panel_title,
    plot_flights,
)
from service.figures.caption import Caption, Claim, compared, mode, percent
from service.presets import CONTACTS, ELASTIC, GAMMAS, LONG_SETTLE, OMEGAS, SHORT_SETTLE, XI

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


def draw_along_gamma(job: Job, short: Job, settled: Job, *others: Job) -> Drawing:
    """Fig. 7; the jobs after the first are cells around Γ = 2 at Ω = 1, in the order of the preset."""
    diagrams = [job.diagram(omega=omega) for omega in OMEGAS]
    around_two = [near_two.diagram() for near_two in (short, settled, *others)]
    shows = (
        "Flight times φ against Γ at ξ = 0.05 for (a) Ω = 0.67, below resonance, (b) 1.00, at resonance, and "
        f"(c) 1.24, beyond it, Γ ramped up. {CONTACT}"
    )
    below, at, beyond = diagrams
    claims = (
        _shorter(diagrams),
        _chaos_beyond_three(below),
        _chaos_at(at, 4.0),
        _no_chaos(beyond),
        _one_period(below),
        _no_chaos_at_two(around_two),
    )
    titles = [rf"({letter})  $\Omega = {omega:.2f}$" for letter, omega in zip("abc", OMEGAS, strict=True)]
    drawing, panels = _stack(Caption(7, shows, claims), diagrams, titles)
    for axes, omega in zip(panels, OMEGAS, strict=True):
        _mark(axes, float(threshold(omega, XI)), r"$\Gamma_{\mathrm{th}}$")
    panels[-1].set_xlabel(r"$\Gamma$", labelpad=1)
    return drawing


def draw_along_omega(job: Job) -> Drawing:
    """Fig. 8."""
    diagrams = [job.diagram("omega", gamma=gamma) for gamma in GAMMAS]
    shows = (
        f"Flight times φ against Ω at ξ = 0.05 for (a) Γ = 1, (b) Γ = 2 and (c) Γ = 3, Ω ramped up. {CONTACT}"
    )
    claims = (
        _stops_at(diagrams[0]),
        *(_chaos_when_slow(diagram, gamma) for diagram, gamma in zip(diagrams, GAMMAS, strict=True)),
        *(_longer_when_slow(diagram, gamma) for diagram, gamma in zip(diagrams, GAMMAS, strict=True)),
    )
    titles = [rf"({letter})  $\Gamma = {gamma:g}$" for letter, gamma in zip("abc", GAMMAS, strict=True)]
    drawing, panels = _stack(Caption(8, shows, claims), diagrams, titles)
    panels[-1].set_xlabel(r"$\Omega$", labelpad=1)
    return drawing


def share_of(diagram: xarray.Dataset, label: int, where: NDArray[np.bool_] | None = None) -> float:
    """The share of the bouncing cells that has this label; `where` selects cells."""
    labels = diagram.label.values if where is None else diagram.label.values[where]
    return float(np.sum(labels == label) / max(int(np.isin(labels, BOUNCING).sum()), 1))


def chaotic(diagram: xarray.Dataset, where: NDArray[np.bool_] | None = None) -> float:
    """The share of the bouncing cells that is chaotic, by the largest Lyapunov exponent."""
    return share_of(diagram, CHAOTIC, where)


def _stack(
    caption: Caption, diagrams: Sequence[xarray.Dataset], titles: Sequence[str]
) -> tuple[Drawing, Sequence[Axes]]:
    """Panels above each other, on the same scales."""
    drawing, area = new_drawing(5.0, caption)
    panels: Sequence[Axes] = list(area.subplots(len(diagrams), 1, sharex=True, sharey=True))
    top = 1.04 * max(float(diagram.flight_time.max()) for diagram in diagrams)
    for axes, diagram, title in zip(panels, diagrams, titles, strict=True):
        plot_flights(axes, diagram, markersize=1.4)
        values = diagram[str(diagram.flight_time.dims[0])].values
        flight_scales(axes, 0.0, float(values[-1]), top)
        panel_title(axes, title)
    return drawing, panels


def _mark(axes: Axes, value: float, name: str) -> None:
    axes.axvline(value, color=BLUE, linewidth=0.8, linestyle=(0, (4, 3)), zorder=2)
    axes.annotate(name, (value, 1), (3, -3), xycoords=("data", "axes fraction"),
                  textcoords="offset points", va="top", color=BLUE)  # fmt: skip


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
