"""Which model `auto` takes, why, and how far two models are said to be apart."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_runs import Model, run

from kernel.params import Line
from worker.analysis.deviation import FEWEST, deviations
from worker.analysis.model_selection import CELLS, ModelChoice, choose, sample
from worker.sweep import SweepSpec
from worker.sweep.task import run_cells

RANGE = {"start": 1.0, "stop": 6.0, "num": 101}
STIFF = {"restitution": 0.0, "penetration": 1e-6}


def sweep(tolerance: float = 1e-2, **given) -> SweepSpec:
    model = {"kind": "auto", "tolerance": tolerance, **given.pop("model", {})}
    return SweepSpec(**({"gamma": RANGE, "omega": 0.5, "xi": 0.26} | given), model=model)


def percentiles(choice: ModelChoice) -> dict[str, float | None]:
    return {row.model: row.percentile_95 for row in choice.table}


def test_the_bound_of_a_choice_is_of_all_cells_of_the_sweep():
    """0 of 120 cells leave up to 3 % of a plane, whatever the true share is (1 - 0.025**(1/120))."""
    choice = choose(sweep(1e-4, model=STIFF, omega={"start": 0.4, "stop": 0.9, "num": 50}))
    rigid, ball = choice.table[1], choice.table[0]
    assert (choice.model, rigid.drawn, rigid.beyond) == ("rigid", CELLS, 0)
    assert rigid.most == pytest.approx(1.0 - 0.025 ** (1 / CELLS), rel=0.05)
    assert ball.most > 0.05


def test_what_only_the_exact_contact_tells_takes_the_exact_contact():
    """Its small hops after a landing are longer than the tolerance."""
    choice = choose(sweep(1e-4, model={"restitution": 0.1, "penetration": 1e-2}))
    assert choice.model == "soft"
    assert percentiles(choice)["rigid"] > 1e-4


def test_a_ball_that_bounces_where_the_spring_rests_has_no_bound():
    """Omega = 1.4, xi = 0.05: the spring's threshold is above 5, the ball's is 1."""
    choice = choose(sweep(1.0, omega=1.4, xi=0.05, gamma={"start": 2.0, "stop": 4.0, "num": 30}))
    assert percentiles(choice)["ball"] is None
    assert choice.model == "rigid"
    assert "ball unbounded" in choice.reason
    window = {"settle": 0, "observe": 1, "micro_flight": 5e-324}  # too short for modes
    assert choose(sweep(1e-9, omega=0.5, xi=0.05, gamma=[0.9, 1.2, 2.5], **window)).model == "rigid"


def test_cells_whose_flights_all_are_small_are_compared_by_these():
    """Just above the threshold, and on all of Fig. 2 if flights up to 7 rad are small."""
    above = 0.869609004563236
    onset = choose(sweep(1e-3, gamma=[above, above + 1e-5]))
    assert onset.model == "rigid"
    assert 0.0 < percentiles(onset)["rigid"] < 1e-3
    assert percentiles(onset)["ball"] is None
    large = choose(sweep(1e-2, micro_flight=7.0))
    assert percentiles(large)["soft"] == 0.0 < percentiles(large)["rigid"]


def test_ramps_are_compared_along_their_own_lines():
    ramp = {"kind": "ramp", "axis": "gamma", "direction": "both"}
    spec = sweep(
        1e-2, model=STIFF, gamma={"start": 0.5, "stop": 3.0, "num": 40}, omega=[0.5, 0.9], protocol=ramp
    )
    choice = choose(spec)
    assert choice.model == "rigid"
    assert choice.table[0].cells == 2 * 2 * 12


def test_cells_that_still_settle_are_compared_by_their_flights():
    """Both models have them: they are neither left out nor taken for failures."""
    slow = {"gamma": [3.667, 3.7], "omega": 1.288, "xi": 0.352, "settle": 200, "observe": 100}
    choice = choose(sweep(0.01, **slow, model={"restitution": 0.0, "penetration": 1e-6}))
    assert choice.table[-1].cells == 2
    assert choice.model == "rigid"


def test_a_choice_judges_cells_as_the_sweep_will_have_them():
    """Six of these 60 springs settle after the window, and repeat in the sweep."""
    axes = {"gamma": np.linspace(0.8, 3.0, 10).tolist(), "omega": np.linspace(0.8, 1.3, 6).tolist()}
    spec = sweep(1e-3, **axes, xi=0.01, model={"restitution": 0.01, "penetration": 1e-5})
    (line,) = sample(spec)
    stored = run_cells(spec.model_copy(update={"model": spec.model.exact}), line, None)
    assert choose(spec).table[-1].repeating == np.count_nonzero(np.isin(stored.outcome, (1, 3)))


@settings(max_examples=30)
@given(st.integers(1, 300), st.integers(1, 60), st.integers(1, 60))
def test_a_sample_has_distinct_cells_of_the_sweep(gamma, omega, xi):
    lengths = {"gamma": gamma, "omega": omega, "xi": xi}
    axes = {name: (np.arange(n) + 1.0).tolist() for name, n in lengths.items()}
    (line,) = sample(sweep(**axes))
    cells = {*zip(line.gamma, line.omega, line.xi, strict=True)}
    assert len(line.gamma) == len(cells) == min(CELLS, gamma * omega * xi)
    for name, values in axes.items():
        assert np.all(np.isin(getattr(line, name), values))


def cell(gamma: float, model: Model = Model.RIGID, *, settle: int = 300, observe: int = 100, **given) -> Line:
    return run(gamma, 0.5, 0.26, model, settle=settle, observe=observe, keep=512, **given)


def between(one: Line, two: Line, micro_flight: float = 0.0) -> float:
    (found,) = deviations(one, two, micro_flight)
    return float(found)


def test_cycles_are_compared_flight_by_flight_wherever_they_begin():
    one, two = cell(2.3), cell(2.3, settle=301)
    assert one.bounces[0] == 2
    assert between(one, two) < 1e-9
    soft = cell(2.3, Model.SOFT, penetration=1e-3)
    assert 1e-4 < between(one, soft) < 5e-3


def test_a_hop_that_only_one_model_has_counts_whole():
    hopping, plain = cell(1.5, Model.SOFT, restitution=0.1), cell(1.5)
    hops = np.sort(hopping.flight_time[0, : hopping.bounces[0]])
    assert len(hops) == 3
    assert between(plain, hopping) == pytest.approx(hops[-2], abs=1e-12)
    without = cell(1.5, Model.SOFT, restitution=0.1, micro_flight=0.2)
    assert between(plain, without, 0.2) < 5e-3


def test_a_window_of_chaos_is_seldom_told_from_the_next():
    gamma = np.linspace(4.6, 6.0, 100)
    one, two, ball = (
        run(gamma, 0.5, 0.26, model, settle=settle, observe=100, keep=512, restitution=e)
        for model, settle, e in ((Model.RIGID, 300, 0.0), (Model.RIGID, 400, 0.0), (Model.BALL, 300, 0.25))
    )
    aperiodic = one.outcome == 2
    assert np.mean(deviations(one, two, 0.0)[aperiodic] > 0.05) < 0.12
    assert np.mean(deviations(one, ball, 0.0)[aperiodic] > 0.05) > 0.85


def test_a_window_of_few_flights_tells_no_distribution():
    """Not even from that of the same motion a rounding apart."""
    gamma = np.linspace(150.0, 200.0, 30)
    one, two = (run(x, 0.5, 0.26, Model.RIGID, settle=300, observe=100) for x in (gamma, gamma * (1 + 1e-12)))
    assert np.all(one.outcome == 2)
    assert np.all(two.flights < FEWEST)
    assert np.all(deviations(one, two, 0.0) == 0.0)
    assert np.all(np.isnan(deviations(one, two, 0.0, FEWEST)))
    cycle = one._replace(periods=np.ones_like(one.periods), bounces=np.ones_like(one.bounces))
    assert np.mean(deviations(cycle, two, 0.0) > 0.05) > 0.85  # of a cycle the flights are known


def test_cells_without_an_answer_are_not_compared_and_do_not_pass():
    good = cell(1.5)
    bad = good._replace(outcome=np.array([4], dtype=np.uint8))
    assert math.isnan(between(bad, good))
    assert between(good, bad) == math.inf
