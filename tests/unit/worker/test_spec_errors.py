"""How a problem is told: the field, the wrong value, and what is close to it."""

import pickle
from typing import Any

import pytest
from tables import for_each

from worker.spec import SweepSpec
from worker.spec.errors import (
    BrokenRuleError,
    Problem,
    SpecInvalid,
    SpecTooLarge,
    describe,
    did_you_mean,
    one_of,
)

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
        (2**128 - 1, str(2**128 - 1)),
        (2**128, "a whole number of about 39 digits"),
        (-(2**200), "a whole number of about 61 digits"),
        (0.5, "0.5"),
        ("x" * 38, f"text '{'x' * 38}'"),
        ("x" * 39, f"text '{'x' * 36}..."),
        ("ä\n", r"text '\xe4\n'"),
        ({}, "an object"),
        ((1, 2), "a list of 2"),
        (type("T" * 30, (), {})(), f"a value of type {'T' * 21}..."),
    ],
)
def test_a_value_is_described_shortly(value: object, described: str):
    assert describe(value) == described


def test_names_are_listed_and_the_closest_is_proposed():
    assert one_of(["a"]) == "'a'"
    assert one_of(["a", "b"]) == "'a' or 'b'"
    assert one_of(iter("abc")) == "'a', 'b' or 'c'"
    names = ("gamma", "omega")
    assert did_you_mean("GAMA", names) == "; did you mean 'gamma'?"
    assert did_you_mean("xi", names) == ""
    assert did_you_mean(None, names) == ""


def test_the_second_choice_is_proposed_too():
    [problem] = problems(gamma={"start": 1, "stop": 2, "num": 3, "spacing": "logg"})
    assert problem.rule == "must be 'linear' or 'log', not text 'logg'; did you mean 'log'?"


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


@for_each(
    ("field", "value", "rule"),
    [
        ("keep", 0, "must be at least 1, not 0"),
        ("keep", 10_001, "must be at most 10000, not 10001"),
        ("name", "x" * 201, "must have at most 200 characters, not 201"),
        ("parent", "G" * 32, "must match ^[0-9a-f]{32}$, not text 'GGGG"),
        ("settle_early", 1, "must be true or false, not 1"),
    ],
)
def test_a_bound_is_told_with_the_value(field: str, value: object, rule: str):
    [problem] = problems(**{field: value})
    assert problem.field == field
    assert problem.rule.startswith(rule)


@pytest.mark.parametrize(
    ("model", "rule"),
    [
        ({"rest_length": 0}, "must be above 0, not 0"),
        ({"kind": "ball", "restitution": 1}, "must be below 1, not 1"),
    ],
)
def test_a_bound_that_is_excluded_is_told_as_such(model: dict[str, Any], rule: str):
    assert [problem.rule for problem in problems(model=model)] == [rule]
