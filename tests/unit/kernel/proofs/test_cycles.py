"""Cycles of settled cells, of every contact: what is proven of them, and what is not."""

import numpy as np
import pytest

pytest.importorskip("flint", reason="needs the extra proofs")

from kernel.branches.cycles import cycle_from
from kernel.branches.starts import start_on_stable_cycle
from kernel.line import run_line
from kernel.models.rigid import plate as rigid
from kernel.models.soft import plate as soft
from kernel.params import Cell, Outcome
from kernel.proofs.balls import NotProvenError
from kernel.proofs.cycles import Law, guess_of, prove_cycle

LAWS = [
    Law(0.0),
    Law(0.3),
    Law(0.01, 1e-3),
    Law(0.3, 1e-2),
    Law(0.01, 1e-3, adhesive=False),
]


def plate_of(law, n=1):
    e = np.full(n, float(law.restitution))
    if law.penetration is None:
        return rigid(restitution=e)
    return soft(restitution=e, penetration=np.full(n, law.penetration), adhesive=law.adhesive)


def settled(law, n=12):
    """Random settled cells: gamma, omega, xi, the cycle, and the flights."""
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
def test_settled_cells_are_proven_to_lie_on_stable_cycles(law):
    proven = 0
    for cell, guess, flights in settled(law):
        cycle = prove_cycle(law, *cell, guess)
        proven += 1
        for time in cycle.flight_times:
            if time > 1e-2:
                assert np.abs(flights - float(time)).min() < 1e-9
    assert proven >= 2


def one(law=LAWS[0]):
    return next(settled(law))


def test_a_cycle_is_not_proven_where_it_is_not():
    cell, guess, _ = one()
    cycle = prove_cycle(LAWS[0], *cell, guess._replace(q=guess.q + 1e-6))
    moved = [t + 1e-6 for t in guess.durations]
    assert not any(ball.contains(t) for ball, t in zip(cycle.durations, moved, strict=True))


def test_a_wrong_word_is_never_proven():
    cell, guess, _ = one()
    for word, durations in (
        (guess.word + guess.word, [*guess.durations, *guess.durations]),
        (guess.word[1:] + guess.word[:1], [*guess.durations[1:], guess.durations[0]]),
    ):
        with pytest.raises(NotProvenError):
            prove_cycle(LAWS[0], *cell, guess._replace(word=word, durations=durations))


def test_below_the_fold_nothing_is_proven():
    law, fold = LAWS[0], 0.553244593224
    start = start_on_stable_cycle(Cell(fold + 1e-4, 0.6, 0.05), 1)
    point = cycle_from(plate_of(law), start.start.cell, 1, start.start.state)
    guess = guess_of(point)
    prove_cycle(law, fold + 1e-4, 0.6, 0.05, guess)
    with pytest.raises(NotProvenError):
        prove_cycle(law, fold - 1e-6, 0.6, 0.05, guess)
