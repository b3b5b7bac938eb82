"""What the tasks of all studies share: no division of the work changes what is stored."""

from typing import Any

import pytest
from chunks import computed, cut_finely, planned, run_in_slices
from scripted import small
from stores import files
from studies import spec_of

from kernel import line
from worker.studies import parse, run_task
from worker.sweep import SweepSpec
from worker.sweep.task import run_cells
from worker.work import compile_for

DROPS = {"kind": "basin", "rows": 9, "columns": 8, "height": 10.0}
BASINS = spec_of([1.1, 1.27, 3.6], 0.5, [0.1, 0.26], protocol=DROPS, settle=200)
SEVERAL = spec_of([3.4, 3.6, 3.8], [0.5, 0.52], 0.26, protocol={"kind": "multistability"}, window=(300, 60))
ORBITS = {
    "protocol": {"kind": "orbits"}, "omega": [0.5, 0.6, 1.0], "xi": [0.0, 0.05], "points": 60, "events": 8,
}  # fmt: skip
MAP = spec_of(
    (0.4, 3.4, 52), (0.35, 0.7, 20), 0.05, observe=40, keep=8, until=300, refine={"by": "mode", "coarsest": 8}
)


@pytest.mark.parametrize("fields", [{}, {"settle": 20}], ids=["auto", "fixed"])
def test_no_cell_compiles_a_kernel_that_was_not_compiled_ahead(fields: dict[str, Any]) -> None:
    spec = SweepSpec(gamma=2.0, omega=0.5, xi=0.26, model={"kind": "rigid"}, **fields)
    compile_for(spec)
    compiled = list(line._walk.entry.signatures)
    run_cells(spec, [spec.axis_values(axis) for axis in ("gamma", "omega", "xi")], None)
    assert line._walk.entry.signatures == compiled


@pytest.mark.parametrize(("spec", "shapes"), [
    (BASINS, [(1, 1, 1), (2, 1, 2)]),
    (SEVERAL, [(1, 1, 3), (1, 2, 3)]),
    (ORBITS, [(1, 1), (2, 2)]),
], ids=["basins", "multistability", "orbits"])  # fmt: skip
def test_chunks_do_not_change_what_is_stored(tmp_path, spec, shapes):
    whole, *others = (
        computed(tmp_path / f"{i}.zarr", parse(spec), shape) for i, shape in enumerate([None, *shapes])
    )
    for other in others:
        for name, array in whole.data_vars.items():
            assert other[name].values.tobytes() == array.values.tobytes(), name


def ramp(axis, direction):
    return {"kind": "ramp", "axis": axis, "direction": direction}


#: Studies, steps between two pauses, so few that every chunk pauses within lines, and shapes of chunks.
PAUSING = {
    "in lanes": (small(model={"kind": "rigid"}), 2003, None),
    "soft ramp in lanes": (small(model={"kind": "soft"}, protocol=ramp("gamma", "both")), 8009, None),
    "settling": (small(model={"kind": "soft"}, settle="auto"), 2003, None),
    "exponents": (small(model={"kind": "soft"}, protocol=ramp("omega", "down"), exponents=2), 401, None),
    "stepped": (small(model={"kind": "stepped"}, protocol=ramp("xi", "up")), 211, None),
    "map": (parse(MAP), 16_384, (1, 17, 17)),
}


@pytest.mark.parametrize(("spec", "steps", "shape"), PAUSING.values(), ids=PAUSING.keys())
def test_a_chunk_that_pauses_stores_the_same_bytes(tmp_path, monkeypatch, spec, steps, shape):
    url, whole = str(tmp_path / "paused.zarr"), str(tmp_path / "whole.zarr")
    expected = [run_task(spec, chunk, whole) for chunk in planned(whole, spec, shape)]
    cut_finely(monkeypatch, steps)
    paused = 0
    for chunk, at_once in zip(planned(url, spec, shape), expected, strict=True):
        report, pauses = run_in_slices(spec, chunk, url)
        assert report.outcomes == at_once.outcomes
        paused += pauses
        assert 0 < report.kernel_seconds < report.seconds
    assert paused > len(expected)
    assert files(url) == files(whole)
