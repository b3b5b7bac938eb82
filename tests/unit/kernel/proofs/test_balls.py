"""Balls: what they claim holds for every number in them."""

from fractions import Fraction

import pytest

pytest.importorskip("flint", reason="needs the extra proofs")

from flint import arb

from kernel.proofs.balls import (
    Condition,
    DisprovenError,
    bounds,
    check_positive,
    column,
    contracts,
    exact,
    matrix,
    precision,
)

#: x'' = -x as (x, x').
CIRCLE = [[0, 1], [-1, 0]]


def test_bounds_are_rounded_outward():
    with precision(192):
        third = exact("1/3")
        low, high = bounds(third, 18)
    assert Fraction(low) < Fraction(1, 3) < Fraction(high)
    assert Fraction(high) - Fraction(low) < Fraction(2, 10**18)
    assert bounds(arb(0.5), 5) == ("0.5", "0.5")


def test_a_decimal_is_that_decimal_and_a_float_its_bits():
    with precision(192):
        assert exact("0.6") - exact(0.6) != 0
        assert abs(exact("0.6") - exact(0.6)) < 1e-16


@pytest.mark.parametrize("stiff", [False, True])
def test_what_is_positive_over_a_whole_phase_is_proven(stiff):
    """sin x on (0, pi) is zero at both ends, and positive between."""
    with precision(192):
        a, start, sine = matrix(CIRCLE), column([0, 1]), Condition(matrix([[1, 0]]), 1, True)
        check_positive(a, [sine], start, arb.pi(), stiff=stiff)


def test_what_is_negative_somewhere_is_disproven():
    with precision(192):
        a, start, sine = matrix(CIRCLE), column([0, 1]), Condition(matrix([[1, 0]]), 1, False)
        with pytest.raises(DisprovenError):
            check_positive(a, [sine], start, arb(4))


def test_one_of_several_conditions_may_hold_where_another_does_not():
    """On (0, 4) sin x is negative at last, and -cos x at first."""
    with precision(192):
        rows = [Condition(matrix([[1, 0]]), 1, False), Condition(matrix([[0, -1]]), 0, False)]
        check_positive(matrix(CIRCLE), rows, column([0, 1]), arb(4))


def test_a_matrix_contracts_if_a_power_does():
    with precision(192):
        assert contracts(matrix([[0.9, 1000], [0, 0.9]]))
        assert not contracts(matrix([[1.0000001, 0], [0, 0.5]]))
