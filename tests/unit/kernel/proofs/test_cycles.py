"""Cycles of every contact: what is proven of them, and what is not."""

import json

import numpy as np
import pytest
from paths import GOLDEN

pytest.importorskip("flint", reason="needs the extra proofs")

from kernel.cycles.cycles import cycle_from
from kernel.cycles.descent import cycle_of
from kernel.cycles.events import branch, flight_times
from kernel.cycles.folds import Cycle, one_flight
from kernel.cycles.spring import spring
from kernel.line import run_line
from kernel.models.rigid import plate as rigid
from kernel.models.soft import plate as soft
from kernel.params import Cell, Outcome
from kernel.proofs import balls
from kernel.proofs.balls import NotProvenError, bounds
from kernel.proofs.cycles import Law, prove_cycle

LAWS = [Law(0.0), Law(0.3), Law(0.01, 1e-3), Law(0.3, 1e-2), Law(0.01, 1e-3, adhesive=False)]
FLOQUET = json.loads((GOLDEN / "branches.json").read_text())["floquet"]
#: A spring, a Gamma just above its fold, and the flight time of the stable cycle there.
CELL, FOLD = Cell(0.5533, 0.6, 0.05), 0.553244593224092931


def plate_of(law, n=1):
    e = np.full(n, float(law.restitution))
    if law.penetration is None:
        return rigid(restitution=e)
    return soft(restitution=e, penetration=np.full(n, law.penetration), adhesive=law.adhesive)


def settled(law, n=12):
    """Random certified cells: gamma, omega, xi, the cycle, and the flights."""
    random = np.random.default_rng(5)
    gamma = random.uniform(0.5, 5.0, n)
    omega, xi = np.exp(random.uniform(np.log(0.2), np.log(2.0), n)), np.exp(random.uniform(-3.5, 0.0, n))
    line = run_line(gamma, omega, xi, plate=plate_of(law, n), carry=False, settle=2000, observe=50, keep=64)
    for i in np.flatnonzero((line.outcome == Outcome.PERIODIC) & (line.periods <= 2)):
        cell = Cell(float(gamma[i]), float(omega[i]), float(xi[i]))
        point = cycle_from(plate_of(law), cell, int(line.periods[i]), line.end_state[i])
        if point is not None:
            takes_off = point.begun((point.letters.find("S") + 1) % len(point.letters))
            yield cell, cycle_of(takes_off), line.flight_time[i, : min(line.flights[i], 64)]


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_cells_that_settled_are_proven_to_lie_on_stable_cycles(law):
    proven = 0
    for cell, guess, flights in settled(law):
        proof = prove_cycle(law, cell, guess)
        proven += 1
        for time in proof.flight_times:
            if time > 1e-2:
                off = np.abs(flights - float(time)).min()
                assert off < 1e-9, f"no flight of {cell} lasts {bounds(time)}: {flights}"
    assert proven >= 2


def on_branch(gamma, omega, xi, periods, time):
    cycle = one_flight(spring(omega, xi), periods, float(time))
    return prove_cycle(Law(), Cell(float(gamma), omega, xi), cycle)


def test_golden_verdicts_are_proven():
    for case in FLOQUET:
        spring, time = (case["omega"], case["xi"], case["mode"][1]), case["flight_time"]
        if case["stable"]:
            proof = on_branch(case["gamma"], *spring, time)
            assert abs(proof.flight_times[0] - time) < 1e-9, f"{time} is not {bounds(proof.flight_times[0])}"
        else:
            with pytest.raises(NotProvenError):
                on_branch(case["gamma"], *spring, time)


def test_only_stable_admissible_cycles_of_a_branch_are_proven():
    """Others are disproven where they break their conditions."""
    for omega, xi, periods in ((0.6, 0.05, 1), (0.41, 0.07, 1), (0.9, 0.2, 2)):
        line = branch(omega, xi, periods, flight_times(omega, xi, periods, 40)[5::12])
        for gamma, time, stable, reason in zip(
            line.gamma, line.flight_time, line.stable, line.violations, strict=True
        ):
            if stable and not reason:
                on_branch(gamma, omega, xi, periods, time)
                continue
            with pytest.raises(NotProvenError) as why:
                on_branch(gamma, omega, xi, periods, time)
            assert why.value.verdict == ("disproven" if reason else "not proven")


