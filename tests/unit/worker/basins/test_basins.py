"""Basins: their specification, the attractors that are told apart, and what is stored, however it is cut."""

import itertools
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import paths
import pytest
import xarray
from chunks import computed, cut_finely, planned
from tables import for_each

from kernel.line import LineRun
from kernel.params import STATE_FIELDS, Line, Outcome
from worker import store, work
from worker.basins.attractors import Attractor, Found, Request, find
from worker.basins.schema import MAX_ATTRACTORS, basin_arrays, basin_sizes
from worker.basins.starts import starts_of
from worker.basins.task import _fill_in, entropies, run_chunk
from worker.spec.errors import SpecError
from worker.studies import parse
from worker.study import ChunkOptions, ChunkPaused
from worker.study.chunks import with_options
from worker.study.layout import empty_record
from worker.work import plate_of

GOLDEN = json.loads((paths.GOLDEN / "basins.json").read_text())

SPEC: dict[str, Any] = {
    "gamma": 1.27, "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"},
    "protocol": {"kind": "basin", "plane": "drop", "rows": 16, "columns": 16, "height": 10.0},
}  # fmt: skip


#: The kind of study beside this one, which has rules of its own.
SEVERAL: dict[str, Any] = {"kind": "multistability"}


def basin(**fields: Any) -> Any:
    """A specification like SPEC with some fields of the protocol, or others, changed."""
    names = ("kind", "plane", "rows", "columns", "height")
    protocol = {name: fields.pop(name) for name in names if name in fields}
    return parse(SPEC | fields | {"protocol": SPEC["protocol"] | protocol})


def search(
    gamma: float, omega: float, xi: float, side: int = 32, others: Sequence[float] = (), **fields: Any
) -> Found:
    """The attractors of side * side drops on a rigid plate, and of `others`: drops from that height."""
    spec = basin(gamma=gamma, omega=omega, xi=xi, rows=side, columns=side, **fields)

    def run(request: Request, reduce: Callable[[Line], Any]) -> Any:
        cells = [np.full(len(request.states), x) for x in (gamma, omega, xi)]
        line = LineRun(
            *cells, plate=plate_of(spec.model, *cells), carry=False, micro_flight=spec.micro_flight,
            **request.window(),
        )  # fmt: skip
        line.advance()
        return reduce(line.line)

    starts = starts_of(spec, gamma, omega, xi)
    added = np.repeat(starts[:1], len(others), axis=0)
    added[:, STATE_FIELDS.index("gap")] = others
    return find(np.concatenate([starts, added]), spec, run)


def told(found: Found) -> list[tuple[int, int, int]]:
    return [(a.outcome, a.bounces, a.periods) for a in found.attractors]


@pytest.mark.parametrize("reference", GOLDEN["cells"], ids=lambda cell: f"gamma {cell['gamma']}")
def test_fractions_and_entropies_are_those_of_the_reference(tmp_path: Path, reference: dict[str, Any]):
    cell = {name: reference[name] for name in ("gamma", "omega", "xi")}
    expected = reference["attractors"]
    # Those that have not settled in a quarter of the reference's time go on by themselves.
    spec = basin(rows=128, columns=128, settle=reference["settle"] // 4, **cell)
    stored = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0, omega=0, gamma=0)
    n = int(stored.attractor_count)
    assert n == len(expected)
    for i, (bounces, periods, longest, fraction) in enumerate(expected):
        assert (int(stored.bounces[i]), int(stored.periods[i])) == (bounces, periods)
        assert float(stored.longest_flight[i]) == pytest.approx(longest, abs=1e-6)
        assert float(stored.fraction[i]) == pytest.approx(fraction, abs=reference["tolerance"])
        assert float(stored.fraction[i]) == float((stored.attractor == i + 1).mean())
    assert float(stored.undecided) == 0.0
    for name in ("basin_entropy", "boundary_entropy"):
        if reference[name] is not None:
            assert float(stored[name]) == pytest.approx(reference[name], abs=1e-6)


def test_a_start_that_diverges_belongs_to_no_attractor():
    found = search(3.6, 0.5, 0.26, side=8, others=[1e300])
    assert len(found.attractors) == 2
    assert sorted(set(found.ids[:-1].tolist())) == [1, 2]
    assert found.ids[-1] == 0
    assert sum(a.fraction for a in found.attractors) == pytest.approx(64 / 65)


