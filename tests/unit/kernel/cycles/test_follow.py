"""Branches of cycles of many contacts against folds, flips and ends known by other means.

The numbers come from a separate implementation of this method and, for the folds, from single shooting of the
return map; 5,000 simulated plate periods on either side of each showed that a stable cycle ends there.
"""

from dataclasses import replace

import numpy as np
import pytest
from contacts import attracting, rigid, soft

from kernel.cycles.any_contact import (
    both_ways,
    branches,
    branches_at,
    cut_off,
    lies_on,
    passing,
    repeats,
    turned,
    up_to_shorter,
)
from kernel.cycles.changes import doubled
from kernel.cycles.events import Kind, branch_and_events
from kernel.cycles.follow import LARGEST, RANGE, End, follow
from kernel.params import Cell

FOLD, FLIP, TORUS, STICK = Kind.FOLD, Kind.FLIP, Kind.NEIMARK_SACKER, End.STICK_VANISHES

#: Contact, Omega, xi; lower fold, upper fold, flip, and others, of the branch (1,1) that begins at rest.
TABLE = [
    (soft(), 0.60, 0.05, (0.553241345562, 0.915986309968), {FLIP: 0.724382078263}),
    (soft(), 0.62, 0.05, (0.507031875922, 0.871910919092), {FLIP: 0.981890951064}),
    (soft(), 0.66, 0.05, (0.596890103655, 0.809085730714), {FLIP: 2.373172758743}),
    (
        soft(), 0.70, 0.05, (0.669278722617, 0.752498081518),
        {TORUS: (1.063995206954, 2.219171783138), FLIP: 4.189405636770},
    ),
    (soft(), 0.50, 0.26, (1.248070477993, 1.295171159281), {FLIP: 2.075150936344}),
    (soft(penetration=1e-2), 0.60, 0.05, (0.552918762421, 0.915742981450), {FLIP: 0.724322139983}),
    (soft(adhesive=False), 0.60, 0.05, (0.553238870182, 0.915985867041), {FLIP: 0.724380768985}),
    (soft(0.1, 1e-2, adhesive=False), 0.60, 0.05, (0.552721684722, 0.915645424225), {}),
    (rigid(0.1), 0.60, 0.05, (0.5535529730, 0.915794804063), {FLIP: 0.724168302641}),
    (rigid(0.3), 0.60, 0.05, (0.559952062803, 0.912513252023), {FLIP: 0.721456140149}),
    (rigid(0.3), 0.62, 0.05, (0.516259290719, 0.869786519752), {FLIP: 0.987579157392}),
    (rigid(0.3), 0.50, 0.26, (1.252524207015, 1.294358283349), {FLIP: 2.080477043502}),
    (
        rigid(0.5), 0.60, 0.05, (0.580588856410, 0.904571734165),
        {FLIP: 0.727912197002, STICK: 1.4773308873},
    ),
    (
        rigid(0.5), 0.66, 0.05, (0.695395334976, 0.805215730572),
        {TORUS: (0.701567857477, 1.424505823882), FLIP: 2.532228009750, STICK: 2.7365421457},
    ),
    (rigid(0.7), 0.60, 0.05, (0.626045192610, 0.896463199269), {STICK: 0.6351854981}),
    (rigid(0.8), 0.60, 0.05, (0.908499312368,), {STICK: 0.7867535018}),
    (rigid(0.9), 0.60, 0.05, (), {STICK: 0.8801070686}),
]  # fmt: skip


def gammas(followed, kind):
    return sorted(event.point.parameter for event in followed.events if event.kind is kind)


@pytest.mark.parametrize(("plate", "omega", "xi", "folds", "others"), TABLE)
def test_folds_flips_and_ends_of_a_branch(plate, omega, xi, folds, others):
    followed = branches(plate, omega, xi, 1, span=(0.05, 5.0))[0]
    assert gammas(followed, FOLD) == pytest.approx(folds, abs=1e-9)
    for kind in (TORUS, FLIP):
        expected = np.atleast_1d(others.get(kind, ()))
        assert gammas(followed, kind)[: len(expected)] == pytest.approx(expected, abs=1e-9)
    if STICK in others:
        assert gammas(followed, STICK) == pytest.approx([others[STICK]], abs=1e-8)


def test_a_family_of_hops_that_never_sticks():
    *_, hops = branches(rigid(0.9), 0.60, 0.05, 1)
    assert {point.letters for point in hops.points} >= {"h", "hh", "hhh"}
    assert pytest.approx(gammas(hops, FOLD)[0], abs=1e-9) == 0.393179810088
    assert pytest.approx(gammas(hops, FLIP)[0], abs=1e-9) == 0.427801679385


