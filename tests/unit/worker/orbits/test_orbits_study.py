"""The study `orbits`: its specification, its chunks, and what they store, against the kernel's branches."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from chunks import computed
from tables import for_each

from kernel.cycles.events import Kind, branch_and_events
from kernel.params import Outcome
from worker import studies
from worker.orbits.specification import OrbitsSpec
from worker.orbits.task import _stored_rows
from worker.spec.errors import SpecError

SPEC: dict[str, Any] = {
    "protocol": {"kind": "orbits"}, "omega": [0.5, 0.6, 1.0], "xi": [0.0, 0.05], "points": 60, "events": 8,
}  # fmt: skip


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> xarray.Dataset:
    return computed(str(tmp_path_factory.mktemp("orbits") / "a.zarr"), OrbitsSpec.parse(SPEC))


def test_events_are_those_of_the_kernel_padded_and_counted(stored: xarray.Dataset):
    cell = stored.sel(xi=0.05, omega=0.6)
    names = stored.event_kind.attrs["flag_meanings"].split()
    found = [branch_and_events(0.6, 0.05, k)[1] for k in (1, 2)]
    kind, gamma, periods = (
        np.concatenate([getattr(events, name)[events.gamma <= 8.0] for events in found])
        for name in ("kind", "gamma", "periods")
    )
    assert int(cell.event_count) == len(gamma) > 8 == stored.sizes["event"]
    assert [names[code] for code in cell.event_kind.values] == kind[:8].tolist()
    np.testing.assert_array_equal(cell.event_gamma, gamma[:8])
    np.testing.assert_array_equal(cell.event_periods, periods[:8])
    assert names[1:] == list(Kind)
    few = stored.sel(xi=0.05, omega=1.0)
    n = int(few.event_count)
    if n < 8:
        assert (few.event_kind.values[n:] == 0).all()
        assert np.isnan(few.event_gamma.values[n:]).all()


def test_a_spring_without_branches_is_unresolved(stored: xarray.Dataset):
    assert stored.xi.attrs["long_name"] == "damping ratio of the spring"
    cell = stored.sel(xi=0.0, omega=1.0)
    assert int(cell.outcome) == Outcome.UNRESOLVED
    assert np.isnan(cell.gamma.values).all()
    assert int((stored.outcome == Outcome.PERIODIC).sum()) == 5


@for_each(("changes", "rule"), [
    ({"modes": ["2-2"]}, "modes[0]: must have one bounce"),
    ({"modes": ["1-1", "1-1"]}, "modes: must not name a mode twice"),
    ({"modes": []}, "modes: must be 1 to 6 modes, not 0"),
    ({"points": 5}, "points: must be at least 10, not 5"),
    ({"omega": 0.01}, "omega: must be at least"),
    ({"gamma_max": 0}, "gamma_max: must be above 0"),
    ({"modes": ["1-13"]}, "modes[0]: must have at most 12 periods, not 13"),
])  # fmt: skip
def test_broken_rules_are_named(changes: dict[str, Any], rule: str):
    with pytest.raises(SpecError) as caught:
        studies.parse(SPEC | changes)
    assert rule in str(caught.value)


@pytest.mark.parametrize("points", [5, 7, 10, 40])
def test_thinning_keeps_gaps_and_ends(points: int):
    inside = np.array([True] * 12 + [False] * 5 + [True] * 9)
    kept = _stored_rows(inside, points)
    assert len(kept) <= points
    gaps = np.flatnonzero(kept < 0)
    assert len(gaps) == 1
    rows = kept[kept >= 0]
    assert (rows[0], rows[-1]) == (0, 25)
    assert all(a < b for a, b in itertools.pairwise(rows.tolist()))
    assert inside[rows].all()
    assert kept[gaps[0] - 1] < 12
    assert kept[gaps[0] + 1] > 16


def test_a_branch_of_more_parts_than_points_shows_some_of_them(tmp_path: Path):
    changes = {"omega": 0.04, "xi": 0.0, "modes": ["1-1"], "gamma_max": 1.0}
    few, many = (
        computed(str(tmp_path / f"{points}.zarr"), OrbitsSpec.parse(SPEC | changes | {"points": points}))
        for points in (10, 1000)
    )
    shown, every = (cell.gamma.values[0, 0, 0] for cell in (few, many))
    parts = np.count_nonzero(np.diff(np.isfinite(every).astype(int)) == 1)
    assert parts > few.sizes["point"]
    assert np.isfinite(shown).sum() >= 5
    assert np.isin(shown[np.isfinite(shown)], every).all()
    assert shown[0] == every[0]
