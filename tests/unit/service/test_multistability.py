"""Multistability as a job: attractors matched over a plane, over HTTP, in the client and as pictures."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from fastapi.testclient import TestClient
from served import computing, get

from kernel.params import Outcome
from service.api import schemas
from service.client import BadRequest, Client, Job
from service.errors import InvalidRequest
from service.results import multistability
from service.results.multistability import Event, Multistability, plane
from service.results.trajectory import of_attractor
from worker import store
from worker.basins.spec import MultistabilitySpec
from worker.studies import study_of

SPEC: dict[str, Any] = {
    "name": "Fig. 2", "gamma": [3.56, 3.58, 3.6, 3.62, 3.64], "omega": [0.5, 0.502], "xi": 0.26,
    "model": {"kind": "rigid"}, "protocol": {"kind": "multistability"}, "settle": 300, "observe": 60,
}  # fmt: skip
#: Two attractors in every cell; one grazes, which changes its mode: tests/unit/worker/test_multistability.py.
MODES = [["aperiodic", "(3,4)", "(3,4)", "(4,4)", "(2,2)"], ["(1,2)"] * 5]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with computing(tmp_path_factory.mktemp("data")) as client:
        yield client


@pytest.fixture(scope="module")
def client(service: TestClient) -> Client:
    return Client("http://localhost", http=service)


@pytest.fixture(scope="module")
def job(client: Client) -> Job:
    return client.submit(SPEC).wait(progress=False)


def test_one_attractor_has_one_id_in_all_cells(service: TestClient, job: Job):
    answer = get(service, f"/v1/jobs/{job.id}/multistability")
    assert set(answer) == set(schemas.MultistabilityView.model_fields)
    assert answer["complete"]
    assert answer["count"] == [[2] * 5] * 2
    assert (answer["several"], answer["several_by_drops"]) == (1.0, 1.0)
    assert [(a["id"], a["cells"]) for a in answer["attractors"]] == [(1, 10), (2, 10)]
    assert {tuple(sorted(place["id"] for place in cell)) for line in answer["cells"] for cell in line} == {
        (1, 2)
    }
    line = answer["cells"][0]
    labels = [[next(p["label"] for p in cell if p["id"] == number) for cell in line] for number in (1, 2)]
    assert sorted(labels) == sorted(MODES)


def test_what_is_refused(service: TestClient, client: Client, job: Job):
    with pytest.raises(BadRequest, match="xi: must be within"):
        job.multistability(0.5)
    with pytest.raises(BadRequest, match="omega: must be within"):
        job.multistability(omega=0.7)
    with pytest.raises(BadRequest, match="has no basins: the protocol of this job is multistability"):
        job.basins()
    answer = service.get(f"/v1/jobs/{job.id}/threshold")
    assert answer.status_code == 422
    assert "has no threshold: the protocol of this job is multistability" in answer.json()["detail"]
    for query, rule in (
        ({"along": "omega", "gamma": 3.6}, "along: must be gamma"),
        ({"omega": 0.5, "every": 2}, "every: is not for a job of multistability"),
        ({"along": "gamma"}, "omega: is required"),
    ):
        answer = service.get(f"/v1/jobs/{job.id}/diagram", params=query)
        assert answer.status_code == 422
        assert rule in answer.json()["detail"]


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


def written(folder: Path, lines: Lines) -> Multistability:
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
    return Multistability(spec, url)


def ids(lines: Lines, folder: Path) -> list[list[list[int]]]:
    return [
        [[place.id for place in cell] for cell in line] for line in plane(written(folder, lines), None).cells
    ]


def test_attractors_of_neighbouring_cells_are_one_if_each_leads_to_the_other(tmp_path: Path):
    crossed: Lines = [[[Known(ONE, up=2), Known(TWO, up=1)], [Known(ONE, down=2), Known(TWO, down=1)]]]
    assert ids(crossed, tmp_path / "crossed") == [[[1, 2], [2, 1]]]
    one_way: Lines = [[[Known(ONE, up=1)], [Known(ONE)], [Known(ONE, down=1)]]]
    assert ids(one_way, tmp_path / "one way") == [[[1], [2], [3]]]
    merged: Lines = [[[Known(ONE, up=1), Known(TWO, up=1)], [Known(ONE, down=2)]]]
    assert ids(merged, tmp_path / "merged") == [[[2, 1], [1]]]  # the first is that of most cells


@pytest.mark.parametrize(
    ("mode", "other", "longest", "same"),
    [
        (ONE, ONE, 4.0, True),
        (ONE, ONE, 2.0, True),
        (ONE, ONE, 4.01, False),
        (ONE, TWO, 3.0, False),
        (CHAOS, CHAOS, 9.0, True),
        (CHAOS, ONE, 3.0, False),
    ],
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
    found = plane(written(tmp_path / "first", line), None)
    where = [(0.5, low, high) for low, high in itertools.pairwise(GAMMA)]
    assert found.events == (
        Event("birth", 2, *where[0], None, "(1,1)", 1),
        Event("death", 1, *where[1], "rest", None, None),
        Event("mode", 2, *where[1], "(1,1)", "(2,2)", None),
    )
    assert [(a.id, a.label, a.cells, a.gamma, a.longest_flight) for a in found.attractors] == [
        (1, "rest", 2, (1.0, 1.5), (0.0, 0.0)),
        (2, "(1,1)", 2, (1.5, 2.0), (3.0, 3.2)),
        (3, "(1,1)", 1, (3.0, 3.0), (3.1, 3.1)),
    ]
    assert found.count.tolist() == [[1, 2, 1, -1, 1]]
    assert (found.several, found.several_by_drops, found.complete) == (0.25, 0.0, False)
    lost = plane(written(tmp_path / "second", [[[Known(ONE, up=1)], [Known(REST, 0.0)], [Known(TWO)]]]), None)
    assert lost.events == (
        Event("death", 1, *where[0], "(1,1)", None, 2),
        Event("birth", 2, *where[0], None, "rest", None),
        Event("death", 2, *where[1], "rest", None, None),
        Event("birth", 3, *where[1], None, "(2,2)", None),
    )
    assert lost.complete


def test_a_line_of_a_plane_has_its_own_attractors_and_events(tmp_path: Path):
    lines: Lines = [
        [[Known(REST, 0.0)], [Known(ONE, 3.0)]],
        [[Known(TWO, 5.0, up=1)], [Known(TWO, 5.0, down=1)]],
    ]
    job = written(tmp_path, lines)
    whole = plane(job, None)
    assert [(a.id, a.label) for a in whole.attractors] == [(1, "(2,2)"), (2, "rest"), (3, "(1,1)")]
    one, other = whole.line(0.52), whole.line(0.6)
    assert [a.id for a in one.attractors] == [2, 3]
    assert one.events == whole.events != ()
    assert ([a.id for a in other.attractors], other.events) == ([1], ())
    assert other.omega.tolist() == [0.6]
    assert multistability.flights(job, None, 0.6)[:, 0, 0].tolist() == [5.0, 5.0]


def test_before_the_first_cell_is_computed_there_is_no_attractor(tmp_path: Path):
    queued = Multistability(spec_of([1.0, 1.5], [0.5, 0.6, 0.7]), str(tmp_path / "nothing.zarr"))
    found = plane(queued, None)
    assert found.count.tolist() == [[-1, -1]] * 3
    assert found.cells == (((), ()),) * 3
    assert (found.attractors, found.events, found.complete) == ((), (), False)
    assert np.isnan([found.several, found.several_by_drops]).all()
    assert multistability.flights(queued, None, 0.5).shape == (2, 0, 0)
    with pytest.raises(InvalidRequest, match="attractor: this cell has none yet"):
        of_attractor(queued, {"gamma": 1.0, "omega": 0.5}, 1, 1, 8)
