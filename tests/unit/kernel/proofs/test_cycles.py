"""Cycles of every contact: what is proven of them, and what is not."""

import json

import numpy as np
import pytest
from paths import GOLDEN

pytest.importorskip("flint", reason="needs the extra proofs")

from kernel.cycles.cycles import cycle_from
from kernel.cycles.events import branch, flight_times
from kernel.cycles.folds import one_flight
from kernel.cycles.spring import spring
from kernel.line import run_line
from kernel.models.rigid import plate as rigid
from kernel.models.soft import plate as soft
from kernel.params import Cell, Outcome
from kernel.proofs.balls import DisprovenError, NotProvenError, bounds
from kernel.proofs.branches import guess_of_cycle
from kernel.proofs.cycles import Law, guess_of, prove_cycle

LAWS = [
    Law(0.0),
    Law(0.3),
    Law(0.01, 1e-3),
    Law(0.3, 1e-2),
    Law(0.01, 1e-3, adhesive=False),
]
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
            yield cell, guess_of(point), line.flight_time[i, : min(line.flights[i], 64)]


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_cells_that_settled_are_proven_to_lie_on_stable_cycles(law):
    proven = 0
    for cell, guess, flights in settled(law):
        proof = prove_cycle(law, *cell, guess)
        proven += 1
        for time in proof.flight_times:
            if time > 1e-2:
                off = np.abs(flights - float(time)).min()
                assert off < 1e-9, f"no flight of {cell} lasts {bounds(time)}: {flights}"
    assert proven >= 2


def on_branch(gamma, omega, xi, periods, time):
    return prove_cycle(Law(), gamma, omega, xi, guess_of_cycle(one_flight(spring(omega, xi), periods, time)))


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
                on_branch(float(gamma), omega, xi, periods, float(time))
                continue
            with pytest.raises(DisprovenError if reason else NotProvenError):
                on_branch(float(gamma), omega, xi, periods, float(time))


def just_above_the_fold():
    line = branch(CELL.omega, CELL.xi, 1, np.linspace(4.17, 4.22, 20001))
    i = np.argmin(np.where(line.stable, np.abs(line.gamma - CELL.gamma), np.inf))
    return float(line.gamma[i]), guess_of_cycle(
        one_flight(spring(CELL.omega, CELL.xi), 1, float(line.flight_time[i]))
    )


def test_a_cycle_that_is_moved_is_not_proven():
    gamma, guess = just_above_the_fold()
    prove_cycle(Law(), gamma, CELL.omega, CELL.xi, guess)
    for i in range(1, len(guess.unknowns)):
        unknowns = list(guess.unknowns)
        unknowns[i] += 1e-6
        with pytest.raises(NotProvenError):
            prove_cycle(Law(), gamma, CELL.omega, CELL.xi, guess._replace(unknowns=unknowns))


def test_a_wrong_word_is_never_proven():
    gamma, guess = just_above_the_fold()
    start, times = guess.unknowns[:5], guess.unknowns[5:]
    for word, durations in (
        ("SsSs", 2 * times),
        ("sS", times[::-1]),
        ("Sz", times),
        ("zs", times),
        ("ss", times),
    ):
        with pytest.raises(NotProvenError):
            prove_cycle(
                Law(), gamma, CELL.omega, CELL.xi, guess._replace(word=word, unknowns=[*start, *durations])
            )


def test_below_the_fold_nothing_is_proven():
    _, guess = just_above_the_fold()
    for below in (1e-4, 1e-6, 1e-9, 1e-15):
        with pytest.raises(NotProvenError):
            prove_cycle(Law(), FOLD - below, CELL.omega, CELL.xi, guess)
