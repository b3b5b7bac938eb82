"""Words: from a flip of a known branch, from flights that a sweep records, and into an immediate take-off."""

import json

import numpy as np
import pytest
from paths import GOLDEN

from kernel.branches.closed_form import TWO_PI
from kernel.branches.events import Kind, branch_and_events
from kernel.branches.words import doubled, follow, from_flights
from kernel.params import KernelInputError

REFERENCE = json.loads((GOLDEN / "branches.json").read_text())
FLIGHTS = json.loads((GOLDEN / "facts.json").read_text())["cycles"]


@pytest.fixture(scope="module")
def doubling():
    """The (2,2) branch of Fig. 2, from the flip of (1,1)."""
    _, events = branch_and_events(0.5, 0.26, 1)
    flip = events.flight_time[events.kind == Kind.FLIP][0]
    word, periods, unknowns, direction = doubled(0.5, 0.26, 1, float(flip))
    assert (word, periods) == ("ss", 2)
    return follow(0.5, 0.26, word, periods, unknowns, direction=direction, gamma=(0.0, 4.0))


def test_flips_of_the_doubled_branch(doubling):
    line, events = doubling
    expected = next(w for w in REFERENCE["words"] if w["word"] == "ss" and w["mode"] == [2, 2])["flip"]
    assert events.gamma[events.kind == Kind.FLIP] == pytest.approx(expected, abs=1e-9)
    assert set(events.kind) == {Kind.FLIP}
    # it ends where its second flight vanishes
    assert line.flight_time[-1].min() < 1e-6
    assert line.gamma[-1] > expected[1]


def test_doubled_branch_passes_through_the_simulated_cycle(doubling):
    """Gamma = 2.3 of Fig. 2, from its recorded flights; takeoff phases from the branch."""
    line, _ = doubling
    cell = next(c for c in FLIGHTS if c["gamma"] == 2.3)
    i = int(np.argmin(np.abs(line.gamma - 2.3)))
    word, periods, unknowns = from_flights(0.5, 0.26, 2.3, line.flight_time[i], line.takeoff_phase[i], 2)
    near, _ = follow(0.5, 0.26, word, periods, unknowns, points=1, gamma=(2.29, 2.31))
    j = int(np.argmin(np.abs(near.gamma - 2.3)))
    assert near.gamma[j] == pytest.approx(2.3, abs=1e-12)
    assert np.sort(near.flight_time[j]) == pytest.approx(sorted(cell["flights"]), abs=1e-9)
    assert near.stable[j]
    assert near.admissible[j] == 0


def test_one_flight_is_the_closed_form():
    """The word "s" through a point of (1,1) gives its events and multipliers."""
    line, events = branch_and_events(0.5, 0.26, 1)
    i = int(np.argmin(np.abs(line.flight_time - 4.6)))
    word, periods, unknowns = from_flights(
        0.5, 0.26, float(line.gamma[i]), line.flight_time[i : i + 1], line.takeoff_phase[i : i + 1], 1
    )
    assert word == "s"
    followed, found = follow(0.5, 0.26, word, periods, unknowns, gamma=(0.9, 3.0))
    for kind in (Kind.FOLD, Kind.FLIP):
        known = events.gamma[(events.kind == kind) & (events.gamma < 3.0)]
        assert np.sort(found.gamma[found.kind == kind]) == pytest.approx(np.sort(known), abs=1e-9)
    same = int(np.argmin(np.abs(followed.flight_time[:, 0] - line.flight_time[i])))
    assert followed.multiplier[same] == pytest.approx(line.multiplier[i], abs=1e-8)


def test_an_immediate_takeoff():
    """(2,2) with a "z" at Omega = 1.26, from the flights of a spring at Gamma = 2.2724; its fold."""
    expected = REFERENCE["immediate_takeoff"]
    flights = np.array(expected["flight_time"])
    phases = np.array(expected["takeoff_phase"])
    word, periods, unknowns = from_flights(1.26, 0.05, expected["gamma"], flights, phases, 2)
    assert sorted(word) == ["s", "z"]
    line, events = follow(1.26, 0.05, word, periods, unknowns, gamma=(2.0, 2.6))
    assert events.gamma[events.kind == Kind.FOLD] == pytest.approx([expected["fold"]], abs=1e-9)
    # it begins where the (1,2) branch lands with n = 0
    _, single = branch_and_events(1.26, 0.05, 2)
    begins = single.gamma[(single.kind == Kind.IMMEDIATE_TAKEOFF) & (single.admissible == 0)]
    shortest = np.argmin(line.flight_time.min(axis=1))
    assert line.gamma[shortest] == pytest.approx(begins[0], abs=1e-6)
    times = line.unknowns[:, 4:].sum(axis=1)
    assert times == pytest.approx(np.full(len(times), 2.0 * TWO_PI), abs=1e-12)


@pytest.mark.parametrize("word", ["", "sz", "sx"])
def test_refuses_other_words(word):
    with pytest.raises(KernelInputError) as refusal:
        follow(0.5, 0.26, word, 2, np.ones(8))
    assert refusal.value.argument == "word"
