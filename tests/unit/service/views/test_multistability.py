"""Multistability as a job: attractors matched over a plane, over HTTP, in the client and as pictures."""

import itertools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import xarray
from fastapi.testclient import TestClient

from kernel.params import Outcome
from service.client import BadRequest, Client, Job
from service.errors import InvalidRequest
from service.views import trajectory
from service.views.multistability import MultistabilityQuery, compute
from service.views.selection import Stored
from service.views.trajectory import TrajectoryQuery
from worker import store
from worker.basins.specification import MultistabilitySpec
from worker.studies import study_of

SPEC: dict[str, Any] = {
    "name": "Fig. 2", "gamma": [3.56, 3.58, 3.6, 3.62, 3.64], "omega": [0.5, 0.502], "xi": 0.26,
    "model": {"kind": "rigid"}, "protocol": {"kind": "multistability"}, "settle": 300, "observe": 60,
}  # fmt: skip


@pytest.fixture(scope="module")
def job(python_client: Client) -> Job:
    return python_client.submit(SPEC).wait(progress=False)


def test_what_is_refused(client: TestClient, job: Job):
    with pytest.raises(BadRequest, match="xi: must be within"):
        job.multistability(0.5)
    with pytest.raises(BadRequest, match="omega: must be within"):
        job.multistability(omega=0.7)
    with pytest.raises(BadRequest, match="this job has no basins: its protocol is multistability"):
        job.basins()
    with pytest.raises(BadRequest, match="attractor: is required: the protocol is multistability"):
        job.trajectory(3.6, 0.5)
    answer = client.get(f"/v1/jobs/{job.id}/threshold")
    assert answer.status_code == 422
    assert "this job has no threshold: its protocol is multistability" in answer.json()["detail"]


# From a store that was written by hand

REST, CHAOS = (Outcome.AT_REST, 0, 0), (Outcome.APERIODIC, 0, 0)
ONE, TWO = (Outcome.PERIODIC, 1, 1), (Outcome.PERIODIC, 2, 2)
GAMMA, OMEGA = (1.0, 1.5, 2.0, 2.5, 3.0), (0.5, 0.6, 0.7)


class Known(NamedTuple):
    """An attractor of a cell, and which one of the next cell up and down it leads to."""

    mode: tuple[int, int, int]
    longest: float = 3.0
    up: int = 0
    down: int = 0
    share: float = 0.5


#: Attractors by cell, in lines along gamma; None for a cell that is not computed.
Lines = list[list[list[Known] | None]]


def spec_of(gamma: Any, omega: Any) -> MultistabilitySpec:
    return MultistabilitySpec(**SPEC | {"gamma": gamma, "omega": omega})


def written(folder: Path, lines: Lines) -> Stored[MultistabilitySpec]:
    spec = spec_of(list(GAMMA[: len(lines[0])]), list(OMEGA[: len(lines)]))
    (chunk,) = study_of(spec).plan(spec, (1, len(lines), len(lines[0])))
    layout = study_of(spec).variables(spec, chunk.shape)
    record = {
        array.name: np.full(
            [*chunk.shape, *(layout.extra_sizes[dim] for dim in array.dims[3:])], array.fill, array.dtype
        )
        for array in layout.arrays
    }
    for i, line in enumerate(lines):
        for j, cell in enumerate(line):
            if cell is None:
                continue
            record["outcome"][0, i, j] = Outcome.PERIODIC
            record["attractor_count"][0, i, j] = len(cell)
            for k, known in enumerate(cell[:8]):
                place = (0, i, j, k)
                for name, value in zip(("attractor_outcome", "bounces", "periods"), known.mode, strict=True):
                    record[name][place] = value
                record["longest_flight"][place] = record["flight_time"][(*place, 0)] = known.longest
                record["next_up"][place], record["next_down"][place] = known.up, known.down
                record["fraction"][place] = known.share
                record["attractor_state"][place] = k
    url = str(folder / "made.zarr")
    store.create(url, layout)
    store.write_chunk(url, chunk, record)
    return Stored(spec, url)


def read(job: Stored[MultistabilitySpec], **query: Any) -> xarray.Dataset:
    return compute(job, MultistabilityQuery(**query))


def ids(lines: Lines, folder: Path) -> list[list[list[int]]]:
    found = read(written(folder, lines)).id.values
    return [[cell[cell > 0].tolist() for cell in line] for line in found]


def attractors(found: xarray.Dataset) -> list[tuple[int, str, int]]:
    columns = (found[name].values.tolist() for name in ("attractor", "attractor_label", "cells"))
    return list(zip(*columns, strict=True))


def events(found: xarray.Dataset) -> list[tuple[Any, ...]]:
    names = ("kind", "attractor", "omega", "gamma_below", "gamma_above", "below", "above", "leads_to")
    return list(zip(*(found[f"event_{name}"].values.tolist() for name in names), strict=True))


