"""Multistability as a job: attractors matched over a plane, over HTTP, in the client and as pictures."""

import csv
import io
import itertools
import json
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from fastapi.testclient import TestClient
from matplotlib import image
from served import computing, get

from kernel.params import Outcome
from service.api import schemas
from service.client import BadRequest, Client, Job
from service.errors import InvalidRequest, OutdatedJob, TooLarge
from service.render.multistability import multistability_csv, multistability_json
from service.results import multistability
from service.results.multistability import Event, Multistability, _joined, plane
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


def test_changes_of_mode_are_events(service: TestClient, job: Job):
    answer = get(service, f"/v1/jobs/{job.id}/multistability", omega=0.5)
    assert answer["omega"] == [0.5]
    assert len(answer["count"]) == 1
    assert {event["kind"] for event in answer["events"]} == {"mode"}
    changes = [(e["gamma_below"], e["gamma_above"], e["below"], e["above"]) for e in answer["events"]]
    expected = MODES[0]
    assert changes == [
        (3.56, 3.58, expected[0], expected[1]),
        (3.6, 3.62, expected[2], expected[3]),
        (3.62, 3.64, expected[3], expected[4]),
    ]


def test_a_birth_is_told_with_the_attractor_that_it_leads_to(service: TestClient, client: Client):
    """(1,1) at omega 0.6, xi 0.05 begins in a fold at gamma 0.5532; below, its springs come to rest."""
    gamma = [0.52, 0.54, 0.56, 0.58]
    job = client.submit(SPEC | {"gamma": gamma, "omega": 0.6, "xi": 0.05, "settle": 1500}).wait(
        progress=False
    )
    answer = get(service, f"/v1/jobs/{job.id}/multistability")
    assert answer["count"] == [[1, 1, 2, 2]]
    (event,) = answer["events"]
    rest = next(a["id"] for a in answer["attractors"] if a["label"] == "rest")
    assert event == {
        "kind": "birth", "attractor": 3 - rest, "omega": 0.6, "gamma_below": 0.54, "gamma_above": 0.56,
        "below": None, "above": "(1,1)", "leads_to": rest,
    }  # fmt: skip


def test_in_the_client(job: Job):
    found = job.multistability()
    assert found["count"].dims == ("omega", "gamma")
    assert (found["count"].values == 2).all()
    assert found.id.dims == ("omega", "gamma", "place")
    assert (np.sort(found.id.values, axis=-1) == [1, 2]).all()
    assert found.cells.values.tolist() == [10, 10]
    assert found.attrs["several"] == found.attrs["complete"] == 1.0
    stored = job.open().load()
    assert (stored.attractor_count.squeeze().values == 2).all()
    assert job.multistability(omega=0.5).sizes["omega"] == 1


@pytest.mark.parametrize("omega", [None, 0.5])
def test_as_a_picture(job: Job, omega: float | None):
    picture = job.multistability_picture(omega=omega)
    assert picture == job.multistability_picture(omega=omega)
    pixels = image.imread(BytesIO(picture))
    colours = {tuple(row) for row in (pixels[..., :3] * 255).round().astype(int).reshape(-1, 3)}
    assert (0, 0x72, 0xB2) in colours


def test_what_is_refused(service: TestClient, client: Client, job: Job):
    with pytest.raises(BadRequest, match="xi: must be within"):
        job.multistability(0.5)
    with pytest.raises(BadRequest, match="omega: must be within"):
        job.multistability(omega=0.7)
    with pytest.raises(BadRequest, match="has no basins: the protocol of this job is multistability"):
        job.basins()
    answer = service.get(f"/v1/jobs/{job.id}/threshold")
    assert answer.status_code == 422
    assert "must be a sweep; the protocol of this job is multistability" in answer.json()["detail"]
    for query, rule in (
        ({"along": "omega", "gamma": 3.6}, "along: must be gamma"),
        ({"omega": 0.5, "every": 2}, "every: is not for a job of multistability"),
        ({"along": "gamma"}, "omega: is required"),
    ):
        answer = service.get(f"/v1/jobs/{job.id}/diagram", params=query)
        assert answer.status_code == 422
        assert rule in answer.json()["detail"]


