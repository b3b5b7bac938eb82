"""How the segments of a cycle change: the words of an ideal plate against known ones, and doubled cycles."""

import json

import numpy as np
import pytest
from contacts import attracting, rigid, soft
from paths import GOLDEN

from kernel.cycles.any_contact import both_ways, branches
from kernel.cycles.changes import doubled
from kernel.cycles.events import Kind, branch_and_events
from kernel.cycles.follow import End, follow
from kernel.params import Cell

REFERENCE = json.loads((GOLDEN / "branches.json").read_text())


def gammas(events, kind):
    return [event.point.parameter for event in events if event.kind is kind]


def first_flip(plate):
    """That of (1,1) at Omega = 0.5, xi = 0.26."""
    (flip,) = (e for e in branches(plate, 0.5, 0.26, 1, span=(0.5, 3.0))[0].events if e.kind is Kind.FLIP)
    return flip.point


@pytest.mark.parametrize(("plate", "flip"), [
    (rigid(0.0), 2.504567661968),
    (rigid(0.3), 2.518213336734),
    (soft(), 2.504559485239),
    (soft(adhesive=False), 2.504551432530),
])  # fmt: skip
def test_a_doubled_cycle_doubles_again(plate, flip):
    """From the flip of (1,1) at Omega = 0.5, xi = 0.26, 5,000 simulated periods within 1e-12 of it."""
    start = doubled(first_flip(plate))
    assert start.cycles.periods == 2
    _, events = follow(start, 1.0, span=(1.0, 2.6))
    assert gammas(events, Kind.FLIP) == pytest.approx([flip], abs=1e-9)


def test_the_doubled_cycles_of_figure_2():
    """The (2,2) has two flips and ends in one flight again; from the first begins (4,4), which loses one."""
    two, four = (next(w for w in REFERENCE["words"] if w["mode"] == mode) for mode in ([2, 2], [4, 4]))
    line, events = follow(doubled(first_flip(rigid(0.0))), 1.0, span=(1.0, 4.0))
    flips = [event.point for event in events if event.kind is Kind.FLIP]
    assert gammas(events, Kind.FLIP)[:2] == pytest.approx(two["flip"], abs=1e-8)
    change = next(event for event in events if event.kind is Kind.GRAZE_CONTACT)
    assert (len(line[change.after + 1].letters), change.point.letters) == (2, "Ss")
    assert line[-1].cycles.periods == 2
    _, events = follow(doubled(flips[0]), 1.0, span=(1.0, 4.0))
    assert gammas(events, Kind.FLIP)[: len(four["flip"])] == pytest.approx(four["flip"], abs=1e-9)
    assert min(np.abs(np.array(gammas(events, Kind.GRAZE_CONTACT)) - four["flight_vanishes"])) < 1e-6


def test_a_doubled_cycle_begins_beside_a_contact_of_no_duration():
    """At the second flip a contact takes 1e-4 rad; it vanishes on the doubled branch, 1e-3 from the flip."""
    lines = branches(soft(0.424, 0.00354), 1.087, 0.0385, 1, span=(2.16, 2.17))
    flips = [event.point for line in lines for event in line.events if event.kind is Kind.FLIP]
    assert len(flips) == 2
    for flip in flips:
        assert doubled(flip).parameter == pytest.approx(flip.parameter, abs=1e-4)


def test_a_torus_out_of_a_landing_that_takes_off_at_once():
    expected = REFERENCE["immediate_takeoff"]["neimark_sacker"]["gamma"]
    followed = branches(rigid(0.0), 1.28, 0.05, 2, span=(2.0, 3.0))
    tori = [e.point for each in followed for e in each.events if e.kind is Kind.NEIMARK_SACKER]
    torus = min(tori, key=lambda point: abs(point.parameter - expected))
    assert torus.parameter == pytest.approx(expected, abs=1e-9)
    assert np.sort(np.abs(torus.multipliers))[-2:] == pytest.approx([1.0, 1.0], abs=1e-9)


def test_a_cycle_that_flies_all_the_time():
    """Its contact vanishes; beyond, it lands and takes off at once, as for 5,000 simulated periods."""
    (line,) = branches(rigid(0.0), 2.0, 0.1, 1, span=(2.0, 8.5), points=400)
    (change,) = gammas(line.events, Kind.IMMEDIATE_TAKEOFF)
    assert change == pytest.approx(7.9766662, abs=1e-6)
    beyond = [point for point in line.points if point.parameter > change]
    assert beyond[-1].parameter == pytest.approx(8.5, abs=1e-12)
    assert all(point.stable and point.flights == pytest.approx([2.0 * np.pi]) for point in beyond)


def test_a_landing_that_takes_off_at_once():
    """The (2,2) with a "z" that (1,2) becomes at Omega = 1.26 where it lands with n = 0, and its fold."""
    expected = REFERENCE["immediate_takeoff"]
    followed = branches(rigid(0.0), 1.26, 0.05, 2, span=(0.5, 2.6))
    events = [event for each in followed for event in each.events]
    _, single = branch_and_events(1.26, 0.05, 2)
    begins = single.gamma[(single.kind == Kind.IMMEDIATE_TAKEOFF) & (single.violations == 0)]
    changes = [event for event in events if event.kind is Kind.IMMEDIATE_TAKEOFF]
    assert min(abs(e.point.parameter - begins[0]) for e in changes) < 1e-10
    assert min(np.abs(np.array(gammas(events, Kind.FOLD)) - expected["fold"])) < 1e-9


@pytest.mark.parametrize(("plate", "cell", "kind", "gamma"), [
    (rigid(0.145), Cell(2.091346402, 0.622852615, 0.128021696), Kind.GRAZE_CONTACT, 2.571016),
    (rigid(0.145), Cell(2.377068234, 0.778395495, 0.074548361), Kind.GRAZE_CONTACT, 2.481845),
    (rigid(0.825), Cell(4.774318866, 0.638197572, 0.206651525), Kind.GRAZE_FLIGHT, 5.252544),
    (rigid(0.0), Cell(3.077627136, 0.739284155, 0.203493656), Kind.IMMEDIATE_TAKEOFF, 3.353605),
    (rigid(0.0), Cell(4.658453925, 1.201557256, 0.124175664), Kind.IMMEDIATE_TAKEOFF, 5.4046),
    (soft(0.815, 1.2e-6, adhesive=False), Cell(4.290509, 1.25025, 0.256117), Kind.GRAZE_FLIGHT, 4.5273),
    (soft(0.749, 1.88953569e-3), Cell(3.207142, 1.248445, 0.241986), Kind.GRAZE_FLIGHT, 3.78494),
    (soft(0.007, 6e-3, adhesive=False), Cell(3.15157, 1.258992, 0.123151), End.BELOW_SURFACE, 1.775045),
])  # fmt: skip
def test_branches_go_on_where_segments_vanish_or_appear_to_rounding(plate, cell, kind, gamma):
    """Springs whose branches broke off there. Gamma is as first followed; the kernel judges each cycle."""
    _, events = both_ways(attracting(plate, cell), (0.5, 8.0), 400)
    assert min(np.abs(np.array(gammas(events, kind)) - gamma)) < 1e-4
    assert not gammas(events, End.UNKNOWN_CHANGE)
