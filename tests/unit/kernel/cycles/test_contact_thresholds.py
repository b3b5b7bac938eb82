"""Thresholds of any contact against folds known by other means, and against the rule in closed form."""

import math

import pytest
from contacts import rigid, soft

from kernel.cycles.contact_thresholds import rest_ends, thresholds_of
from kernel.cycles.thresholds import EQ_25, NOT_SEARCHED, UNRESOLVED, thresholds
from kernel.threshold import threshold

#: Contact, Omega, xi, Gamma_down, where flights leap; as in `test_follow`.
TABLE = [
    (soft(), 0.60, 0.05, 0.553241345562, 0.915986309968),
    (soft(adhesive=False), 0.60, 0.05, 0.553238870182, 0.915985867041),
    (soft(0.1), 0.62, 0.05, 0.507537651106, 0.871812163311),  # a graze on the way, where a flight vanishes
    (rigid(0.5), 0.66, 0.05, 0.695395334976, 0.805215730572),
    (rigid(0.9), 0.60, 0.05, 0.393179810088, math.nan),  # of three hops, never stuck
    (rigid(0.875), 0.62, 0.05, 0.447349850115, math.nan),  # stable up to a flip, Gamma = 0.44751
    # the branch comes from beyond Eq. 25, and once goes there again
    (rigid(0.7), 2.20, 0.05, 1.755795045174, math.nan),
    (rigid(0.8), 2.2, 0.05, 1.3451293388224, math.nan),
]


@pytest.mark.parametrize(("plate", "omega", "xi", "down", "jump"), TABLE)
def test_bouncing_ends_at_the_lowest_fold(plate, omega, xi, down, jump):
    answer = thresholds_of(plate, omega, xi)
    assert answer.cause.startswith("fold")
    assert answer.down == pytest.approx(down, abs=1e-9)
    assert answer.fold.gamma == answer.down
    assert answer.jump == pytest.approx(jump, abs=1e-9, nan_ok=True)


def test_a_fold_is_of_its_shortest_cycle():
    """A branch of twice the period leads back to that of the period, and to its folds."""
    assert thresholds_of(rigid(0.86), 0.62, 0.05).cause == "fold (4,1)"


def test_a_fold_with_a_pair_of_multipliers_outside_the_unit_circle_decides_nothing():
    """At 0.356141 they are 1.1396 +- 0.1884i: the modulus is 1.16."""
    answer = thresholds_of(soft(0.894, 1.54e-3), 0.896, 0.0489)
    assert answer.cause == UNRESOLVED
    said, gamma = answer.reason.split(" is unstable on both sides")[0].rsplit(" at Gamma = ", 1)
    assert said.endswith("the fold of (5,1)")
    assert float(gamma) == pytest.approx(0.356141, abs=1e-6)


def test_bouncing_ends_with_rest_where_no_fold_is_below():
    answer = thresholds_of(soft(), 0.5, 0.26)
    assert answer.cause == "rest"
    assert answer.down == answer.gamma_th == rest_ends(soft(), 0.5, 0.26)


@pytest.mark.parametrize("omega", [0.35, 0.4, 0.46, 0.47, 0.6, 0.75, 1.26, 1.28])
def test_an_ideal_plate_has_the_thresholds_of_the_closed_form(omega):
    known, answer = thresholds(omega, 0.05), thresholds_of(rigid(0.0), omega, 0.05)
    assert answer.cause == known.cause.replace(EQ_25, "rest")
    assert answer.down == pytest.approx(known.down, abs=1e-12, nan_ok=True)
    assert (answer.reason != "") == (known.cause == UNRESOLVED)


def test_rest_on_an_ideal_plate_ends_at_eq_25():
    """On a soft one where its static depth is driven to zero: for depths that vanish, the same."""
    expected = threshold(0.6, 0.05)
    assert rest_ends(rigid(0.4), 0.6, 0.05) == pytest.approx(expected, rel=1e-13)
    assert rest_ends(soft(penetration=1e-5), 0.6, 0.05) == pytest.approx(expected, rel=1e-8)
    assert rest_ends(soft(penetration=0.1), 0.6, 0.05) != pytest.approx(expected, rel=1e-3)


def test_a_threshold_names_branches_that_were_cut_off():
    answer = thresholds_of(rigid(0.7), 0.9, 0.06)
    assert answer.down == answer.gamma_th
    assert answer.reason.startswith("branches were cut off at Gamma = 0.6")


def test_a_damping_that_was_not_searched_decides_nothing():
    answer = thresholds_of(soft(), 0.6, 0.03)
    assert (answer.cause, answer.fold) == (NOT_SEARCHED, None)