@pytest.mark.parametrize("omega", [0.58, 0.593, 0.61])
def test_a_family_without_a_stable_cycle_near_those_of_the_closed_form(omega):
    _, hops = branches(rigid(0.7), omega, 0.05, 1)
    assert {point.letters for point in hops.points} >= {"h", "hh", "hhh"}


def test_a_branch_far_from_the_cycles_of_the_closed_form_beside_one_near_them():
    lines = branches(soft(0.7, 0.01), 0.975, 0.0643, 1, span=(0.2, 2.0), points=500)
    assert [max(point.parameter for point in line.points) > 1.9 for line in lines] == [False, True]


def test_a_branch_where_no_cycle_of_the_closed_form_is_stable():
    (line,) = branches(rigid(0.353), 0.9445175, 0.0345, 2, span=(2.6, 3.4))
    assert sorted(gammas(line, FOLD)) == pytest.approx([2.740261171766, 3.285075490445], abs=1e-9)


@pytest.mark.parametrize(("plate", "omega", "along", "span", "turn"), [
    (rigid(0.3), 0.60, "omega", (0.4, 0.9), 0.649242430964),
    (soft(), 0.60, "omega", (0.4, 0.9), 0.661091706414),
    (rigid(0.3), 0.62, "xi", (0.04, 0.2), 0.064071208251),
    (soft(), 0.62, "xi", (0.04, 0.2), 0.065927841578),
])  # fmt: skip
def test_turns_along_the_other_parameters(plate, omega, along, span, turn):
    """At Gamma = 0.6; along Gamma the branch there has its fold at 0.6."""
    first = branches_at(plate, Cell(0.6, omega, 0.05), 1, along, span)[0]
    assert max(gammas(first, FOLD)) == pytest.approx(turn, abs=1e-9)
    assert all(point.cell[0] == pytest.approx(0.6, abs=1e-13) for point in first.points)
    if along == "omega":  # it is closed
        assert first.points[-1] is first.points[0]


@pytest.mark.parametrize("above", [3e-4, 1e-5, 1e-8])
def test_a_branch_passes_twice_beside_its_fold(above):
    """Where no two of its points may lie on either side of Gamma."""
    fold = 0.5532413455618
    (line,) = branches(soft(), 0.60, 0.05, 1)
    points = list(passing(line, fold + above))
    assert [point.parameter for point in points] == pytest.approx([fold + above] * 2, abs=1e-9)
    assert sorted(point.stable for point in points) == [False, True]
    beside = min(line.points, key=lambda point: abs(point.parameter - fold))
    assert beside.cycles.at(beside.x, fold - above) is None


def test_a_branch_begun_exactly_on_a_fold_goes_both_ways_and_has_the_fold():
    (line,) = branches(soft(), 0.6, 0.05, 1)
    fold = next(event.point for event in line.events if event.kind is FOLD)
    seed = turned(fold, "omega", fold.parameter)
    level = seed.tangent * (1.0 - seed.cycles.gradient(seed.x))  # no rounding left
    whole = both_ways(replace(seed, tangent=level / np.linalg.norm(level)), (0.59, 0.61), 100)
    assert [event.point.parameter for event in whole.events if event.kind is FOLD] == [0.6]
    ends = [max(whole.points[end].flights) for end in (0, -1)]
    assert min(ends) < max(fold.flights) < max(ends)


def test_a_cycle_on_the_limit_is_on_the_branch():
    """And begins it, on whichever side of the limit rounding puts it."""
    span = (RANGE[0], 2.0)
    (line,) = branches(soft(), 0.60, 0.05, 1, span=span)
    (end,) = passing(line, span[1])
    assert lies_on(end, line)
    for gamma in np.nextafter(2.0, [1.0, 3.0]).tolist():
        assert len(both_ways(end.cycles.at(end.x, gamma), span, points=30).points) > 2


def test_a_branch_that_goes_on_beyond_its_points_says_so():
    followed, whole = (branches(soft(), 0.60, 0.05, 1, points=points)[0] for points in (60, 300))
    assert {event.kind for event in followed.events if event.kind in set(End)} == {End.CUT_OFF, End.REST}
    assert {event.kind for event in whole.events if event.kind in set(End)} == {End.REST}
    assert len(whole.points) > len(followed.points)


@pytest.mark.parametrize(("restitution", "omega", "xi", "flip"), [
    (0.3, 0.443498, 0.048463, 1.38498624),
    (0.416337, 0.452189, 0.040721, 1.36002595),
    (0.069175, 0.409582, 0.168493, 1.53973949),
    (0.079227, 0.376945, 0.191921, 1.60776476),
])  # fmt: skip
def test_a_flip_between_points_with_other_numbers_of_hops(restitution, omega, xi, flip):
    lines = branches(rigid(restitution), omega, xi, 1)
    assert any(abs(gamma - flip) < 1e-8 for line in lines for gamma in gammas(line, FLIP))


