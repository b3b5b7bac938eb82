"""Folds, flips and upper bounds of Gamma_down on an ideal plate, against the closed form in doubles."""

import json

import numpy as np
import pytest
from paths import GOLDEN

pytest.importorskip("flint", reason="needs the extra proofs")

from kernel.cycles.events import Kind, branch_and_events
from kernel.cycles.thresholds import thresholds
from kernel.proofs.balls import NotProvenError, bounds, first_proven
from kernel.proofs.branches import Branch, prove_down

REFERENCE = json.loads((GOLDEN / "branches.json").read_text())

KINDS = (Kind.FOLD, Kind.FLIP)


def prove_event(kind, omega, xi, periods, time):
    return first_proven(lambda: Branch(omega, xi, periods).event(kind, time))


def all_of(kind, omega, xi, periods):
    return first_proven(lambda: Branch(omega, xi, periods).zeros(kind))


def random_springs(n):
    random = np.random.default_rng(11)
    for _ in range(n):
        omega, xi = round(random.uniform(0.26, 1.3), 4), round(random.uniform(0.04, 0.3), 4)
        yield omega, xi, int(random.choice([1, 2]))


def test_golden_folds_and_flips_are_proven():
    for case in REFERENCE["special_points"]:
        for point in case["points"]:
            if point["kind"] in KINDS:
                spring = case["omega"], case["xi"], case["mode"][1]
                line = branch_and_events(*spring)[1]
                nearest = line.flight_time[np.argmin(abs(line.flight_time - point["flight_time"]))]
                proof = prove_event(point["kind"], *spring, float(nearest))
                for name, ball in (("flight_time", proof.flight_times[0]), ("gamma", proof.gamma)):
                    assert abs(ball - point[name]) < 1e-7, f"{name}: {point[name]} is not {bounds(ball)}"


def test_folds_and_flips_of_the_closed_form_are_proven_and_none_is_missing():
    for omega, xi, periods in random_springs(6):
        _, events = branch_and_events(omega, xi, periods)
        for kind in KINDS:
            chosen = np.flatnonzero(events.kind == kind)
            for i in chosen[:2]:
                proof = prove_event(kind, omega, xi, periods, float(events.flight_time[i]))
                assert float(proof.flight_times[0]) == pytest.approx(events.flight_time[i], abs=1e-13)
                assert float(proof.gamma) == pytest.approx(events.gamma[i], rel=1e-13)
            counted = all_of(kind, omega, xi, periods)
            assert list(map(float, counted)) == pytest.approx(sorted(events.flight_time[chosen]), abs=1e-12)


def test_answers_of_the_rule_are_proven_as_upper_bounds():
    """Also of a word, zs at Omega = 1.26, and at the reference's thresholds."""
    springs = [(case["omega"], case["xi"], case["gamma_down"]) for case in REFERENCE["threshold_down"]]
    for omega, xi, expected in (*springs, *((omega, 0.05, None) for omega in (0.4, 0.65, 1.26))):
        answer = thresholds(omega, xi)
        proof = prove_down(omega, xi, answer.fold)
        assert -1e-14 < float(proof.gamma) - answer.down < 1e-11, (
            f"{answer.down} is not {bounds(proof.gamma)}"
        )
        assert expected is None or abs(proof.gamma - expected) < 1e-11, f"{expected}: {bounds(proof.gamma)}"
        if answer.fold.cycle.letters == "Ss":  # cycles exist from the fold to a gamma above it
            assert float(proof.says.split()[-1]) > float(bounds(proof.gamma)[1])


def test_no_flight_time_beside_a_fold_is_proven_to_be_one():
    with pytest.raises(NotProvenError):
        prove_event(Kind.FOLD, 0.6, 0.05, 1, 3.0)
