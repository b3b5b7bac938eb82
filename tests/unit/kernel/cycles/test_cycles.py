"""Cycles of any contact read from simulated cells, and their multipliers."""

import numpy as np
import pytest
from contacts import rigid, soft
from kernel_runs import run
from plates import Model

from kernel.cycles.any_contact import branches
from kernel.cycles.cycles import LANDINGS, confirmed, cycle_from, cycle_through
from kernel.cycles.events import Kind
from kernel.params import Cell, Outcome

CONTACTS = [rigid(0.0), rigid(0.3), soft(), soft(penetration=1e-2), soft(adhesive=False)]


@pytest.mark.parametrize("plate", CONTACTS)
def test_every_periodic_cell_leads_to_its_cycle(plate):
    """From its end state, by one round of the kernel; flights are those recorded."""
    rng = np.random.default_rng(7)
    gamma, omega = rng.uniform(0.5, 4.0, 24), rng.uniform(0.4, 1.2, 24)
    which = Model.SOFT if hasattr(plate, "penetration") else Model.RIGID
    contact = {"restitution": plate.restitution[0]}
    if which is Model.SOFT:
        contact |= {"penetration": plate.penetration[0], "adhesive": plate.adhesive}
    line = run(gamma, omega, 0.1, which, settle=600, observe=40, **contact)
    cells = np.flatnonzero((line.outcome == Outcome.PERIODIC) & (line.bounces > 0) & (line.periods <= 8))
    assert len(cells) > 8
    for i in cells:
        cell = Cell(float(gamma[i]), float(omega[i]), 0.1)
        point = cycle_from(plate, cell, int(line.periods[i]), line.end_state[i])
        assert point is not None, i
        assert point.cell == pytest.approx(cell, abs=1e-13)
        assert np.abs(point.multipliers[0]) < 1.0
        longest = max(t for t, x in zip(point.times, point.letters, strict=True) if x in LANDINGS)
        assert np.nanmin(np.abs(line.flight_time[i] - longest)) < 1e-6


def test_a_cycle_of_one_hop_is_read():
    """A flight of a whole plate period that is never stuck."""
    line = run(4.4119, 0.78278, 0.14213, Model.RIGID, settle=3000, observe=40, restitution=0.7)
    point = cycle_from(rigid(0.7), Cell(4.4119, 0.78278, 0.14213), 1, line.end_state[0])
    assert (point.letters, point.times[0]) == ("h", pytest.approx(2.0 * np.pi, abs=1e-12))


def test_a_cycle_on_a_graze_is_one_through_its_state():
    """Two of its flights last 5e-11 and 2e-8 rad; those of the kernel differ by more."""
    cell = Cell(2.0131101385537593, 0.822, 0.0828)
    state = np.array([2.1283627157435157, 1.0, 0.0, 3.282e-26, 0.5770979446368222, 0.8526369321791816])
    assert cycle_through(rigid(0.049), cell, 2, state).letters == "cShhcSh"
    state[4] += 1e-4
    assert cycle_through(rigid(0.049), cell, 2, state) is None


@pytest.mark.parametrize("plate", [rigid(0.3), rigid(0.7), rigid(0.9), soft()])
def test_multipliers_do_not_depend_on_where_the_cycle_begins(plate):
    """A second section of the same cycle, where its map is another product of the same motions."""
    compared = 0
    for point in branches(plate, 0.60, 0.05, 1, span=(0.05, 3.0))[-1].points[::12]:
        landings = [j for j in range(1, len(point.letters)) if point.letters[j - 1] in LANDINGS]
        if landings and max(point.flights) > 0.05:
            known, other = point.multipliers[:2], point.begun(landings[0]).multipliers[:2]
            assert other == pytest.approx(known, abs=1e-9 * max(1.0, np.abs(known[0]))), point.letters
            compared += 1
    assert compared > 3


def test_a_solution_that_passes_through_the_plate_is_no_cycle():
    """The family of two hops at e = 0.9, followed beyond where its flight touches the plate."""
    changes = (x.point for x in branches(rigid(0.9), 0.60, 0.05, 1)[-1].events if x.kind is Kind.GRAZE_FLIGHT)
    before = next(point for point in changes if point.letters == "hh")
    beyond = [
        before.cycles.newton(before.x + step * before.tangent, before.tangent) for step in (-1e-3, 1e-3)
    ]
    reasons = [confirmed(point)[1] for point in beyond]
    assert [reason.reason for reason in reasons if reason is not None] in (["touches"], ["lands softly"])