def test_attractors_of_neighbouring_cells_are_one_if_each_leads_to_the_other(tmp_path: Path):
    crossed: Lines = [[[Known(ONE, up=2), Known(TWO, up=1)], [Known(ONE, down=2), Known(TWO, down=1)]]]
    assert ids(crossed, tmp_path / "crossed") == [[[1, 2], [2, 1]]]
    one_way: Lines = [[[Known(ONE, up=1)], [Known(ONE)], [Known(ONE, down=1)]]]
    assert ids(one_way, tmp_path / "one way") == [[[1], [2], [3]]]
    merged: Lines = [[[Known(ONE, up=1), Known(TWO, up=1)], [Known(ONE, down=2)]]]
    assert ids(merged, tmp_path / "merged") == [[[2, 1], [1]]]  # the first is that of most cells


@pytest.mark.parametrize(
    ("mode", "other", "longest", "same"),
    [(ONE, ONE, 4.0, True), (ONE, ONE, 4.01, False), (ONE, TWO, 3.0, False), (CHAOS, CHAOS, 9.0, True)],
)
def test_attractors_of_neighbouring_lines_are_one_if_they_are_near(
    mode: Any, other: Any, longest: float, same: bool, tmp_path: Path
):
    found = ids([[[Known(mode, 3.0)]], [[Known(other, longest)]]], tmp_path)
    assert found == [[[1]], [[1 if same else 2]]]


def test_cells_count_for_the_nearest_attractor_alone(tmp_path: Path):
    """Two lines of two cells: in the first, one attractor is near two of the other line."""
    alone: list[list[Known] | None] = [[Known(ONE, 3.6, up=1)], [Known(ONE, 3.6, down=1)]]
    two: list[list[Known] | None] = [[Known(ONE, 3.5), Known(ONE, 4.4, up=1)], [Known(ONE, 4.4, down=2)]]
    assert ids([alone, two], tmp_path / "above") == [[[1], [1]], [[1, 2], [2]]]
    assert ids([two, alone], tmp_path / "below") == [[[1, 2], [2]], [[1], [1]]]


def test_what_happens_between_cells_that_are_computed(tmp_path: Path):
    line: Lines = [
        [
            [Known(REST, 0.0, up=1)],
            [Known(REST, 0.0, down=1), Known(ONE, 3.0, up=1, down=1, share=0.0)],
            [Known(TWO, 3.2, down=2)],
            None,
            [Known(ONE, 3.1)],
        ]
    ]
    found = read(written(tmp_path / "first", line))
    where = [(0.5, low, high) for low, high in itertools.pairwise(GAMMA)]
    assert events(found) == [
        ("birth", 2, *where[0], "", "(1,1)", 1),
        ("death", 1, *where[1], "rest", "", 0),
        ("mode", 2, *where[1], "(1,1)", "(2,2)", 0),
    ]
    assert attractors(found) == [(1, "rest", 2), (2, "(1,1)", 2), (3, "(1,1)", 1)]
    assert found["count"].values.tolist() == [[1, 2, 1, -1, 1]]
    assert [found.attrs[name] for name in ("several", "several_by_drops", "complete")] == [0.25, 0.0, False]
    lost = read(written(tmp_path / "second", [[[Known(ONE, up=1)], [Known(REST, 0.0)], [Known(TWO)]]]))
    assert events(lost) == [
        ("death", 1, *where[0], "(1,1)", "", 2),
        ("birth", 2, *where[0], "", "rest", 0),
        ("death", 2, *where[1], "rest", "", 0),
        ("birth", 3, *where[1], "", "(2,2)", 0),
    ]
    assert lost.attrs["complete"]


def test_nothing_happens_beside_a_cell_whose_starts_are_undecided(tmp_path: Path):
    through: list[list[Known] | None] = [[Known(ONE, up=1)], [Known(ONE, up=1, down=1)], [Known(ONE, down=1)]]
    gap: list[list[Known] | None] = [[Known(ONE)], [], [Known(ONE)]]
    for name, lines in (("one", [gap]), ("joined", [gap, through])):
        assert events(read(written(tmp_path / name, lines))) == []


def test_before_the_first_cell_is_computed_there_is_no_attractor(tmp_path: Path):
    queued = Stored(spec_of([1.0, 1.5], [0.5, 0.6, 0.7]), str(tmp_path / "nothing.zarr"))
    found = read(queued)
    assert found["count"].values.tolist() == [[-1, -1]] * 3
    assert not found.id.any()
    assert (attractors(found), events(found), found.attrs["complete"]) == ([], [], False)
    assert np.isnan([found.attrs["several"], found.attrs["several_by_drops"]]).all()
    assert np.isnan(read(queued, omega=0.5).flight_time).all()
    with pytest.raises(InvalidRequest, match="attractor: this cell has none yet"):
        trajectory.compute(queued, TrajectoryQuery(gamma=1.0, omega=0.5, attractor=1))
