"""Words: from a flip of a known branch, from flights that a sweep records, and into an immediate take-off."""

import json

import numpy as np
import pytest
from kernel_runs import run
from paths import GOLDEN

from kernel.branches.closed_form import TWO_PI
from kernel.branches.continuation import events as events_of
from kernel.branches.continuation import follow, start
from kernel.branches.events import EDGES, Kind, branch, branch_and_events
from kernel.branches.words import (
    doubled,
    from_branch,
    from_flights,
    record,
    with_hop,
    with_split_contact,
    without,
)

REFERENCE = json.loads((GOLDEN / "branches.json").read_text())


def followed(word, **limits):
    """A branch with the record of its events."""
    line, turns = follow(word, **limits)
    return line, events_of(turns)


@pytest.fixture(scope="module")
def doubling():
    """The (2,2) branch of Fig. 2, from the flip of (1,1)."""
    _, events = branch_and_events(0.5, 0.26, 1)
    flip = events.flight_time[events.kind == Kind.FLIP][0]
    word = doubled(from_branch(0.5, 0.26, 1, float(flip)))
    assert (word.letters, word.periods) == ("ss", 2)
    return followed(word, gamma=(0.0, 4.0))


def test_flips_of_the_doubled_branch(doubling):
    line, events = doubling
    expected = next(w for w in REFERENCE["words"] if w["word"] == "ss" and w["mode"] == [2, 2])["flip"]
    assert events.gamma[events.kind == Kind.FLIP] == pytest.approx(expected, abs=1e-9)
    # it ends where its second flight vanishes
    assert events.kind.tolist() == [Kind.FLIP, Kind.FLIP, Kind.GRAZE_CONTACT]
    assert (events.admissible == 0).all()
    assert line.flight_time[-1].min() < 1e-9
    assert line.gamma[-1] == events.gamma[-1] > expected[1]


def test_four_flights(doubling):
    """The flips and the end of (4,4), from the flip of (2,2)."""
    line, events = doubling
    expected = next(w for w in REFERENCE["words"] if w["mode"] == [4, 4])
    i = int(np.argmin(np.abs(line.gamma - events.gamma[0])))
    near = from_flights(0.5, 0.26, line.gamma[i], line.takeoff_phase[i], line.flight_time[i], 2)
    (flip,) = (x.word for x in follow(near, gamma=(2.4, 2.6))[1] if x.kind is Kind.FLIP)
    _, events = followed(doubled(flip), gamma=(0.0, 4.0))
    assert events.gamma[events.kind == Kind.FLIP] == pytest.approx(expected["flip"], abs=1e-9)
    assert events.gamma[events.kind == Kind.GRAZE_CONTACT] == pytest.approx(
        [expected["flight_vanishes"]], abs=1e-6
    )


def test_from_the_flights_of_a_simulated_cell():
    """Of (2,2) with an immediate take-off, simulated from rest; the cycle found is the one recorded."""
    line = run(1.02, 0.67, 0.05, settle=3000, observe=20, keep=16)
    assert (line.bounces[0], line.periods[0]) == (2, 1)
    times, phases = line.flight_time[0, 14:16], line.takeoff_phase[0, 14:16]
    word = from_flights(0.67, 0.05, 1.02, phases, times, 1)
    assert word.letters == "zs"
    point = record(word, start(word).u[None])
    assert point.gamma[0] == pytest.approx(1.02, abs=1e-14)
    assert np.sort(point.flight_time[0]) == pytest.approx(np.sort(times), abs=1e-9)
    assert np.sort(point.takeoff_phase[0]) == pytest.approx(np.sort(phases), abs=1e-9)
    assert point.stable[0]
    assert point.admissible[0] == 0


def test_one_flight_is_the_closed_form():
    """The word "s" through a point of (1,1) gives its events and multipliers."""
    line, events = branch_and_events(0.5, 0.26, 1)
    i = int(np.argmin(np.abs(line.flight_time - 4.6)))
    word = from_flights(
        0.5, 0.26, float(line.gamma[i]), line.takeoff_phase[i : i + 1], line.flight_time[i : i + 1], 1
    )
    assert word.letters == "s"
    whole, found = followed(word, gamma=(0.9, 3.0))
    for kind in (Kind.FOLD, Kind.FLIP):
        known = events.gamma[(events.kind == kind) & (events.gamma < 3.0)]
        assert np.sort(found.gamma[found.kind == kind]) == pytest.approx(np.sort(known), abs=1e-9)
    here = from_branch(0.5, 0.26, 1, float(line.flight_time[i]))
    for name, value in record(here, here.unknowns[None])._asdict().items():
        if name in ("gamma", "flight_time", "takeoff_phase", "impact_velocity", "multiplier", "stable"):
            assert np.ravel(value) == pytest.approx(np.ravel(getattr(line, name)[i]), abs=1e-11), name
    # and one flight ends where the closed form says it does
    edges = events.gamma[np.isin(events.kind, EDGES) & (events.gamma < 3.0)]
    assert np.sort(found.gamma[np.isin(found.kind, EDGES)]) == pytest.approx(np.sort(edges), abs=1e-8)
    assert (np.diff(whole.flight_time[:, 0]) != 0.0).all()


