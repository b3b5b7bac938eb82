"""Events of (1,k) branches: reference numbers, none missed and none invented, codimension two."""

import json
import math

import dense_branches
import numpy as np
import pytest
from hypothesis import given, strategies
from kernel_runs import examples
from paths import GOLDEN

from kernel.cycles.curves import Parameter, curves
from kernel.cycles.events import Kind, branch, branch_and_events

REFERENCE = json.loads((GOLDEN / "branches.json").read_text())


def of(events, kind, below=math.inf, admissible=True):
    """Gamma and flight time of events of a kind."""
    keep = (events.kind == kind) & (events.gamma < below)
    if admissible:
        keep &= events.violations == 0
    return events.gamma[keep], events.flight_time[keep]


@pytest.mark.parametrize("branch_", REFERENCE["special_points"], ids=lambda b: f"{b['omega']}-{b['mode']}")
def test_reference_events(branch_):
    _, events = branch_and_events(branch_["omega"], branch_["xi"], branch_["mode"][1])
    for kind in (Kind.FOLD, Kind.FLIP, Kind.NEIMARK_SACKER):
        expected = [p for p in branch_["points"] if p["kind"] == kind]
        gamma, time = of(events, kind, 8.0)
        assert gamma == pytest.approx([p["gamma"] for p in expected], abs=1e-9)
        assert time == pytest.approx([p["flight_time"] for p in expected], abs=1e-9)


@examples(12)
@given(
    omega=strategies.floats(0.25, 2.5),
    xi=strategies.floats(math.log(0.01), math.log(3.0)).map(math.exp),
    periods=strategies.integers(1, 3),
)
def test_none_missed_and_none_invented(omega, xi, periods):
    """Against sign changes on a dense grid of T, by matrix exponentials."""
    line, events = branch_and_events(omega, xi, periods)
    whole = dense_branches.events(omega, xi, periods, 8.0)
    for kind in (Kind.FOLD, Kind.FLIP, Kind.NEIMARK_SACKER):
        expected = [event for event in whole if event.kind == kind]
        keep = (events.kind == kind) & (events.gamma < 8.0)
        assert events.flight_time[keep] == pytest.approx([e.flight_time for e in expected], rel=1e-5)
        # interpolated between flight times, beside which Gamma may change by its own size
        assert events.gamma[keep] == pytest.approx([e.gamma for e in expected], rel=1e-4)
        for event, reason in zip(expected, events.violations[keep], strict=True):
            # samples do not decide where a condition is nearly broken
            assert abs(event.margin) < 1e-6 or (reason == 0) == (event.margin > 0.0)
    assert len(line.gamma) >= 400


def test_a_torus_beside_a_fold_is_found():
    """A cycle of (1,2) with multipliers e^{+-0.12 i}: 6e-4 rad beside it they are real."""
    omega, xi = 0.3503753530041962, 0.03585184030279528
    gamma, time = of(branch_and_events(omega, xi, 2)[1], Kind.NEIMARK_SACKER, 8.0)
    whole = [e for e in dense_branches.events(omega, xi, 2, 8.0) if e.kind == Kind.NEIMARK_SACKER]
    assert time == pytest.approx([e.flight_time for e in whole], rel=1e-6)
    assert gamma == pytest.approx([2.06820010], abs=1e-6)


def test_a_window_narrower_than_the_grid_has_both_its_ends():
    """Cycles are admissible over 0.0008 rad of a grid of 0.05 rad, from a graze to a landing with n = 0."""
    spring = (0.9627922585259332, 0.05468653085150799, 3)
    _, events = branch_and_events(*spring)
    inside = (events.flight_time > 12.15) & (events.flight_time < 12.16)
    assert dict(zip(events.kind[inside], events.flight_time[inside], strict=True)) == {
        Kind.GRAZE_CONTACT: pytest.approx(12.1562816, abs=1e-6),
        Kind.IMMEDIATE_TAKEOFF: pytest.approx(12.1571250, abs=1e-6),
    }
    times = np.array([12.1562, 12.1566, 12.1572])
    assert (branch(*spring, times).violations == 0).tolist() == [False, True, False]


@pytest.mark.parametrize(("omega", "xi", "periods"), [
    (0.2764, 0.0106, 2),
    (0.3158, 0.0911, 2),
    (0.25063082376, 0.06223447937, 1),
    (0.26, 0.02, 1),
    (0.9, 0.3, 3),
])  # fmt: skip
def test_conditions_break_at_events_only(omega, xi, periods):
    """Against gap and n on a grid of times by matrix exponentials, orbits that are not admissible too.

    The first has two minima of the gap below zero at once, the second a dip of 1e-9 next to take-off.
    """
    _, events = branch_and_events(omega, xi, periods)
    kinds = (Kind.GRAZE_FLIGHT, Kind.GRAZE_CONTACT, Kind.IMMEDIATE_TAKEOFF)
    time = events.flight_time[np.isin(events.kind, kinds)]
    points = 6_000
    changes = np.array(dense_branches.breaks(omega, xi, periods, 8.0, points, 4))
    width = 2.0 * math.pi * periods / points
    assert len(changes)
    for low, high in changes:
        assert ((time > low - width) & (time < high + width)).any(), (low, high)


def test_no_landing_grazes_without_damping():
    """Where n is zero at a landing the impact touches zero, and changes no sign."""
    _, events = branch_and_events(0.45, 0.0, 1)
    assert 5.107673249 in of(events, Kind.IMMEDIATE_TAKEOFF, 8.0)[1].round(9)
    assert of(events, Kind.GRAZE_FLIGHT)[1] == pytest.approx([3.616938], abs=1e-6)