def just_above_the_fold():
    line = branch(CELL.omega, CELL.xi, 1, np.linspace(4.17, 4.22, 20001))
    i = np.argmin(np.where(line.stable, np.abs(line.gamma - CELL.gamma), np.inf))
    cell = CELL._replace(gamma=float(line.gamma[i]))
    return cell, one_flight(spring(CELL.omega, CELL.xi), 1, float(line.flight_time[i]))


def chattering():
    """A cell with e = 0.3 whose mass chatters and then sticks, its cycle begun where it takes off."""
    return min(
        (each[:2] for each in settled(LAWS[1]) if "c" in each[1].letters), key=lambda x: len(x[1].letters)
    )


@pytest.mark.parametrize("adhesive", [True, False])
def test_a_cycle_of_many_contacts_is_proven_at_the_first_precision(adhesive, monkeypatch):
    monkeypatch.setattr(balls, "PRECISIONS", balls.PRECISIONS[:1])
    law, cell = Law(0.8, 1e-6, adhesive=adhesive), Cell(0.8, 1.0, 0.26)
    line = run_line(
        *map(np.atleast_1d, cell), plate=plate_of(law), carry=False, settle=500, observe=50, keep=64
    )
    cycle = cycle_of(cycle_from(plate_of(law), cell, 1, line.end_state[0]))
    assert len(cycle.letters) > 50
    prove_cycle(law, cell, cycle)


def test_a_cycle_of_too_many_contacts_is_not_covered():
    cycle = Cycle("FC" * 300, 1, np.ones(605))
    with pytest.raises(NotProvenError, match="a cycle of 600 contacts and flights; proofs take") as why:
        prove_cycle(Law(0.97, 1e-6), CELL, cycle)
    assert why.value.verdict == "not covered"


@pytest.mark.parametrize("chatters", [False, True])
def test_a_cycle_that_is_moved_is_not_proven(chatters):
    """Not in its start, nor in any duration, such as that of a contact in which a chatter ends."""
    law, (cell, cycle) = (LAWS[1], chattering()) if chatters else (LAWS[0], just_above_the_fold())
    prove_cycle(law, cell, cycle)
    for i in (-1,) if chatters else range(len(cycle.unknowns)):
        moved = cycle.unknowns.copy()
        moved[i] += 1e-6
        with pytest.raises(NotProvenError):
            prove_cycle(law, cell, cycle._replace(unknowns=moved))


def test_a_wrong_word_is_never_proven():
    """Nor where landings do not end as it says: only without restitution does s stick at once."""
    cell, cycle = just_above_the_fold()
    start, times = cycle.unknowns[:5], cycle.unknowns[5:]
    wrong = [(Law(), word, times) for word in ("zs", "Sh", "Sc", "CF")]
    wrong += [(Law(), "SsSs", [*times, *times]), (Law(), "sS", times[::-1])]
    wrong += [(Law(0.3), word, times) for word in ("Ss", "Sh")]
    for law, word, durations in wrong:
        with pytest.raises(NotProvenError):
            prove_cycle(law, cell, cycle._replace(letters=word, unknowns=np.array([*start, *durations])))


def test_a_word_begins_where_the_gap_is_zero():
    """Without adhesion a mass takes off below the surface."""
    law = LAWS[-1]
    cell, cycle, _ = next(each for each in settled(law) if each[1].letters == "CF")
    for letters, unknowns in (("FC", cycle.unknowns), ("FC", cycle.unknowns[[0, 1, 2, 3, 4, 6, 5]])):
        with pytest.raises(NotProvenError, match="no motion has the word FC"):
            prove_cycle(law, cell, cycle._replace(letters=letters, unknowns=unknowns))


def test_below_the_fold_nothing_is_proven():
    cell, cycle = just_above_the_fold()
    for below in (1e-4, 1e-6, 1e-9, 1e-15):
        with pytest.raises(NotProvenError):
            prove_cycle(Law(), cell._replace(gamma=FOLD - below), cycle)
