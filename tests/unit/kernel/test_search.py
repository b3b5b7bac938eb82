"""Searches for the lowest end of bouncing, where no list of short cycles decides it."""

import math

import pytest
from contacts import rigid

from kernel.search import Searched, search

#: Omega, xi, where bouncing ends as an independent search crept down to it, and what ends there.
KNOWN = [
    (0.52, 0.02, 0.7925441522, "fold of word sssz (4,3)"),
    (0.5155, 0.02, 0.7809716836, "fold of word sssz (4,3)"),
    (0.5395, 0.032, 0.8051293821, "fold of word ss (2,2)"),  # below the fold of (1,1) and Eq. 25
]


@pytest.mark.parametrize(("omega", "xi", "gamma", "what"), KNOWN)
def test_cycles_below_the_rule_are_found_and_followed_to_their_ends(omega, xi, gamma, what):
    result = search(rigid(0.0), omega, xi)
    assert result.gamma == pytest.approx(gamma, abs=1e-9)
    assert result.what == what


def test_nothing_is_found_where_nothing_bounces_below_rest():
    result = search(rigid(0.0), 0.5, 0.26, starts=40, gammas=6)
    assert math.isnan(result.gamma)


def test_more_starts_miss_smaller_basins():
    assert Searched(0.5, "", 80).missed == pytest.approx(0.037, abs=5e-4)
    assert Searched(0.5, "", 400).missed < 0.008