def test_a_dip_before_a_soft_landing_is_found():
    """The gap passes zero some 0.03 rad before a landing at 1e-3 and rises again by 1e-6."""
    omega, xi, at = 1.3013539025728416, 0.08275128198175498, 7.995266176766961
    _, events = branch_and_events(omega, xi, 2)
    assert np.abs(of(events, Kind.GRAZE_FLIGHT)[1] - at).min() < 1e-9
    sides = [dense_branches.held(omega, xi, 2, at + aside) for aside in (-1e-6, 1e-6)]
    assert [side.gap[0] > 0.0 for side in sides] == [False, True]
    beside = branch(omega, xi, 2, np.array([at - 1e-3, at + 1e-3]))
    assert (beside.violations == 0).tolist() == [False, True]


def test_a_root_beside_a_pole_is_found():
    """n at landing changes sign twice between neighbours of the grid: at a pole of Gamma, and at zero."""
    _, events = branch_and_events(2.3075262747315803, 0.06161151238087529, 2)
    found = np.abs(events.flight_time - 8.420244407409733) < 1e-9
    assert events.kind[found].tolist() == [Kind.IMMEDIATE_TAKEOFF]
    sides = [
        dense_branches.held(2.3075262747315803, 0.06161151238087529, 2, 8.420244407409733 + aside).landing[0]
        for aside in (-1e-6, 1e-6)
    ]
    assert sides[0] * sides[1] < 0.0


@pytest.fixture(scope="module")
def plane():
    return curves(Parameter.OMEGA, 0.05, 0.42, 0.84, 1, (Kind.FOLD, Kind.NEIMARK_SACKER), lines=8)


def test_codimension_two(plane):
    for name, kind in (("cusp", Kind.CUSP), ("bogdanov_takens", Kind.BOGDANOV_TAKENS)):
        for expected in REFERENCE["codimension_2"][name]:
            i = np.argmin(np.abs(plane.points.omega - expected["omega"]) + 9.0 * (plane.points.kind != kind))
            assert plane.points.kind[i] == kind
            assert plane.points.omega[i] == pytest.approx(expected["omega"], abs=1e-9)
            assert plane.points.flight_time[i] == pytest.approx(expected["flight_time"], abs=1e-9)
            assert plane.points.gamma[i] == pytest.approx(expected["gamma"], abs=1e-9)


def test_neimark_sacker_curves_reach_the_points_at_which_their_multipliers_meet(plane):
    """At 1 the fold's Bogdanov-Takens point, at -1 the 1:2 resonance; or the edge of the range."""
    ends = []
    for curve in plane.curves:
        if curve.kind[0] == Kind.NEIMARK_SACKER:
            for omega, gamma, mu in zip(curve.omega, curve.gamma, curve.multiplier[:, 0], strict=True):
                if abs(mu**2 - 1.0) < 1e-5:
                    ends.append((round(mu.real), omega, gamma))
    takens = plane.points.omega[plane.points.kind == Kind.BOGDANOV_TAKENS]
    assert sorted(omega for mu, omega, _ in ends if mu > 0) == pytest.approx(sorted(takens), abs=1e-9)
    assert any(x == (-1, pytest.approx(0.507053, abs=1e-6), pytest.approx(2.380960, abs=1e-5)) for x in ends)


def test_points_of_curves_are_events(plane):
    for curve in plane.curves:
        for i in range(1, len(curve.gamma), 40):
            _, events = branch_and_events(float(curve.omega[i]), float(curve.xi[i]), 1)
            gamma, time = of(events, curve.kind[0], admissible=False)
            near = np.abs(time - curve.flight_time[i]) < 1e-7
            assert near.any(), (curve.kind[0], curve.omega[i])
            assert gamma[near] == pytest.approx(curve.gamma[i], rel=1e-7)


@pytest.mark.parametrize(
    ("parameter", "fixed", "low", "high", "periods"),
    [(Parameter.OMEGA, 0.05, 1.2, 1.4, 2), (Parameter.XI, 0.44, 0.03, 0.3, 1)],
)
def test_curves_of_grazes(parameter, fixed, low, high, periods):
    """Each point is an orbit that grazes, found by itself: an event of the branch of its own spring."""
    kinds = (Kind.GRAZE_FLIGHT, Kind.GRAZE_CONTACT, Kind.IMMEDIATE_TAKEOFF)
    found = curves(parameter, fixed, low, high, periods, kinds, lines=6)
    assert {curve.kind[0] for curve in found.curves} >= {Kind.GRAZE_FLIGHT, Kind.IMMEDIATE_TAKEOFF}
    seen = 0
    for curve in found.curves:
        assert (np.ptp(curve.omega) == 0.0) == (parameter is Parameter.XI)
        at = curve.xi if parameter is Parameter.XI else curve.omega
        for i in range(5, len(curve.gamma) - 5, 20):
            # curves end where two grazes meet; a gap beside that dips below zero by less than rounding
            if curve.violations[i] or np.abs(at[i] - at[[0, -1]]).min() < 2e-3:
                continue
            _, events = branch_and_events(float(curve.omega[i]), float(curve.xi[i]), periods)
            near = np.isin(events.kind, kinds) & (np.abs(events.flight_time - curve.flight_time[i]) < 1e-8)
            assert near.any(), (curve.kind[0], curve.omega[i], curve.xi[i])
            assert events.gamma[near] == pytest.approx(curve.gamma[i], rel=1e-8)
            seen += curve.kind[0] in kinds[:2]
    assert seen >= 2
