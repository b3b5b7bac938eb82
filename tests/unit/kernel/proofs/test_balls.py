"""Balls: what they claim holds for every number in them."""

import threading
from fractions import Fraction

import pytest

pytest.importorskip("flint", reason="needs the extra proofs")

from flint import arb, arb_mat, ctx

from kernel.proofs.balls import PRECISIONS, NotProvenError, bounds, check_positive, exact, first_proven

#: x'' = -x as (x, x'), from (0, 1): the sine.
CIRCLE, START = arb_mat([[0, 1], [-1, 0]]), arb_mat([[0], [1]])


def sine(zero, ends):
    return arb_mat([[1, 0]]), zero, ends


def positive(conditions, end):
    first_proven(lambda: check_positive(CIRCLE, conditions, START, arb(end), "it"))


def test_bounds_are_rounded_outward():
    for third in (first_proven(lambda: arb(1) / 3), arb(1) / 3):
        low, high = map(Fraction, bounds(third, 12))
        assert low < Fraction(1, 3) < high
        assert high - low < Fraction(2, 10**12)
    assert bounds(arb(0.5)) == ("0.5", "0.5")


def test_what_is_positive_over_a_whole_phase_is_proven():
    """sin x on (0, pi) is zero at both ends, and positive between."""
    positive([sine(1, True)], arb.pi())


def test_what_is_negative_somewhere_is_disproven():
    with pytest.raises(NotProvenError, match="it breaks off after") as why:
        positive([sine(1, False)], 4)
    assert why.value.verdict == "disproven"


def test_one_of_several_conditions_may_hold_where_another_does_not():
    """On (0, 4) sin x is negative at last, and -cos x at first."""
    positive([sine(1, False), (arb_mat([[0, -1]]), 0, False)], 4)


def test_a_double_is_its_shortest_decimal():
    assert first_proven(lambda: (exact(0.1) + exact(0.2) - exact(0.3)).contains(0))


def test_threads_prove_one_after_another_and_leave_the_precision_as_it_was():
    """FLINT has one precision for all of them."""
    before, seen = ctx.prec, []

    def hesitant():
        seen.append(ctx.prec)
        raise NotProvenError("it")

    def prove():
        with pytest.raises(NotProvenError):
            first_proven(hesitant)

    threads = [threading.Thread(target=prove) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(seen) == sorted(8 * PRECISIONS)
    assert ctx.prec == before


def test_more_bits_are_tried_only_where_nothing_is_decided():
    seen = []

    def fails(verdict):
        seen.append((verdict, ctx.prec))
        raise NotProvenError("it", verdict)

    with pytest.raises(NotProvenError):
        first_proven(lambda: fails("disproven"), lambda: fails("not proven"))
    assert seen == [("disproven", PRECISIONS[0]), *(("not proven", bits) for bits in PRECISIONS)]
