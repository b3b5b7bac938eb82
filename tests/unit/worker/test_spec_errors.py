"""How a problem is told: the field, the wrong value, and what is close to it."""

import pickle
from typing import Any

import pytest
from tables import for_each

from worker.spec import SweepSpec
from worker.spec.errors import BrokenRuleError, Problem, SpecInvalid, SpecTooLarge, describe

POINT = {"gamma": 2.0, "omega": 0.5, "xi": 0.26}


def problems(**fields: Any) -> list[Problem]:
    with pytest.raises(SpecInvalid) as caught:
        SweepSpec.parse(POINT | fields)
    return list(caught.value.problems)


@for_each(
    ("value", "described"),
    [
        (None, "null"),
        (False, "false"),
        (2**128, "a whole number of about 39 digits"),
        (0.5, "0.5"),
        ("x" * 39, f"text '{'x' * 36}..."),
        ("ä\n", r"text '\xe4\n'"),
        ({}, "an object"),
        ((1, 2), "a list of 2"),
        (type("T" * 30, (), {})(), f"a value of type {'T' * 21}..."),
    ],
)
def test_a_value_is_described_shortly(value: object, described: str):
    assert describe(value) == described


@pytest.mark.parametrize(
    ("name", "path"), [("g" * 40, "g" * 40), ("g" * 41, f"'{'g' * 36}..."), ("a b", "'a b'"), ("ä", "ä")]
)
def test_the_name_of_an_unknown_field_is_told_shortly(name: str, path: str):
    assert [problem.field for problem in problems(**{name: 1})] == [path]
    assert [problem.field for problem in problems(model={name: 1})] == [f"model.{path}"]


def test_twenty_problems_are_listed_and_of_further_ones_their_number():
    twenty = problems(gamma=["x"] * 20)
    assert [problem.field for problem in twenty] == [f"gamma[{n}]" for n in range(20)]
    assert problems(gamma=["x"] * 21) == [*twenty, Problem("", "and 1 more problems")]


def test_errors_keep_their_problems():
    given = [Problem("keep", "must be less"), Problem("", "is wrong")]
    for error in (SpecInvalid(iter(given)), SpecTooLarge(given)):
        copy = pickle.loads(pickle.dumps(error))
        assert copy.problems == error.problems == tuple(given)
        assert str(copy) == str(error) == "keep: must be less\nis wrong"
        assert error.args == (tuple(given),)
    assert str(BrokenRuleError("num", "must be less")) == "must be less"
