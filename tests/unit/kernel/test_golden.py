"""Reference numbers, each with where it comes from (tests/golden)."""

import json

import pytest
from kernel_runs import Model, last_cycle, run
from paths import GOLDEN
from tables import for_each

from kernel.params import Outcome


def read(name: str):
    return json.loads((GOLDEN / name).read_text())


FACTS = read("facts.json")


@for_each("cell", read("rigid.json"))
def test_rigid_reference(cell):
    line = run(cell["gamma"], cell["omega"], cell["xi"], settle=500, observe=40)
    assert line.outcome[0] == Outcome.PERIODIC
    assert line.bounces[0] == cell["bounces"] == len(cell["flights"])
    assert last_cycle(line, line.bounces[0]) == pytest.approx(cell["flights"], abs=1e-9)


@for_each("cell", read("soft.json"))
def test_soft_reference(cell):
    contact = {name: cell[name] for name in ("restitution", "penetration", "adhesive")}
    line = run(cell["gamma"], cell["omega"], cell["xi"], Model.SOFT, **contact, settle=500, observe=40)
    assert line.outcome[0] == Outcome.PERIODIC
    assert line.bounces[0] == cell["bounces"] == len(cell["flights"])
    assert last_cycle(line, line.bounces[0]) == pytest.approx(cell["flights"], abs=1e-8)


@for_each("cell", FACTS["cycles"])
def test_the_papers_cycles(cell):
    line = run(cell["gamma"], cell["omega"], cell["xi"], settle=500, observe=40)
    assert [line.bounces[0], line.periods[0]] == cell["mode"]
    expected = Outcome.PERIODIC if cell["flights"] else Outcome.APERIODIC
    assert line.outcome[0] == expected
    if cell["flights"]:
        assert last_cycle(line, line.bounces[0]) == pytest.approx(cell["flights"], abs=1e-9)