def test_one_chaotic_set_is_one_attractor_whatever_was_settled():
    """A grouping by extremes splits it into several."""
    for settle in (20, 100, 500):
        found = search(5.0, 0.5, 0.26, settle=settle, exponents=1)
        assert told(found) == [(Outcome.APERIODIC, 0, 0)], settle
        assert found.attractors[0].fraction == 1.0
        assert math.isinf(found.attractors[0].lifetime)
        assert found.attractors[0].lyapunov[0] == pytest.approx(0.52, abs=0.05)


def test_a_torus_beside_a_cycle():
    found = search(3.8, 1.0, 0.05, settle=1500, exponents=1)
    assert told(found) == [(Outcome.APERIODIC, 0, 0), (Outcome.PERIODIC, 2, 2)]
    assert [a.fraction for a in found.attractors] == pytest.approx([0.711, 0.289], abs=0.02)
    assert abs(found.attractors[0].lyapunov[0]) < 1e-3


def test_a_long_cycle_is_found_again_by_its_representatives():
    """(16,20): a window of 60 plate periods shows it three times, if at all."""
    found = search(3.7994, 0.3455, 0.05, side=8, settle=500)
    assert [(a.bounces, a.periods) for a in found.attractors] == [(16, 20), (2, 6)]
    assert (found.ids > 0).all()


def test_a_certified_long_cycle_is_none_of_the_aperiodic_motion_beside_it():
    """Some of its starts settle so slowly that they seem to leave that motion, which nothing leaves."""
    found = search(2.323, 0.62, 0.08, side=12, height=8.0, model={"kind": "rigid", "restitution": 0.35})
    assert told(found) == [(Outcome.APERIODIC, 0, 0), (Outcome.PERIODIC, 45, 16)]
    assert math.isinf(found.attractors[0].lifetime)


def test_a_torus_that_all_but_closes_is_one_attractor():
    """After 80 flights the smaller one repeats so nearly that some starts seem to be on a cycle."""
    found = search(2.2138, 0.6482, 0.05, side=16, settle=1500)
    assert [a.outcome for a in found.attractors] == [Outcome.APERIODIC] * 2
    assert [a.fraction for a in found.attractors] == pytest.approx([0.879, 0.121], abs=0.002)
    assert (found.ids > 0).all()


def test_a_long_transient_is_no_attractor():
    """Chaos that lasts 5,000 plate periods, before (1,1)."""
    found = search(12.87, 1.0616, 0.1, side=8, settle=500)
    assert (found.attractors[0].bounces, found.attractors[0].periods) == (1, 1)
    assert found.attractors[0].fraction > 0.95


def test_entropies_of_known_maps():
    halves = np.ones((16, 16), np.uint8)
    halves[:, 8:] = 2
    assert entropies(halves) == (0.0, 0.0)
    mixed = halves.copy()
    mixed[:8, :4] = 2
    expected = math.log(2.0)
    assert entropies(mixed) == pytest.approx((expected / 4.0, expected))
    assert all(math.isnan(x) for x in entropies(np.ones((7, 16), np.uint8)))
    undecided = mixed.copy()
    undecided[0, 0] = 0
    share = 31 / 63
    expected = -(share * math.log(share) + (1.0 - share) * math.log(1.0 - share))
    assert entropies(undecided) == pytest.approx((expected / 4.0, expected))
    assert entropies(np.zeros((8, 8), np.uint8)) == (0.0, 0.0)


def test_planes_of_starts():
    drops = starts_of(basin(rows=2, columns=4), 1.27, 0.5, 0.26).reshape(2, 4, 6)
    assert drops[:, 0, 2].tolist() == [2.5, 7.5]
    np.testing.assert_allclose(drops[0, :, 0], [0.0, math.pi / 2, math.pi, 1.5 * math.pi])
    np.testing.assert_allclose(drops[0, :, 3], [0.0, 1.0, 0.0, -1.0], atol=1e-15)
    contact = starts_of(basin(plane="contact", rows=2, columns=2), 1.27, 0.5, 0.26).reshape(2, 2, 6)
    assert (contact[..., :4] == 0.0).all()
    np.testing.assert_allclose(contact[:, 0, 4], -0.25 / 1.27 + np.array([-5.0, 5.0]))
    np.testing.assert_allclose(contact[0, :, 5], np.array([-5.0, 5.0]) / 0.5)


