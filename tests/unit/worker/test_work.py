"""What the tasks of all studies share."""

from typing import Any

import pytest

from kernel import line
from worker.sweep import SweepSpec
from worker.sweep.task import run_cells
from worker.work import compile_for


@pytest.mark.parametrize("fields", [{}, {"settle": 20}], ids=["auto", "fixed"])
def test_no_cell_compiles_a_kernel_that_was_not_compiled_ahead(fields: dict[str, Any]) -> None:
    spec = SweepSpec(gamma=2.0, omega=0.5, xi=0.26, model={"kind": "rigid"}, **fields)
    compile_for(spec)
    compiled = list(line._walk.entry.signatures)
    run_cells(spec, [spec.axis_values(axis) for axis in ("gamma", "omega", "xi")], None)
    assert line._walk.entry.signatures == compiled
