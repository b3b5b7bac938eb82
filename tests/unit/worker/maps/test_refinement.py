"""Adaptive maps: the refinement of a tile, and maps against full grids."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chunks import compute
from studies import spec_of
from tables import for_each

from kernel.params import Outcome
from worker import store
from worker.maps.plan import estimate, make_plan, tile_shape
from worker.maps.refinement import Tile, classes
from worker.spec.errors import SpecInvalid, SpecTooLarge
from worker.spec.refine import MAX_COARSEST, Refine
from worker.study.chunks import check_size
from worker.sweep import SweepSpec, schema
from worker.sweep.schema import MODE_ARRAYS

#: A plane with the threshold, modes, chaos and tongues; rows and columns that no number of blocks fits.
SPACE = spec_of((0.4, 3.4, 52), (0.35, 1.0, 45), 0.05, observe=40, keep=8)
#: Tiles of it, in place of the default ones, which are larger than the plane.
TILE = (1, 17, 17)


def sweep(**changes: Any) -> SweepSpec:
    return SweepSpec(**SPACE | changes)


def plane(spec: SweepSpec, url: Path, shape: tuple[int, ...] | None = TILE) -> dict[str, np.ndarray]:
    """The plane of a map, computed here."""
    compute(url, spec, shape)
    stored = store.read_slice(str(url), [array.name for array in schema.arrays(spec)], complete=True)
    return {name: array[0, 0] for name, array in stored.items()}


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    return plane(sweep(), tmp_path_factory.mktemp("full") / "full.zarr", None)


def island(rows: int, columns: int) -> np.ndarray:
    """Kinds of cells: a disc, a thin tongue from it to the right, and a corner of another kind."""
    row, column = np.ogrid[:rows, :columns]
    kinds = np.ones((rows, columns), np.int64)
    kinds[(row - 9) ** 2 + (column - 7) ** 2 < 23] = 2
    kinds[(row == 9 + (column - 11) // 5) & (column > 11)] = 3
    kinds[row + columns - 1 - column < 4] = 4
    return kinds


#: By, coarsest; rounds and hash.
CHOSEN: list[tuple[str, int, list[Any]]] = [
    ("mode", 8, [[32, 62, 104, 9, 15, 17, 12, 3, 5, 9], "5706371e30db462b"]),
    ("bouncing", 5, [[59, 10, 12, 2], "157fc858dbe73877"]),
]


@for_each(("by", "coarsest", "expected"), CHOSEN)
def test_the_same_tile_is_always_refined_the_same_way(by: str, coarsest: int, expected: list):
    """Stored maps depend on it: rounds, computed cells, and a hash of all cells' sources."""
    kinds = island(21, 27)
    outcomes = np.array([0, Outcome.PERIODIC, Outcome.APERIODIC, Outcome.SETTLING, Outcome.AT_REST])[kinds]
    tile = Tile((21, 27), Refine(by=by, coarsest=coarsest))
    rounds = []
    while tile.cells.size:
        rounds.append(len(tile.cells))
        tile.split(outcomes, kinds, kinds % 2 + 1)
    sources = tile.sources().astype("<i8")
    assert [rounds, hashlib.sha256(sources.tobytes()).hexdigest()[:16]] == expected


@pytest.mark.parametrize("by", ["mode", "bouncing"])
def test_computed_cells_are_those_of_the_full_grid(full, tmp_path, by):
    refine = Refine(by=by, coarsest=8)
    found = plane(sweep(refine=refine), tmp_path / "a.zarr")
    computed = found["computed"] == 1
    assert 0.05 < computed.mean() < 0.9
    for name, array in full.items():
        assert array[computed].tobytes() == found[name][computed].tobytes(), name
    assert np.isnan(found["flight_time"][~computed]).all()
    assert not found["flights"][~computed].any()
    kinds = [classes(refine, *(cells[name] for name in MODE_ARRAYS)) for cells in (full, found)]
    assert np.mean(kinds[0] != kinds[1]) < (0.015 if by == "mode" else 0.001)
    for outcome in Outcome:
        shares = [np.mean(cells["outcome"] == outcome) for cells in (full, found)]
        assert by == "bouncing" or abs(shares[0] - shares[1]) < 0.01, outcome


@for_each(("refine", "field", "rule"), [
    ({}, "refine.by", "is required"),
    ({"by": "flights"}, "refine.by", "'mode' or 'bouncing'"),
    ({"by": "mode", "coarsest": MAX_COARSEST + 1}, "refine.coarsest", f"at most {MAX_COARSEST}"),
    ({"by": "mode", "coarsest": 8.5}, "refine.coarsest", "8 or 9"),
    ({"by": "mode", "margin": 1}, "refine.margin", "true or false"),
    ({"by": "mode", "margin": True}, "refine.margin", "a coarsest of 8"),
    ({"by": "mode", "coarse": 8}, "refine.coarse", "did you mean 'coarsest'"),
    ("mode", "refine", "group of fields"),
])  # fmt: skip
def test_bad_refinements_name_the_field_and_the_rule(refine, field, rule):
    with pytest.raises(SpecInvalid) as caught:
        sweep(refine=refine)
    [problem] = caught.value.problems
    assert problem.field == field
    assert rule in problem.rule
    with pytest.raises(SpecInvalid, match="rest"):
        sweep(refine={"by": "mode"}, protocol={"kind": "ramp", "axis": "gamma", "direction": "up"})


@for_each(("keep", "coarsest", "side"), [
    (1, 2, 129), (1, 3, 127), (1, 16, 129), (200, 2, 79), (200, 16, 65), (200, 128, 80), (1000, 3, 34),
    (1000, 64, 36),
])  # fmt: skip
def test_the_tiles_of_an_adaptive_map(keep, coarsest, side):
    """What is computed of a map depends on them: a map in other tiles is another one."""
    axes = {axis: {"start": 1.0, "stop": 2.0, "num": 300} for axis in ("omega", "gamma")}
    spec = sweep(**axes, xi=[0.05, 0.1], keep=keep, refine={"by": "mode", "coarsest": coarsest})
    assert tile_shape(spec, coarsest) == make_plan(spec).chunk_shape == (1, side, side)


def test_the_estimate_is_a_range_and_limits_hold_its_upper_end():
    spec = sweep(
        omega={"start": 0.2, "stop": 1.2, "num": 10_000}, gamma={"start": 0.9, "stop": 6, "num": 10_000},
        keep=64, refine={"by": "mode"},
    )  # fmt: skip
    cost = estimate(spec, make_plan(spec))
    low, high = cost.computed_cells
    assert cost.cells == 10**8
    assert 10**5 < low < high < 10**7
    assert 0 < cost.least_core_seconds < cost.core_seconds
    assert cost.core_seconds < cost.longest_core_seconds  # all computed cells may settle until the end
    check_size(cost)
    with pytest.raises(SpecTooLarge, match=f"{high:,} computed cells"):
        check_size(cost, max_cells=high - 1)
