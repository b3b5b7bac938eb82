"""Balls: what they claim holds for every number in them."""

import threading
from fractions import Fraction

import pytest

pytest.importorskip("flint", reason="needs the extra proofs")

from flint import arb, arb_mat, ctx

from kernel.proofs.balls import (
    PRECISIONS,
    Condition,
    DisprovenError,
    NotProvenError,
    bounds,
    check_positive,
    contracts,
    with_enough_bits,
)

#: x'' = -x as (x, x'), from (0, 1): the sine.
CIRCLE, START = arb_mat([[0, 1], [-1, 0]]), arb_mat([[0], [1]])


def sine(zero, ends):
    return Condition(arb_mat([[1, 0]]), zero, ends)


def test_bounds_are_rounded_outward():
    for third in (with_enough_bits(lambda: arb(1) / 3), arb(1) / 3):
        low, high = map(Fraction, bounds(third, 12))
        assert low < Fraction(1, 3) < high
        assert high - low < Fraction(2, 10**12)
    assert bounds(arb(0.5)) == ("0.5", "0.5")


@pytest.mark.parametrize("stiff", [False, True])
def test_what_is_positive_over_a_whole_phase_is_proven(stiff):
    """sin x on (0, pi) is zero at both ends, and positive between."""
    with_enough_bits(lambda: check_positive(CIRCLE, [sine(1, True)], START, arb.pi(), stiff=stiff))


@pytest.mark.parametrize("stiff", [False, True])
def test_what_is_negative_somewhere_is_disproven(stiff):
    with pytest.raises(DisprovenError):
        with_enough_bits(lambda: check_positive(CIRCLE, [sine(1, False)], START, arb(4), stiff=stiff))


def test_one_of_several_conditions_may_hold_where_another_does_not():
    """On (0, 4) sin x is negative at last, and -cos x at first."""
    conditions = [sine(1, False), Condition(arb_mat([[0, -1]]), 0, False)]
    with_enough_bits(lambda: check_positive(CIRCLE, conditions, START, arb(4)))


def test_a_matrix_contracts_if_a_power_does():
    assert with_enough_bits(lambda: contracts(arb_mat([[0.9, 1000], [0, 0.9]])))
    assert not with_enough_bits(lambda: contracts(arb_mat([[1.0000001, 0], [0, 0.5]])))


def test_threads_prove_one_after_another_and_leave_the_precision_as_it_was():
    """FLINT has one precision for all of them."""
    before, seen = ctx.prec, []

    def hesitant():
        seen.append(ctx.prec)
        raise NotProvenError

    def prove():
        with pytest.raises(NotProvenError):
            with_enough_bits(hesitant)

    threads = [threading.Thread(target=prove) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(seen) == sorted(8 * PRECISIONS)
    assert ctx.prec == before
