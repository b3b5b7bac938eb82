"""Folds, flips and upper bounds of Gamma_down on an ideal plate, against the closed form in doubles."""

import numpy as np
import pytest

pytest.importorskip("flint", reason="needs the extra proofs")

from kernel.branches.events import Kind, branch_and_events
from kernel.branches.thresholds import thresholds
from kernel.proofs.balls import NotProvenError, bounds
from kernel.proofs.branches import FLIPS, FOLDS, ProvenBranch
from kernel.proofs.thresholds import prove_down

#: Omega at xi = 0.05, and Gamma at the lowest fold of (1,1) to 18 digits.
LOWEST = {
    "0.56": "0.740719879353054267",
    "0.60": "0.553244593224092931",
    "0.62": "0.507033468652833283",
    "0.66": "0.596879494373674877",
    "0.70": "0.669279136329714241",
}


def random_springs(n):
    random = np.random.default_rng(11)
    for _ in range(n):
        yield (
            round(random.uniform(0.26, 1.3), 4),
            round(random.uniform(0.04, 0.3), 4),
            int(random.choice([1, 2])),
        )


@pytest.mark.parametrize("omega", LOWEST)
def test_bouncing_persists_just_above_the_fold(omega):
    _, events = branch_and_events(float(omega), 0.05, 1)
    fold = events.flight_time[events.kind == Kind.FOLD][np.argmin(events.gamma[events.kind == Kind.FOLD])]
    down = ProvenBranch(omega, "0.05").down(float(fold))
    low, high = bounds(down.above, 18)
    assert low <= LOWEST[omega] <= high
    assert down.below > down.above


def test_folds_and_flips_of_the_closed_form_are_proven_where_it_says():
    for omega, xi, periods in random_springs(12):
        _, events = branch_and_events(omega, xi, periods)
        branch = ProvenBranch(repr(omega), repr(xi), periods)
        for kind, prove in ((Kind.FOLD, branch.fold), (Kind.FLIP, branch.flip)):
            for i in np.flatnonzero((events.kind == kind) & (events.gamma < 20.0))[:2]:
                event = prove(float(events.flight_time[i]))
                assert abs(float(event.flight_time) - events.flight_time[i]) < 1e-13
                assert abs(float(event.gamma) / events.gamma[i] - 1.0) < 1e-13


def test_the_closed_form_misses_no_fold_and_no_flip():
    for omega, xi, _ in random_springs(3):
        _, events = branch_and_events(omega, xi, 1)
        branch = ProvenBranch(repr(omega), repr(xi))
        for which, kind in ((FOLDS, Kind.FOLD), (FLIPS, Kind.FLIP)):
            times = sorted(events.flight_time[events.kind == kind])
            stretches = sorted(branch.events(which), key=float)
            assert len(stretches) == len(times)
            assert all(ball.contains(time) for ball, time in zip(stretches, times, strict=True))


def test_answers_of_the_rule_are_proven_as_upper_bounds():
    """Also of a word, zs at Omega = 1.26."""
    for omega, xi in ((0.6, 0.05), (1.26, 0.05), (0.4, 0.06), (0.65, 0.06)):
        answer = thresholds(omega, xi)
        assert answer.fold is not None
        proof = prove_down(repr(omega), repr(xi), answer.fold)
        assert -1e-14 < float(proof.at_most) - answer.down < 2e-9


def test_no_flight_time_beside_a_fold_is_proven_to_be_one():
    branch = ProvenBranch("0.6", "0.05")
    with pytest.raises(NotProvenError):
        branch.fold(3.0)