def test_the_diagram_shows_all_coexisting_attractors(service: TestClient, job: Job):
    line = get(service, f"/v1/jobs/{job.id}/diagram", omega=0.5)
    assert line == get(service, f"/v1/jobs/{job.id}/multistability", omega=0.5)
    for cell in line["cells"][0]:
        longest = {place["label"]: max(place["flight_time"]) for place in cell}
        assert longest["(1,2)"] == pytest.approx(11.24, abs=0.1)
        assert all(max(p["flight_time"]) == pytest.approx(p["longest_flight"], abs=0.2) for p in cell)
    found = job.diagram(omega=0.5)
    assert found.flight_time.dims == ("omega", "gamma", "place", "flight")
    first = found.flight_time.isel(omega=0, gamma=0, place=0).dropna("flight").values.tolist()
    assert first == line["cells"][0][0][0]["flight_time"]
    table = service.get(f"/v1/jobs/{job.id}/diagram", params={"omega": 0.5, "format": "csv"}).text
    rows = list(csv.DictReader(io.StringIO(table)))
    assert len(rows) == sum(len(p["flight_time"]) for cell in line["cells"][0] for p in cell)
    assert [float(row["flight_time_rad"]) for row in rows[: len(first)]] == first
    assert {row["attractor"] for row in rows} == {"1", "2"}
    plane = job.multistability_picture("csv").decode()
    assert len(plane.splitlines()) == 1 + 2 * 5 * 2
    assert job.picture(omega=0.5) == job.multistability_picture(omega=0.5)


def test_the_motion_on_an_attractor(service: TestClient, job: Job):
    cell = get(service, f"/v1/jobs/{job.id}/diagram", omega=0.5)["cells"][0][2]
    for number, place in enumerate(cell, 1):
        query = {"gamma": 3.6, "omega": 0.5, "periods": 16, "attractor": number}
        motion = get(service, f"/v1/jobs/{job.id}/trajectory", **query)
        flights = [time for time in motion["flights"]["flight_time"] if time > 0.05]
        assert max(flights) == pytest.approx(place["longest_flight"], abs=1e-6)
    for attractor, rule in ((3, "attractor: must be from 1 to 2"), (0, "attractor")):
        query = {"gamma": 3.6, "omega": 0.5, "attractor": attractor}
        answer = service.get(f"/v1/jobs/{job.id}/trajectory", params=query)
        assert answer.status_code == 422
        assert rule in answer.text


def test_branches_join_by_most_votes_unless_they_share_a_cell():
    """Three lines of two cells: 0 is beside 1 in the first cell; 2 is near both, more often to 1."""
    branch = np.array([[[0, 1], [1, -1]], [[2, -1], [2, -1]], [[3, -1], [4, -1]]])
    owner = _joined(branch, {(0, 2): 1, (1, 2): 2, (2, 3): 1, (2, 4): 1})
    assert owner.tolist() == [0, 1, 1, 1, 1]
    assert _joined(branch, {}).tolist() == [0, 1, 2, 3, 4]
    assert _joined(branch, {(0, 2): 3, (1, 2): 2}).tolist() == [0, 1, 0, 3, 4]
    assert _joined(branch, {(1, 2): 1, (0, 2): 1}).tolist() == [0, 1, 0, 3, 4]  # of as many, the first


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


