"""Nothing bounces below a threshold that is decided: the rows of 40 springs of docs/hysteresis.md."""

import math

from paths import ROOT

from benchmarks.threshold_search import Searched, searched
from kernel.cycles.thresholds import NOT_SEARCHED, SEARCHED_XI

TEXT = (ROOT / "docs" / "hysteresis.md").read_text()
OMEGA = (0.05, 10.0)


def row(springs: list[Searched], xi: tuple[float, float]) -> str:
    """A row of its table, "How far the rule was searched"."""
    answered = sum(math.isfinite(spring.rule.down) for spring in springs)
    below = sum(spring.found is not None for spring in springs)
    return f"| {xi[0]:g} to {xi[1]:g} | 0.05 to 10 | 80 × 34 | {len(springs)} | {answered} | {below} |"


def test_nothing_is_decided_where_the_rule_was_not_searched():
    springs = list(searched(1, 40, OMEGA, (0.01, 0.03)))
    assert {spring.answer.cause for spring in springs} == {NOT_SEARCHED}
    assert all(math.isnan(spring.answer.down) for spring in springs)
    assert row(springs, (0.01, 0.03)) in TEXT


def test_nothing_bounces_below_what_is_decided():
    springs = list(searched(1, 40, OMEGA, (SEARCHED_XI, 0.3)))
    decided = [spring for spring in springs if math.isfinite(spring.answer.down)]
    assert len(decided) == 40
    assert [(s.rule.omega, s.rule.xi, s.found) for s in decided if s.found is not None] == []
    assert row(springs, (SEARCHED_XI, 0.3)) in TEXT
