"""The measured cost and accuracy of contact models: cells, references, and the order of the models."""

import json
import re
from typing import Any

import pytest
from paths import GOLDEN
from tables import for_each

from worker.analysis.work_precision import (
    CELLS_PER_LINE,
    LINES,
    LOCKED,
    SETUPS,
    Setup,
    _cells,
    _is_stable,
    measure,
)
from worker.spec import SpecError, SweepSpec


def test_what_is_measured_is_the_published_table():
    rows = json.loads((GOLDEN / "tradeoff_rows.json").read_text())["rows"]
    assert [Setup(**{name: row[name] for name in Setup.model_fields}) for row in rows] == list(SETUPS)


@for_each(
    ("scheme", "restitution", "adhesive"),
    [
        ("verlet", 0.01, True),
        ("verlet", 0.6, True),
        ("euler", 0.01, True),
        ("euler", 0.01, False),
        ("euler", 0.6, True),
    ],
)
def test_steps_are_refused_as_a_specification_refuses_them(scheme: Any, restitution: float, adhesive: bool):
    cells = _cells(LINES[LOCKED])
    model = {"restitution": restitution, "penetration": 0.1, "adhesive": adhesive, "scheme": scheme}
    setup = Setup(purpose="adhesive", model="stepped", steps_per_contact=1, **model)
    axes = {name: getattr(cells, name).tolist() for name in ("gamma", "omega", "xi")}
    axes |= {name: axes[name][0] for name in ("omega", "xi")}
    with pytest.raises(SpecError, match="must be at least") as caught:
        SweepSpec(**axes, model={"kind": "stepped", "steps_per_contact": 1, **model})
    fewest = int(re.findall(r"at least (\d+), not 1", str(caught.value))[0])
    for steps, stable in ((fewest - 1, False), (fewest, True)):
        assert _is_stable(setup.model_copy(update={"steps_per_contact": steps}), cells) is stable


def test_steps_that_a_specification_would_refuse_are_counted_not_computed():
    """Euler with 20 steps in a contact of d = 0.1: too long for the dashpot that locks, and for it alone."""
    deep = Setup(purpose="adhesive", model="stepped", restitution=0.01, penetration=0.1, scheme="euler")
    some = measure(deep.model_copy(update={"steps_per_contact": 20}))
    assert some.refused == CELLS_PER_LINE / (len(LINES) * CELLS_PER_LINE)
    none = measure(deep.model_copy(update={"steps_per_contact": 1}))
    assert (none.refused, none.cells, none.cost, none.error) == (1.0, 0, None, None)
    assert (none.agree, none.unresolved) == (0.0, 0.0)