def test_of_several_near_attractors_the_nearest_are_one(tmp_path: Path):
    lines: Lines = [[[Known(ONE, 3.0), Known(ONE, 3.6)]], [[Known(ONE, 3.5), Known(ONE, 4.4)]]]
    assert ids(lines, tmp_path / "two lines") == [[[2, 1]], [[1, 3]]]
    lines = [[[Known(ONE, 3.0), Known(ONE, 3.6)]], [[Known(ONE, 3.5)]], [[Known(ONE, 3.1)]]]
    assert ids(lines, tmp_path / "three lines") == [[[2, 1]], [[1]], [[1]]]


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


def test_a_computed_cell_without_an_attractor_counts_among_the_computed(tmp_path: Path):
    found = plane(written(tmp_path, [[[Known(ONE), Known(TWO)], [], None]]), None)
    assert found.count.tolist() == [[2, 0, -1]]
    assert (found.several, found.several_by_drops) == (0.5, 0.5)


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


def test_attractors_beyond_those_stored_are_counted(tmp_path: Path):
    many = [Known((Outcome.PERIODIC, n, 1)) for n in range(1, 11)]
    found = plane(written(tmp_path, [[many]]), None)
    assert found.count.tolist() == [[10]]
    assert [place.label for place in found.cells[0][0]] == [f"({n},1)" for n in range(1, 9)]


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


def test_the_motion_of_an_attractor_begins_at_its_state(tmp_path: Path):
    job = written(tmp_path, [[[Known(ONE), Known(TWO)]]])
    for number in (1, 2):
        spec, state = of_attractor(job, {"gamma": 1.0, "omega": 0.5}, number, 3, 8)
        assert (spec.settle, spec.periods, spec.samples) == (0, 3, 8)
        assert set(state.tolist()) == {number - 1.0}
    for number in (0, 3):
        with pytest.raises(InvalidRequest, match="attractor: must be from 1 to 2"):
            of_attractor(job, {"gamma": 1.0, "omega": 0.5}, number, 3, 8)
    with pytest.raises(OutdatedJob, match="computed by kernel version 1"):
        of_attractor(replace(job, kernel_version="1"), {"gamma": 1.0, "omega": 0.5}, 1, 3, 8)


def test_a_plane_of_too_many_cells_is_refused_and_its_memory_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    job = written(tmp_path, [[[Known(ONE)]] * 3] * 2)
    monkeypatch.setattr(multistability, "MAX_CELLS", 6)
    assert plane(job, None).complete
    whole = multistability.plane_memory(job)
    monkeypatch.setattr(multistability, "MAX_CELLS", 5)
    with pytest.raises(TooLarge, match="2 by 3 cells"):
        plane(job, None)
    assert whole - multistability.plane_memory(job) == multistability._PER_CELL


def test_json_and_the_table_hold_the_flights_that_count(tmp_path: Path):
    """Those longer than micro_flight, here 0.05, unless none is; of a plane the longest flight."""
    found = plane(written(tmp_path, [[[Known(ONE), Known(TWO, 4.0)], [], None]]), None)
    times = np.full((3, 8, 4), np.nan)
    times[0, 0, :3] = 3.0, 0.05, 0.06
    times[0, 1, :2] = 0.05, 0.01
    document = json.loads(multistability_json(found, times))
    assert document["count"] == [[2, 0, None]]
    assert [place["flight_time"] for place in document["cells"][0][0]] == [[3.0, 0.06], [0.05, 0.01]]
    assert document["cells"][0][1:] == [[], []]
    rows = list(csv.DictReader(io.StringIO(multistability_csv(found, times).decode())))
    assert [(row["attractor"], row["flight"], row["flight_time_rad"]) for row in rows] == [
        ("1", "0", "3.0"), ("1", "1", "0.06"), ("2", "0", "0.05"), ("2", "1", "0.01"),
    ]  # fmt: skip
    assert "flight_time" not in json.loads(multistability_json(found))["cells"][0][0][0]
    rows = list(csv.DictReader(io.StringIO(multistability_csv(found).decode())))
    assert [(row["label"], row["longest_flight_rad"]) for row in rows] == [("(1,1)", "3.0"), ("(2,2)", "4.0")]
