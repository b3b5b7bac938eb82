"""Nothing bounces for ever below a threshold that is decided: 80 starts at each of 34 Gammas."""

import math

from benchmarks.threshold_search import searched
from kernel.branches.thresholds import NOT_SEARCHED, SEARCHED_XI

OMEGA = (0.05, 10.0)


def test_nothing_is_decided_where_the_rule_was_not_searched():
    springs = list(searched(1, 40, OMEGA, (0.01, 0.03)))
    assert {spring.answer.cause for spring in springs} == {NOT_SEARCHED}
    assert all(math.isnan(spring.answer.down) for spring in springs)


def test_nothing_bounces_below_what_is_decided():
    springs = list(searched(1, 40, OMEGA, (SEARCHED_XI, 0.3)))
    decided = [spring for spring in springs if math.isfinite(spring.answer.down)]
    assert len(decided) >= 30
    assert [(s.rule.omega, s.rule.xi, s.found) for s in decided if s.found is not None] == []