@pytest.mark.parametrize("beside", range(-4, 5))
def test_flips_beside_grazes(beside):
    """Two multipliers meet at Gamma 7.27313, 1e-9 from a graze, and one flip is 1e-13 from a graze."""
    (line,) = branches(soft(), 0.89967 + 1e-7 * beside, 0.05, 1)
    assert len(gammas(line, FLIP)) == 4
    if beside == 0:  # back across the grazes
        assert len(gammas(follow(line.points[-1].back(), 0.0), FLIP)) == 4


def test_a_torus_point_that_newtons_method_reaches_only_from_beyond():
    """Multipliers at a flip, Gamma 3.9217025, are beyond the unit circle 6.2e-5 above it, next to a graze."""
    plate = soft(0.231732251533, 0.0330068966503, adhesive=False)
    line = branches(plate, 1.09586168979, 0.0351172566676, 1)[0]
    point = next(event.point for event in line.events if event.kind is TORUS)
    assert point.parameter == pytest.approx(3.921764403, abs=1e-8)
    assert abs(point.multipliers[0]) == pytest.approx(1.0, abs=1e-9)


def test_a_branch_whose_first_cycle_is_far_outside_the_span():
    """On an ideal plate it turns at the fold of the closed form."""
    omega, xi, span = 0.4698, 0.03, (RANGE[0], 1.0)
    _, known = branch_and_events(omega, xi, 1)
    expected = known.gamma[(known.kind == FOLD) & (known.gamma < span[1]) & (known.violations == 0)]
    lines = branches(rigid(0.0), omega, xi, 1, span=span)
    assert [x for line in lines for x in gammas(line, FOLD)] == pytest.approx(expected.tolist(), abs=1e-9)


def test_a_way_from_a_cycle_outside_the_span_that_is_cut_off_says_so():
    lines = branches(soft(0.64487, 1.1922e-5), 1.43847, 0.040238, 1, span=(RANGE[0], 1.0))
    (end,) = cut_off(lines)
    assert end.point.parameter > 1.0


@pytest.mark.parametrize("omega", [1.3, 1.35, 1.4])
def test_a_branch_far_above_where_the_search_begins(omega):
    """From where its flights vanish to the end of the span."""
    (line,) = branches(soft(), omega, 0.05, 1)
    assert line.events[0].kind is End.REST
    assert line.points[-1].parameter == pytest.approx(RANGE[1], abs=1e-12)


def test_a_branch_at_small_gamma():
    """At resonance rest ends at Gamma = 4 xi/sqrt(1 + 16 xi**2), Eq. 25."""
    (line,) = branches(rigid(0.0), 1.0, 0.01, 1, span=(RANGE[0], 1.0))
    assert line.events[0].kind is End.REST
    assert line.events[0].point.parameter == pytest.approx(0.04 / np.sqrt(1.0016), abs=1e-8)


@pytest.mark.parametrize(
    ("plate", "omega", "xi"),
    [(soft(), 1.0, 0.26), (soft(adhesive=False), 0.6, 0.05), (rigid(0.325), 0.6829, 0.0973)],
)
def test_a_branch_is_listed_once(plate, omega, xi):
    lines = branches(plate, omega, xi, 1)
    assert sum(event.kind is End.REST for line in lines for event in line.events) == 1


def test_pieces_of_a_branch_that_was_cut_off_meet_and_do_not_overlap():
    cut, rest = branches(soft(penetration=0.00831), 0.283, 0.0477, 1)
    events = [(event.kind, round(event.point.parameter, 9)) for event in [*cut.events, *rest.events]]
    assert len(set(events)) == len(events)
    assert (FOLD, 1.566024489) in events
    cut, rest = branches(soft(0.237, 0.00214, adhesive=False), 0.3212, 0.0723, 1)
    assert max(cut.points[-1].flights) == pytest.approx(max(rest.points[0].flights), abs=0.05)
    assert cut_off([cut]) == []  # the other one goes on


def test_a_closed_branch_is_followed_once_round():
    """The way up ends at a graze, beyond which multipliers are 1e9; the way down passes it."""
    line = branches(rigid(0.7819524271923788), 0.815356973566653, 0.2062226694442393, 2)[0]
    assert line.points[-1] is line.points[0]
    assert sum(event.point.parameter == pytest.approx(2.890535234, abs=1e-7) for event in line.events) == 1


def test_a_branch_stays_on_its_own_where_segments_change():
    stiff = soft(restitution=0.4, penetration=1.1e-6)
    for line in branches(stiff, 0.6412, 0.0564, 2, span=(0.05, 5.0)):
        assert np.abs(np.diff([point.parameter for point in line.points])).max() < LARGEST


