"""Bounds of a share hold the truth as often as they say, in samples of every population."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from worker.analysis.intervals import bounds, covered, percent


@settings(max_examples=15)
@given(st.integers(60, 100_000), st.floats(0, 1), st.integers(20, 200))
def test_an_interval_holds_the_truth_with_94_percent_whatever_it_is(population, share, sampled):
    """Summed over all samples, by SciPy's hypergeometric distribution."""
    sampled = min(sampled, population)
    having = round(share * population)
    drawn = stats.hypergeom(population, having, sampled)
    held = 0.0
    for number in range(sampled + 1):
        low, high = bounds(number, number, sampled, population)
        held += drawn.pmf(number) * (low <= having / population <= high)
    assert held >= 0.94


def test_none_of_a_sample_is_the_rule_of_three():
    assert bounds(0, 0, 200, 10**8) == (0.0, pytest.approx(1.0 - 0.05 ** (1 / 200), rel=1e-5))
    assert covered(200, 10**8) == pytest.approx(0.05 ** (1 / 200), rel=1e-6)


def test_a_whole_population_leaves_nothing_open():
    assert bounds(3, 3, 50, 50) == (3 / 50, 3 / 50)
    assert bounds(0, 0, 0, 0) == (0.0, 0.0)


def test_undecided_members_widen_the_interval_on_both_sides():
    low, high = bounds(2, 5, 100, 10**6)
    assert low == bounds(2, 2, 100, 10**6)[0]
    assert high == bounds(5, 5, 100, 10**6)[1]


@pytest.mark.parametrize(
    ("share", "low", "high"),
    [(0.0474, "4.7", "4.8"), (0.07, "7", "7"), (0.0, "0", "0"), (0.9996, "99.9", "100"), (1.0, "100", "100")],
)
def test_bounds_in_words_remain_bounds(share, low, high):
    assert (percent(share, upper=False), percent(share, upper=True)) == (low, high)
