"""Claims of captions on data made for them: what agrees, what contradicts, and the bounds between."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import xarray
from tables import for_each

from kernel.labels import CHAOTIC, QUASI_PERIODIC
from kernel.params import Outcome
from service.figures import ball, hysteresis, sections, thresholds
from service.figures.caption import Claim, Verdict

AGREES, CONTRADICTS = Verdict.AGREES, Verdict.CONTRADICTS


def diagram(values: Sequence[float], axis: str = "gamma", **cells: Any) -> xarray.Dataset:
    """A bifurcation diagram; of its variables those that a claim is about."""
    variables = {
        name: ((axis, "flight") if name == "flight_time" else axis, np.array(each))
        for name, each in cells.items()
    }
    return xarray.Dataset(variables, {axis: np.array(values, float)})


def labelled(chaotic: int, others: int, **axis: Sequence[float]) -> xarray.Dataset:
    """Cells of which so many are chaotic, the others quasi-periodic."""
    ((name, values),) = axis.items() or [("gamma", range(chaotic + others))]
    label = [CHAOTIC] * chaotic + [QUASI_PERIODIC] * others
    return diagram(values, name, label=label, flight_time=np.ones((len(label), 1)))


def verdicts(claims: Sequence[Claim]) -> list[Verdict]:
    return [claim.verdict for claim in claims]


# A rigid spring and a ball


def modes(*pairs: tuple[int, int], times: Sequence[Sequence[float]], periodic: bool = True) -> xarray.Dataset:
    outcome = Outcome.PERIODIC if periodic else Outcome.APERIODIC
    bounces, periods = zip(*pairs, strict=True)
    values = range(len(pairs))
    outcomes = [outcome] * len(pairs)
    return diagram(values, outcome=outcomes, bounces=bounces, periods=periods, flight_time=times)


def test_cycles_are_compared_cell_by_cell_where_both_are_periodic():
    times = [[9.0, 1.0, 2.0], [3.0, np.nan, np.nan], [1.0, 1.0, np.nan], [4.0, 4.0, np.nan]]
    others = [[7.0, 2.0, 1.5], [3.25, np.nan, np.nan], [1.0, 1.0, np.nan], [4.0, 4.0, np.nan]]
    first = modes((2, 2), (1, 1), (2, 1), (1, 1), times=times)
    second = modes((2, 2), (1, 1), (2, 2), (2, 1), times=others)
    compared = ball.compare(first, second)
    assert (compared.periodic, compared.same) == (4, 2)
    assert compared.deviations.tolist() == [0.5, 0.25]  # in the order of the times within a cycle, too
    assert str(compared) == "2 of 4 periodic cells are in the same mode"
    aperiodic = modes((2, 2), (1, 1), (2, 1), (1, 1), times=times, periodic=False)
    assert ball.compare(first, aperiodic)[:2] == ball.compare(aperiodic, first)[:2] == (0, 0)


@for_each(
    ("same", "of", "deviation", "indistinguishable", "small"),
    [
        (20, 20, 0.01, AGREES, AGREES),
        (19, 20, 0.01, CONTRADICTS, AGREES),
        (20, 20, 0.06, CONTRADICTS, CONTRADICTS),
        (12, 20, 0.01, CONTRADICTS, CONTRADICTS),
        (13, 20, 0.01, CONTRADICTS, AGREES),
    ],
)
def test_diagrams_differ_little_where_most_modes_and_times_are_the_same(
    same: int, of: int, deviation: float, indistinguishable: Verdict, small: Verdict
):
    comparison = ball.Comparison(of, same, np.full(same, deviation))
    claims = (ball._indistinguishable(comparison), ball._small_differences(comparison))
    assert verdicts(claims) == [indistinguishable, small]


@pytest.mark.parametrize(
    ("last", "verdict"), [(3.72, AGREES), (3.67, AGREES), (3.79, CONTRADICTS), (3.65, CONTRADICTS)]
)
def test_a_mode_ends_where_the_balls_does_or_not(last: float, verdict: Verdict):
    spring = diagram([1.0, last, 5.0, 6.0], bounces=[1, 1, 2, 1], periods=[2, 2, 2, 1])
    claim = ball._ends(spring, (1, 2), 3.72419)
    assert (claim.verdict, claim.text) == (verdict, f"(1, 2) ends at Γ = {last:.2f} (the ball's: 3.72419)")


def test_a_mode_that_the_spring_is_never_in():
    spring = diagram([1.0, 2.0], bounces=[1, 2], periods=[2, 1])
    assert ball._ends(spring, (1, 1), 3.7) == Claim(CONTRADICTS, "no cell of the spring is in (1, 1)")


@pytest.mark.parametrize(
    ("gap", "verdict"), [(1.0, CONTRADICTS), (1.5, AGREES), (0.5, CONTRADICTS), (2.5, AGREES)]
)
def test_a_zone_is_forbidden_if_it_is_wide(gap: float, verdict: Verdict):
    first = diagram([4.7, 5.3, 5.4], flight_time=[[4.0, np.nan], [4.25, np.nan], [4.5, 4.0]])
    second = diagram([5.0, 4.6], flight_time=[[4.25 + gap, 4.25 + gap], [4.3, 4.4]]).sortby("gamma")
    claim = ball._forbidden(first, second)
    assert claim.verdict is verdict
    assert claim.text.endswith(f"no flight in either lasts {4.25:.1f} to {4.25 + gap:.1f} rad")


def test_without_two_flights_there_is_no_zone_between_them():
    nothing, one = (diagram([5.0], flight_time=[[time]]) for time in (np.nan, 4.0))
    for first, second in ((nothing, nothing), (one, nothing)):
        claim = ball._forbidden(first, second)
        assert claim == Claim(CONTRADICTS, "nothing bounces where forbidden zones were searched for")
    two = ball._forbidden(one, diagram([5.0], flight_time=[[8.0]]))
    assert two.verdict is AGREES
    assert two.text.endswith("lasts 4.0 to 8.0 rad")


# Diagrams along Γ and Ω


def test_a_share_is_one_of_the_cells_that_bounce():
    cells = diagram(range(4), label=[CHAOTIC, QUASI_PERIODIC, Outcome.AT_REST, Outcome.MISSING])
    assert sections.chaotic(cells) == sections.share_of(cells, QUASI_PERIODIC) == 0.5
    assert sections.chaotic(cells, np.array([True, False, True, True])) == 1.0
    assert sections.chaotic(cells, np.array([False, False, True, True])) == 0.0


@pytest.mark.parametrize(
    ("longest", "verdict"),
    [
        ((3.0, 2.0, 1.0), AGREES),
        ((2.0, 2.0, 1.0), CONTRADICTS),
        ((3.0, 2.0, 2.0), CONTRADICTS),
        ((3.0, 1.0, 2.0), CONTRADICTS),
    ],
)
def test_flights_shorten_from_one_diagram_to_the_next(longest: Sequence[float], verdict: Verdict):
    rows = [diagram([2.75, 3.0, 3.25], flight_time=[[9.0], [time], [9.0]]) for time in longest]
    assert sections._shorter(rows).verdict is verdict
    omegas = [0.1, 0.13, 0.5, 1.0, 1.25]
    times = [[longest[0]], [0.5], [longest[1]], [longest[2]], [9.0]]
    claim = sections._longer_when_slow(diagram(omegas, "omega", flight_time=times), 2.0)
    assert claim.verdict is verdict
    assert ("flights are longer at low Ω" in claim.text) == (verdict is AGREES)


def test_what_is_near_a_value_includes_the_ends_of_the_range():
    cells = diagram([1.25, 1.5, 2.0, 2.5, 2.75], flight_time=[[1.0]] * 5)
    assert sections._near(cells, 2.0, 0.5).tolist() == [False, True, True, True, False]
    assert sections._longest(cells, np.zeros(5, bool)) == 0.0


@for_each(
    ("begins", "verdict"),
    [(2.25, CONTRADICTS), (2.5, AGREES), (3.0, AGREES), (3.5, AGREES), (3.75, CONTRADICTS)],
)
def test_where_chaos_begins(begins: float, verdict: Verdict):
    gamma = np.arange(1.0, 5.01, 0.0625)
    label = np.where(gamma >= begins, CHAOTIC, Outcome.PERIODIC)
    claim = sections._chaos_beyond_three(diagram(gamma, label=label))
    # Of nine cells from the one before on, eight are chaotic: nearly all.
    assert f"beyond Γ ≈ {begins - 0.0625:.1f}" in claim.text
    moved = sections._chaos_beyond_three(diagram(gamma + 0.0625, label=label))
    assert moved.verdict is verdict


def test_chaos_begins_nowhere_if_too_few_cells_follow():
    gamma = np.arange(1.0, 5.01, 0.25)
    for first, text in ((4.25, "4.2"), (4.5, "inf")):
        label = np.where(gamma >= first, CHAOTIC, Outcome.PERIODIC)
        claim = sections._chaos_beyond_three(diagram(gamma, label=label))
        assert (claim.verdict, claim.text) == (CONTRADICTS, f"(a) is chaotic beyond Γ ≈ {text}")


def test_the_range_beyond_a_cell_holds_its_last_cell():
    gamma = np.arange(1.0, 5.01, 0.25)
    label = np.where(np.isin(gamma, [3.0, 3.25]), CHAOTIC, Outcome.PERIODIC)
    claim = sections._chaos_beyond_three(diagram(gamma, label=label))
    assert (claim.verdict, claim.text) == (CONTRADICTS, "(a) is chaotic beyond Γ ≈ inf")


@pytest.mark.parametrize(
    ("chaotic", "others", "verdict"), [(1, 1, CONTRADICTS), (2, 1, AGREES), (1, 2, CONTRADICTS)]
)
def test_more_than_half_of_the_cells_are_chaotic(chaotic: int, others: int, verdict: Verdict):
    around = [*np.linspace(3.75, 4.25, chaotic + others), 4.5]  # the last is not near
    near = labelled(chaotic, others + 1, gamma=around)
    at = sections._chaos_at(near, 4.0)
    assert at.verdict is verdict
    assert f"(b) is {'chaotic' if verdict is AGREES else 'hardly chaotic'} around Γ = 4" in at.text
    assert f"{100 * chaotic / (chaotic + others):.0f} % of the cells" in at.text
    slow = labelled(chaotic, others + 1, omega=[*np.linspace(0.1, 0.3, chaotic + others), sections.LOW])
    low = sections._chaos_when_slow(slow, 2.0)
    assert low.verdict is verdict
    assert f"low Ω is {'chaotic' if verdict is AGREES else 'not chaotic'} (" in low.text


@pytest.mark.parametrize(
    ("chaotic", "of", "verdict", "cells"),
    [
        (0, 20, AGREES, "none"),
        (1, 200, AGREES, "0.5 %"),
        (1, 20, CONTRADICTS, "5.0 %"),
        (2, 2, CONTRADICTS, "100.0 %"),
    ],
)
def test_hardly_any_cell_is_chaotic(chaotic: int, of: int, verdict: Verdict, cells: str):
    claim = sections._no_chaos(labelled(chaotic, of - chaotic))
    assert claim == Claim(verdict, f"(c) is not chaotic ({cells} of its bouncing cells are)")


def repeating(
    gamma: Sequence[float], bounces: Sequence[int], hop: float, periods: Sequence[int] | None = None
) -> Claim:
    """The claim on cells with these modes, whose second flight is a hop."""
    times = [[5.0, hop] if n > 1 else [5.0, np.nan] for n in bounces]
    cells = diagram(gamma, bounces=bounces, periods=periods or [1] * len(gamma), flight_time=times)
    return sections._one_period(cells)


@for_each(
    ("stop", "hop", "verdict"),
    [
        (2.5, 0.125, CONTRADICTS),
        (2.75, 0.125, AGREES),
        (2.75, sections.HOP, CONTRADICTS),
        (2.5, sections.HOP, CONTRADICTS),
        (2.25, 0.125, CONTRADICTS),
        (2.75, 1.0, CONTRADICTS),
    ],
)
def test_one_bounce_a_period_but_for_a_hop(stop: float, hop: float, verdict: Verdict):
    claim = repeating([1.0, 1.5, 1.75, stop, 3.0, 3.25], [1, 2, 2, 1, 3, 1], hop, [1, 1, 1, 1, 1, 2])
    assert claim.verdict is verdict
    assert claim.text == (
        f"in (a) one bounce a plate period for Γ from 1.50 to {stop:.2f}, strictly (2, 1) up to 1.75: "
        f"a hop of at most {hop:.2f} rad follows it"
    )


def test_one_bounce_a_period_and_no_hop():
    claim = repeating([1.5, 2.75], [1, 1], 0.0)
    assert claim == Claim(AGREES, "in (a) one bounce a plate period for Γ from 1.50 to 2.75")
    never = repeating([0.5, 1.0, 2.0, 2.5], [1, 1, 3, 1], 0.0, [1, 1, 1, 2])
    assert never == Claim(CONTRADICTS, "(a) never repeats after one plate period")


def test_the_longest_hop_is_the_longest_second_flight():
    times = np.array([[3.0, 0.1, np.nan], [0.25, 3.0, np.nan], [3.0, 0.125, np.nan]])
    assert sections._longest_of_shorter(times) == 0.25
    assert sections._longest_of_shorter(np.empty((0, 2))) == 0.0


@pytest.mark.parametrize(
    ("chaotic", "verdict", "word"), [(1, CONTRADICTS, "not chaotic"), (2, AGREES, "chaotic")]
)
def test_cells_around_two_are_chaotic_or_not(chaotic: int, verdict: Verdict, word: str):
    label = [CHAOTIC] * chaotic + [Outcome.PERIODIC] * (3 - chaotic)
    settled = diagram([1.75, 2.0, 2.25], label=label, outcome=label, bounces=[2] * 3, periods=[1] * 3)
    settled = settled if chaotic > 1 else settled.isel(gamma=[0, 2])
    short = labelled(0, 4).assign(label=("gamma", [Outcome.PERIODIC] + [Outcome.SETTLING] * 3))
    others = [labelled(n, 10 - n) for n in range(len(sections.CONTACTS) + len(sections.ELASTIC))]
    claim = sections._no_chaos_at_two([short, settled, *others])
    assert claim.verdict is verdict
    assert claim.text.startswith(f"at Γ = 1.75 to 2.25, (b) is {word}: ")
    assert "they repeat as (2, 1). " in claim.text
    assert "still settle (75 % after" in claim.text
    for n, e in enumerate(sections.ELASTIC, start=len(sections.CONTACTS)):
        assert f"{10 * n} % with e = {e}" in claim.text


def test_common_modes_are_named_and_rare_ones_are_not():
    def commonest(cells: dict[tuple[int, int], int], outcome: int = Outcome.PERIODIC) -> str:
        pairs = [pair for pair, n in cells.items() for _ in range(n)]
        bounces, periods = zip(*pairs, strict=True)
        outcomes = [outcome] * len(pairs)
        return sections._commonest(
            diagram(range(len(pairs)), outcome=outcomes, bounces=bounces, periods=periods)
        )

    assert commonest({(1, 1): 1, (1, 2): 9, (2, 2): 10}) == "(2, 2), (1, 2)"  # one of twenty is rare
    assert commonest({(n, 1): 10 - n for n in range(1, 6)}) == "(1, 1), (2, 1), (3, 1), (4, 1)"
    assert commonest({(1, 1): 3}, Outcome.APERIODIC) == "nothing"


# Thresholds


def onsets(*excess: float) -> xarray.Dataset:
    """Thresholds so far above Eq. 25, as a share."""
    omega = np.arange(1.0, 1.0 + len(excess))
    analytic = np.full(len(excess), 0.5)
    up = analytic * (1.0 + np.array(excess))
    return xarray.Dataset({"up": ("omega", up), "analytic": ("omega", analytic)}, {"omega": omega})


@pytest.mark.parametrize(
    ("worst", "within_2", "within_3"),
    [(0.015, AGREES, AGREES), (-0.025, CONTRADICTS, AGREES), (0.5, CONTRADICTS, CONTRADICTS)],
)
def test_onsets_lie_on_eq_25_or_not(worst: float, within_2: Verdict, within_3: Verdict):
    found = onsets(0.0, worst, np.nan, 0.01)
    dampings, *_ = thresholds._dampings_caption({0.05: onsets(0.0), 0.2: found}).claims
    at_sections, *_ = thresholds._sections_caption(found).claims
    assert verdicts([dampings, at_sections, hysteresis._on_eq_25(found)]) == [within_2, within_2, within_3]
    assert f"at most {abs(100 * worst):.1f} % apart" in dampings.text


def loop(omega: Sequence[float], down: Sequence[float], up: float = 1.0) -> xarray.Dataset:
    values = {"down": ("omega", np.array(down)), "up": ("omega", np.full(len(down), up))}
    return xarray.Dataset(values, {"omega": np.array(omega, float)})


@pytest.mark.parametrize(("lowest", "verdict"), [(0.875, AGREES), (0.95, CONTRADICTS)])
def test_bouncing_goes_on_far_below_the_threshold_or_not(lowest: float, verdict: Verdict):
    claim = hysteresis._lower(loop([0.5, 0.6, 0.7, 0.8], [1.0, lowest, 0.99, np.nan]))
    expected = f"bouncing goes on below it, most at Ω = 0.60: down to Γ = {lowest:.3f} instead of 1.000"
    assert claim == Claim(verdict, expected)


@pytest.mark.parametrize(
    ("down", "verdict", "text"),
    [
        ([0.9, 0.5, 0.9, 0.6, 0.9], AGREES, "2 minima: Ω = 1.00, 3.00"),
        ([0.9, 0.5, 0.9, 0.91, 0.92], CONTRADICTS, "1 minima: Ω = 1.00"),
    ],
)
def test_several_minima_are_more_than_one(down: Sequence[float], verdict: Verdict, text: str):
    assert hysteresis._several(loop(range(5), down)) == Claim(verdict, f"decreased, it has {text}")


def test_a_minimum_of_just_the_depth_counts():
    assert hysteresis.minima(np.array([1.5, 1.0, 1.5]), 0.5) == [1]
    assert hysteresis.minima(np.array([1.5, 1.0, 1.375]), 0.5) == []


def test_thresholds_that_moved_are_counted_below_and_above_a_frequency():
    omega = [0.25, 0.4, 0.5, 0.6, 0.7]
    before = loop(omega, [1.0, 1.0, 1.0, 1.0, np.nan])
    # Three steps of 0.25 are not more than three.
    after = loop(omega, [1.75, 2.0, 0.0, 1.0, 9.0])
    text = hysteresis._coexist(before, after, 0.25).text
    assert "1 of 2 thresholds below Ω = 0.5 and 1 of 2 from 0.5 to 0.8 are others" in text


def test_the_step_of_a_ramp():
    assert hysteresis.gamma_step({"gamma": {"start": 0.5, "stop": 2.0, "num": 7}}) == 0.25
