"""Multistability: the attractors that drops find, followed along gamma, however the work is cut."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import paths
import pytest
from chunks import computed
from studies import spec_of

from kernel.cycles.events import Kind, fold_events
from kernel.params import Outcome
from worker.basins.specification import MultistabilitySpec
from worker.spec.errors import SpecTooLarge
from worker.studies import STUDIES, parse

GOLDEN = json.loads((paths.GOLDEN / "multistability.json").read_text())

SPEC = spec_of([3.4, 3.6, 3.8], [0.5, 0.52], 0.26, protocol={"kind": "multistability"}, window=(300, 60))


def multistability(**fields: Any) -> MultistabilitySpec:
    protocol = {name: fields.pop(name) for name in ("plane", "rows", "columns", "height") if name in fields}
    return MultistabilitySpec.parse(SPEC | fields | {"protocol": SPEC["protocol"] | protocol})


@pytest.mark.parametrize("reference", GOLDEN["maps"], ids=lambda reference: f"xi {reference['xi']}")
def test_shares_of_cells_with_several_attractors(tmp_path: Path, reference: dict[str, Any]):
    """Every fourth value of the maps of 40 by 40 cells; the reference is the share of the whole maps."""
    gamma, omega = (np.linspace(*reference[axis], 40)[::4].tolist() for axis in ("gamma", "omega"))
    spec = multistability(gamma=gamma, omega=omega, xi=reference["xi"], settle=800, observe=150)
    data = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0)
    assert float((data.attractor_count >= 2).mean()) == pytest.approx(reference["share"], abs=0.02)
    rows = ["".join(map(str, row)) for row in data.attractor_count.values]
    assert rows == reference["counts"]
    assert float((data.fraction.sum("id") + data.undecided).max()) == pytest.approx(1.0)


@pytest.mark.parametrize("kind", ["basin", "multistability"])
def test_chatter_hides_no_flight_of_a_cycle(tmp_path: Path, kind: str):
    """Hundreds of hops follow each landing. The flights are those of 10,000 kept ones of each cycle."""
    protocol, model = {"kind": kind, "rows": 3, "columns": 6}, {"kind": "rigid", "restitution": 0.99}
    data = spec_of(1.0, 0.0792, 0.01, protocol=protocol, window=(300, 60), settle_until=1000, model=model)
    cell = computed(str(tmp_path / "a.zarr"), parse(data)).squeeze()
    assert cell.bounces.values[:4].tolist() == [8, 2, 3, 6]
    assert cell.longest_flight.values[:4] == pytest.approx([0.526457, 12.39129, 0.354193, 14.83418], abs=1e-5)


def test_hops_hide_no_long_cycle(tmp_path: Path):
    """The cycle of 48 flights that count has 44 hops, in which it is sought too."""
    model = {"kind": "rigid", "restitution": 0.3}
    fields = {"gamma": 1.25, "omega": 0.62, "xi": 0.05, "model": model, "settle": 800, "observe": 150}
    cell = computed(str(tmp_path / "a.zarr"), multistability(**fields, rows=1, columns=2)).squeeze()
    assert (int(cell.attractor_count), int(cell.bounces[0]), int(cell.periods[0])) == (1, 48, 16)


def test_a_cycle_ends_within_one_step_of_its_fold(tmp_path: Path):
    """(1,1) at omega 0.6, xi 0.05 begins in a fold at gamma 0.5532, beside rest."""
    events = fold_events(0.6, 0.05, 1, 1.0)
    folds = events.gamma[(events.kind == Kind.FOLD) & (events.violations == 0)]
    gamma = np.linspace(0.5, 0.62, 13)
    spec = multistability(gamma=gamma.tolist(), omega=0.6, xi=0.05, settle=1500)
    line = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0, omega=0)
    bouncing = np.array([(line.bounces[j] == 1).any() for j in range(len(gamma))])
    first = int(np.argmax(bouncing))
    assert bouncing[first:].all()
    assert gamma[first - 1] < folds.min() <= gamma[first]
    cell = line.isel(gamma=first)
    bounce, rest = (
        int(np.argmax(cell.attractor_outcome.values == o)) for o in (Outcome.PERIODIC, Outcome.AT_REST)
    )
    assert int(cell.next_down[bounce]) == int(cell.next_down[rest]) != 0
    below = line.isel(gamma=first - 1)
    assert int(below.attractor_outcome[int(cell.next_down[bounce]) - 1]) == Outcome.AT_REST


def test_an_attractor_that_no_drop_reaches_is_found_by_following(tmp_path: Path):
    """One drop a cell reaches one attractor; the neighbours' attractors seed the others."""
    spec = multistability(gamma=[3.5, 3.6, 3.7, 3.8], omega=0.5, rows=1, columns=1, height=3.0)
    line = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0, omega=0)
    assert (line.fraction.isel(id=0) == 1.0).all()
    followed = line.isel(gamma=1)
    assert int(followed.attractor_count) == 2
    assert float(followed.fraction[1]) == 0.0
    modes = {(int(followed.bounces[k]), int(followed.periods[k])) for k in range(2)}
    assert modes == {(3, 4), (1, 2)}


def test_a_chaotic_transient_is_followed_to_its_cycle_and_undecided_where_it_outlives_until(tmp_path: Path):
    """All drops end on a cycle of 14 flights; after 1,900 plate periods one of 24 is still chaotic."""
    cell: dict[str, Any] = {"gamma": 4.0, "omega": 0.6, "settle": 800, "observe": 150}
    found = computed(str(tmp_path / "a.zarr"), multistability(**cell)).squeeze(drop=True)
    assert (int(found.attractor_count), float(found.undecided)) == (1, 0.0)
    assert (int(found.bounces[0]), float(found.fraction[0])) == (14, 1.0)
    short = multistability(**cell | {"settle": 300, "settle_until": 600}, rows=20, columns=20)
    cut = computed(str(tmp_path / "b.zarr"), short).squeeze(drop=True)
    assert int(cut.attractor_count) == 1
    assert 0.0 < float(cut.undecided) < 0.5
    assert float(cut.undecided + cut.fraction[0]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("columns", "undecided", "outcome"), [(1, 1.0, Outcome.UNRESOLVED), (2, 0.5, Outcome.PERIODIC)]
)
def test_drops_that_still_settle_are_undecided(
    tmp_path: Path, columns: int, undecided: float, outcome: Outcome
):
    """Without a single attractor the cell is unresolved."""
    spec = multistability(
        gamma=[2.3], omega=0.5, rows=1, columns=columns, settle=3, observe=10, settle_until=23
    )
    cell = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0, omega=0, gamma=0)
    assert (float(cell.undecided), int(cell.outcome)) == (undecided, outcome)
    assert int(cell.attractor_count) == columns - 1


def test_lines_are_not_cut_and_one_too_long_for_a_chunk_is_refused_with_the_number_that_is_not():
    with pytest.raises(ValueError, match="must span the 3 values of gamma, not 2"):
        STUDIES["multistability"].plan(multistability(), (1, 1, 2))
    line = multistability(gamma={"start": 1, "stop": 2, "num": 100_000})
    with pytest.raises(SpecTooLarge, match=r"takes 266,100,000 bytes.* take at most 25,219 values") as caught:
        STUDIES["multistability"].plan(line)
    assert caught.value.problems[0].field == "gamma"
    plan = STUDIES["multistability"].plan(multistability(gamma={"start": 1, "stop": 2, "num": 25_219}))
    assert plan.chunk_shape == (1, 1, 25_219)