@pytest.mark.parametrize(("plate", "omega", "xi"), [(soft(), 0.4673, 0.1094), (rigid(0.0), 0.3443, 0.0518)])
def test_a_doubled_branch_ends_beside_its_last_flip(plate, omega, xi):
    """Of all points that are followed none is nearer to the flip than those on either side of the cut."""
    lines = branches(plate, omega, xi, 1, span=(0.05, 5.0))
    flips = [event.point for line in lines for event in line.events if event.kind is FLIP]
    cuts = 0
    for first in filter(None, map(doubled, flips)):
        line = follow(first, 0.0, span=(0.05, 5.0))
        points, (*kept, end), events = line.points, *up_to_shorter(line)
        if len(kept) < len(points) - 1:
            cuts += 1
            assert events[-1].point is end
            away = min(abs(flip.parameter - end.parameter) for flip in flips)
            assert (away < 1e-9) == (events[-1].kind is FLIP)
            assert doubled(end) is None
            away = [np.abs(point.x[:5] - end.x[:5]).max() for point in points]
            assert min(away[len(kept) - 1 : len(kept) + 1]) == min(away)
    assert cuts > 0


def test_a_doubled_branch_ends_where_newton_leads_to_the_shorter_cycle():
    """A (6,8) branch between two flips of (3,4), the turn at one of which is not located."""
    line = both_ways(attracting(rigid(0.0), Cell(3.29, 0.5, 0.26)), RANGE, 250)
    assert line.points[-1].parameter == pytest.approx(3.7129905954, abs=1e-9)
    assert np.diff(gammas(line, FLIP)).min() > 1e-9
    assert repeats(line.points[-1])


def test_a_doubled_branch_ends_at_the_nearest_flip():
    """Its halves change places 1e-3 from one of two flips of the shorter cycle."""
    line = branches(soft(0.7, 0.043), 0.5802, 0.357, 2)[0]
    flips = [event.point for event in line.events if event.kind is FLIP][-2:]
    for flip in flips:
        line = both_ways(doubled(flip), RANGE, 120)
        ends = sorted(line.points[end].parameter for end in (0, -1))
        assert ends == pytest.approx(sorted(flip.parameter for flip in flips), abs=1e-8)


def test_a_branch_ends_where_a_graze_makes_its_cycle_a_shorter_one():
    """A (3,2) cycle whose halves become equal as one of them grazes; beyond is (1,1), gone through twice."""
    plate, cell = rigid(0.351), Cell(4.885425052692753, 0.9973321908882944, 0.16337752119602011)
    line = both_ways(attracting(plate, cell), (0.05, 8.0), 250)
    assert line.points[-1].parameter == pytest.approx(5.4894685, abs=1e-6)
    assert line.events[-1].kind is Kind.GRAZE_FLIGHT
    assert not any(map(repeats, line.points))


def test_a_branch_does_not_lead_back_where_contacts_are_minute():
    """Contacts appear and vanish within 1e-9 of Gamma. Longer steps beyond lead back to the branch behind."""
    plate = soft(0.072, 3.6618356451136967e-06)
    cell = Cell(4.628632261096017, 1.047840370560438, 0.1163189847899107)
    parameters = [point.parameter for point in follow(attracting(plate, cell), 1.0, points=220).points]
    assert parameters == sorted(parameters)
    assert parameters[-1] > 7.711416


def test_a_branch_does_not_go_round_where_contacts_are_minute():
    """Without one of its contacts, all of 3e-5 rad, a cycle far behind on the branch is the nearest."""
    plate = soft(0.44, 1.16e-5, adhesive=False)
    line = branches(plate, 0.2715, 0.0962, 1, span=(0.05, 3.77), points=260)[1]
    assert np.diff(gammas(line, Kind.GRAZE_FLIGHT)).min() > 1e-9


def test_a_graze_of_a_soft_contact_has_the_multipliers_of_its_neighbours():
    (line,) = branches(soft(), 0.924, 0.075, 1, span=(0.05, 4.0))
    (flip,) = (event.point for event in line.events if event.kind is FLIP)
    _, events = follow(doubled(flip), 0.0, span=(0.05, 4.0))
    (graze,) = (e.point for e in events if abs(e.point.parameter - 1.5668498054773) < 1e-9)
    assert abs(graze.multipliers[0]) == pytest.approx(1.3875, abs=1e-4)


def test_a_landing_that_takes_off_at_once_touches_softly():
    """The two flights of a "z" become one, and the branch goes on to its fold."""
    (line,) = branches(rigid(0.0), 0.3443, 0.0518, 1, span=(0.05, 5.0))
    (graze,) = (event.point for event in line.events if event.kind is Kind.GRAZE_FLIGHT)
    assert graze.parameter == pytest.approx(1.64169414103, abs=1e-9)
    assert gammas(line, FOLD)[0] == pytest.approx(0.86957421370, abs=1e-9)
