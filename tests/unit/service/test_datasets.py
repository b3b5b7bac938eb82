"""Answers as Datasets: what is missing, unfinished or empty, on answers made for it."""

from typing import Any

import pytest

from service.client import UnexpectedAnswer
from service.client.datasets import words_dataset

JOB = "0" * 32


BRANCH: dict[str, Any] = {
    "bounces": 1, "periods": 1, "word": "s", "gamma": [1.0, 2.0], "flight_time": [[4.0], [5.0]],
    "takeoff_phase": [[0.5], [0.25]], "impact_velocity": [[-1.0], [-2.0]],
    "multipliers": [[[0.5, 0.25], [0.5, -0.25]], [[2.0, 0.0], [0.125, 0.0]]], "stable": [True, False],
    "admissible": [0, 4],
}  # fmt: skip
SHORT = BRANCH | {
    "gamma": [3.0], "flight_time": [[6.0]], "takeoff_phase": [[0.0]], "impact_velocity": [[-3.0]],
    "multipliers": [], "stable": [True], "admissible": [1],
}  # fmt: skip
WORDS: dict[str, Any] = {
    "omega": 0.5, "xi": 0.05, "direction": "up", "branches": [BRANCH, SHORT], "events": [], "skipped": [],
    "complete": True,
}  # fmt: skip


def test_a_short_answer_that_asks_for_much_memory_is_refused():
    huge = BRANCH | {"bounces": 10**10}
    uneven = BRANCH | {"gamma": [1.0] * 11_000}
    for read in (
        lambda: words_dataset(WORDS | {"branches": [huge]}, JOB),
        lambda: words_dataset(WORDS | {"branches": [uneven] + [SHORT] * 11_000}, JOB),
    ):
        with pytest.raises(UnexpectedAnswer, match="values; at most 100,000,000 are read"):
            read()