def test_an_immediate_takeoff():
    """(2,2) with a "z" at Omega = 1.26, from the flights of a spring at Gamma = 2.2724; its fold."""
    expected = REFERENCE["immediate_takeoff"]
    flights = np.array(expected["flight_time"])
    phases = np.array(expected["takeoff_phase"])
    word = from_flights(1.26, 0.05, expected["gamma"], phases, flights, 2)
    assert word.letters == "zs"
    line, events = followed(word, gamma=(2.0, 2.6))
    assert events.gamma[events.kind == Kind.FOLD] == pytest.approx([expected["fold"]], abs=1e-9)
    # it begins where the (1,2) branch lands with n = 0
    _, single = branch_and_events(1.26, 0.05, 2)
    begins = single.gamma[(single.kind == Kind.IMMEDIATE_TAKEOFF) & (single.admissible == 0)]
    assert events.gamma[events.kind == Kind.IMMEDIATE_TAKEOFF] == pytest.approx(begins, abs=1e-10)
    times = line.unknowns[:, 4:].sum(axis=1)
    assert times == pytest.approx(np.full(len(times), 2.0 * TWO_PI), abs=1e-12)


@pytest.mark.parametrize(("omega", "key"), [(1.26, Kind.FOLD), (1.28, Kind.NEIMARK_SACKER)])
def test_from_a_landing_without_force(omega, key):
    """The same (2,2) from the event of (1,2): its fold at Omega = 1.26, its torus at 1.28."""
    expected = REFERENCE["immediate_takeoff"]
    _, events = branch_and_events(omega, 0.05, 2)
    (i,) = np.flatnonzero((events.kind == Kind.IMMEDIATE_TAKEOFF) & (events.admissible == 0))
    word = with_hop(from_branch(omega, 0.05, 2, float(events.flight_time[i])), 0)
    assert word.letters == "zs"
    _, found = followed(word, gamma=(2.0, 3.0))
    gamma = expected["fold"] if omega == 1.26 else expected["neimark_sacker"]["gamma"]
    assert found.gamma[found.kind == key] == pytest.approx([gamma], abs=1e-9)
    pair = found.multiplier[found.kind == key][0]
    if key is Kind.NEIMARK_SACKER:
        assert np.abs(pair) == pytest.approx([1.0, 1.0], abs=1e-11)


def test_a_split_contact_and_back(doubling):
    """(2,2) ends where a flight vanishes; (1,2) with n = 0 within its contact is there, and leads back."""
    _, events = doubling
    (end,) = (x for x in follow(near_end(doubling), gamma=(3.5, 4.0))[1] if x.kind is Kind.GRAZE_CONTACT)
    single = without(end.word, end.piece)
    assert single.letters == "s"
    orbit = record(single, single.unknowns[None])
    assert orbit.gamma[0] == pytest.approx(events.gamma[-1], abs=1e-9)
    closed = branch(0.5, 0.26, 2, orbit.flight_time[0])
    assert closed.gamma[0] == pytest.approx(orbit.gamma[0], abs=1e-9)
    assert closed.takeoff_phase[0] == pytest.approx(orbit.takeoff_phase[0, 0], abs=1e-8)
    (touch,) = (
        x for x in follow(single, gamma=(3.6, 3.8))[1] if x.kind is Kind.GRAZE_CONTACT and x.time > 0.0
    )
    again, _ = followed(with_split_contact(touch.word, touch.piece, touch.time), gamma=(3.5, 4.0), points=3)
    assert again.word == "ss"
    assert again.gamma[0] == pytest.approx(events.gamma[-1], abs=1e-4)


def near_end(doubling):
    """A word on the (2,2) branch before its end."""
    line, _ = doubling
    return from_flights(0.5, 0.26, line.gamma[-8], line.takeoff_phase[-8], line.flight_time[-8], 2)