GRID = {"gamma": [1.1, 1.27, 3.6], "xi": [0.1, 0.26], "rows": 9, "columns": 8, "settle": 200}


def test_a_chunk_that_pauses_again_and_again_gives_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    cut_finely(monkeypatch, 65_537)
    looks = itertools.count()
    monkeypatch.setattr(work.time, "thread_time", lambda: 0.02 * next(looks))  # and the same pauses
    spec, url = basin(**GRID), str(tmp_path / "paused.zarr")
    plan = planned(url, spec, (2, 1, 3))
    done: list[int] = []
    for attempt in itertools.count():
        assert attempt < 5000
        try:
            with with_options(ChunkOptions(0.0)):
                run_chunk(spec, plan[0], url)
            break
        except ChunkPaused:
            kept = store.read_checkpoint(url, plan[0].index)
            assert kept is not None
            done.append(int(kept["done"]))
    assert attempt > 2
    assert done == sorted(done)
    assert set(done) == set(range(6))  # of six cells; none is computed again
    data = xarray.open_zarr(url, chunks=None).load()
    xarray.testing.assert_identical(data, computed(str(tmp_path / "whole.zarr"), spec, (2, 1, 3)))


def test_attractors_beyond_those_stored_are_counted_and_their_starts_undecided():
    spec = basin(rows=6, columns=6, keep=2)
    window = {"flight_time": np.zeros(2), "takeoff_phase": np.zeros(2)}
    attractors = tuple(
        Attractor(Outcome.PERIODIC, i + 1, 1, np.array([1.0 + i]), np.zeros(6), **window)
        for i in range(MAX_ATTRACTORS + 2)
    )
    found = Found(np.arange(36, dtype=np.uint16), attractors)
    record = empty_record((1, 1, 1), basin_arrays(spec), basin_sizes(spec))
    _fill_in(spec, found, record, (0, 0, 0))
    shown = np.arange(36) * (np.arange(36) <= MAX_ATTRACTORS)
    assert record["attractor"].ravel().tolist() == shown.tolist()
    assert int(record["attractor_count"][0, 0, 0]) == MAX_ATTRACTORS + 2
    assert float(record["undecided"][0, 0, 0]) == np.mean(shown == 0)


@pytest.mark.parametrize("kind", ["soft", "ball", "stepped"])
def test_other_contacts_have_basins(tmp_path: Path, kind: str):
    model = {"kind": kind, "penetration": 0.01} if kind != "ball" else {"kind": kind}
    spec = basin(model=model, rows=4, columns=4, settle=60, observe=20, settle_until=200)
    stored = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0, omega=0, gamma=0)
    n = int(stored.attractor_count)
    assert n >= 1
    assert float(stored.fraction[:n].sum()) + float(stored.undecided) == pytest.approx(1.0)


@for_each(("changes", "rule"), [
    ({"rows": 0}, "protocol.rows: must be at least 1, not 0"),
    ({"rows": 1024, "columns": 512}, "protocol.rows: must be at most 512 with 512 columns"),
    ({"plane": "contact", "model": {"kind": "ball"}}, "protocol.plane: must be 'drop' where"),
    ({"model": {"kind": "auto"}}, "model.kind: must be 'soft'"),
    ({"exponents": 4}, "exponents: must be at most 3"),
    ({"settle_until": 10}, "settle_until: must be at least settle + 2 × observe, "),
    (SEVERAL | {"rows": 64, "columns": 32}, "protocol.rows: must be at most 32 with 32 columns"),
    (SEVERAL | {"rows": 1, "columns": 1025}, "protocol.columns: must be at most 1,024, not 1025"),
    (SEVERAL | {"plane": "contact"}, "protocol.plane: must be 'drop'"),
    (SEVERAL | {"model": {"kind": "auto"}}, "model.kind: must be 'soft'"),
    (SEVERAL | {"exponents": 1}, "exponents: is not a field here"),
])  # fmt: skip
def test_broken_rules_are_named(changes: dict[str, Any], rule: str):
    with pytest.raises(SpecError) as caught:
        basin(**changes)
    assert rule in str(caught.value)
