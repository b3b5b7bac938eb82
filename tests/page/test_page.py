"""The page's files, and what it looks at: the same numbers as the calls that everybody uses."""

import gzip
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urljoin

import numpy as np
import pytest
from fastapi.testclient import TestClient
from scripted import Held
from served import computing, finished, get, service

from service.api.routers import page
from service.figures.catalogue import FIGURES
from worker.spec import SweepSpec

LINE: dict[str, Any] = {
    "name": "Fig. 2, coarse",
    "gamma": {"start": 1.0, "stop": 6.0, "num": 101},
    "omega": [0.5, 0.6],
    "xi": 0.26,
    "model": {"kind": "rigid"},
    "settle": 60,
    "observe": 40,
    "keep": 16,
}
RAMP: dict[str, Any] = {
    "gamma": {"start": 0.4, "stop": 1.2, "num": 81},
    "omega": 0.6,
    "xi": 0.05,
    "protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"},
    "model": {"kind": "rigid"},
    "settle": 120,
    "observe": 30,
}


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with computing(tmp_path_factory.mktemp("data")) as client:
        yield client


@pytest.fixture(scope="module")
def line(client: TestClient) -> str:
    return finished(client, LINE)


@pytest.fixture(scope="module")
def ramp(client: TestClient) -> str:
    return finished(client, RAMP)


def unpacked(client: TestClient, path: str, **query: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """As static/js/api.js reads it."""
    answer = client.get(path, params=query)
    assert answer.status_code == 200, answer.text
    head, _, body = answer.content.partition(b"\n")
    facts = json.loads(head)
    assert (len(head) + 1) % 8 == 0
    arrays = {
        name: np.frombuffer(body, np.dtype(kind), length, offset)
        for name, (kind, offset, length) in facts.pop("arrays").items()
    }
    return facts, arrays


# Files


def test_the_page_may_load_nothing_but_its_own_files(client: TestClient):
    answer = client.get("/")
    assert answer.headers["content-type"].startswith("text/html")
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert not re.search(r"<script(?![^>]*\bsrc=)|\bon[a-z]+=|\bstyle=", answer.text)


def test_every_file_that_a_file_names_is_there(client: TestClient):
    wanted, seen = ["/"], set[str]()
    while wanted:
        path = wanted.pop()
        if path in seen:
            continue
        seen.add(path)
        answer = client.get(path)
        assert answer.status_code == 200, path
        named = re.findall(r'(?:src|href)="((?:static|/docs)[^"]*)"', answer.text) if path == "/" else []
        if path.endswith(".js"):
            assert "javascript" in answer.headers["content-type"]
            named = re.findall(r'from "(\.\.?/[^"]+)"', answer.text)
        wanted += [urljoin(path, one) for one in named]
    shipped = {f"/static/{file.relative_to(page.FILES)}" for file in page.FILES.rglob("*") if file.is_file()}
    assert shipped - seen == {"/static/index.html"}


@pytest.mark.parametrize("file", sorted(page.FILES.rglob("*.*")), ids=lambda file: str(file.name))
def test_files_are_small_and_name_no_other_place(file: Path):
    text = file.read_text()
    assert len(text.splitlines()) <= 250
    assert set(re.findall(r"https?://[^\s\"'`)]+", text)) <= {"http://www.w3.org/2000/svg"}


def test_the_paper_s_sweeps_are_those_of_the_command(client: TestClient):
    figures = get(client, "/v1/figures")
    assert [one["number"] for one in figures] == [2, 3, 4, 5, 6, 7, 8, 9]
    for one in figures:
        specs = [SweepSpec.parse(sweep) for sweep in one["sweeps"]]
        assert specs == [SweepSpec.parse(dict(sweep)) for sweep in FIGURES[one["number"]].sweeps]


def test_files_outside_the_folder_are_out_of_reach(client: TestClient):
    for path in ("/static/../page.py", "/static/%2e%2e/page.py", "/static/js/..%2f..%2fpage.py"):
        assert client.get(path).status_code == 404


# A line


def test_points_are_the_flights_of_the_diagram(client: TestClient, line: str):
    query = {"along": "gamma", "omega": 0.6, "min_flight": 0.5}
    facts, arrays = unpacked(client, f"{line}/line", **query)
    diagram = get(client, f"{line}/diagram", **query)
    assert (facts["fixed"], facts["direction"]) == (diagram["fixed"], diagram["direction"])
    assert facts["missing"] == 0
    assert arrays["values"].tolist() == diagram["values"]
    for name in ("outcome", "bounces", "periods"):
        assert arrays[name].tolist() == diagram[name]
    assert arrays["shown"].tolist() == [len(times) for times in diagram["flight_time"]]
    flights = np.concatenate(diagram["flight_time"])
    np.testing.assert_allclose(arrays["flight_time"], flights, rtol=1e-6)
    assert facts["points"] == len(flights)
    assert facts["highest"] == pytest.approx(flights.max(), rel=1e-6)


@pytest.mark.parametrize("log", [False, True])
def test_density_counts_the_points(client: TestClient, line: str, log: bool):
    window = {"left": 1.5, "right": 4.0, "bottom": 2.0, "top": 12.0, "width": 50, "height": 40, "log": log}
    _, points = unpacked(client, f"{line}/line", omega=0.5)
    facts, arrays = unpacked(client, f"{line}/line", omega=0.5, most=100, **window)
    assert "flight_time" not in arrays
    x = np.repeat(points["values"], points["shown"])
    warp = np.log if log else np.asarray
    edges = np.linspace(warp(1.5), warp(4.0), 51), np.linspace(2.0, 12.0, 41)
    expected, *_ = np.histogram2d(warp(x), points["flight_time"].astype(float), edges)
    counts = arrays["density"].reshape(40, 50).astype(int)
    # Values on the border between two columns may round to either.
    assert abs(counts.sum() - expected.sum()) <= 0.02 * expected.sum()
    np.testing.assert_allclose(counts.sum(axis=1), expected.sum(axis=0), atol=2)
    assert facts["points"] == len(x)


def test_density_of_everything_loses_no_flight(client: TestClient, line: str):
    facts, arrays = unpacked(client, f"{line}/line", omega=0.5, most=0, width=300, height=500)
    assert arrays["density"].sum() == facts["points"]


def test_density_comes_squeezed_for_those_who_can_take_it(client: TestClient, line: str):
    answer = client.get(f"{line}/line", params={"omega": 0.5, "most": 0}, headers={"Accept-Encoding": "gzip"})
    plain = client.get(
        f"{line}/line", params={"omega": 0.5, "most": 0}, headers={"Accept-Encoding": "identity"}
    )
    assert answer.headers["content-encoding"] == "gzip"
    assert "content-encoding" not in plain.headers
    assert answer.content == plain.content
    assert len(gzip.compress(plain.content, 1)) < len(plain.content) / 5


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ({}, "omega"),
        ({"omega": 0.5, "gamma": 2}, "gamma"),
        ({"omega": 9}, "omega"),
        ({"omega": 0.5, "width": 0}, "width"),
        ({"omega": 0.5, "direction": "up"}, "direction"),
        ({"omega": 0.5, "most": 10**9}, "most"),
        ({"omega": 0.5, "log": "true", "left": 0}, "left"),
        ({"omega": 0.5, "left": 3, "right": 2}, "right"),
        ({"omega": 0.5, "bottom": 3, "top": 2}, "top"),
    ],
)
def test_a_line_that_is_not_there_is_refused(
    client: TestClient, line: str, query: dict[str, Any], field: str
):
    answer = client.get(f"{line}/line", params=query)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == field


# A plane


def test_a_plane_is_the_mode_map(client: TestClient, line: str):
    facts, arrays = unpacked(client, f"{line}/plane", xi=0.26)
    modes = get(client, f"{line}/modes", xi=0.26)
    whole = {"every_gamma": 1, "every_omega": 1}
    assert facts == {"xi": 0.26, "direction": "rest", "complete": True} | whole
    for name in ("gamma", "omega"):
        assert arrays[name].tolist() == modes[name]
    for name in ("outcome", "bounces", "periods"):
        assert arrays[name].tolist() == np.concatenate(modes[name]).tolist()


def test_the_mode_map_and_the_diagram_come_thinned_where_asked(client: TestClient, line: str):
    whole, part = (get(client, f"{line}/modes", xi=0.26, every=every) for every in (1, 50))
    assert "every" not in whole
    assert (part["every"], part["gamma"], part["omega"]) == (50, whole["gamma"][::50], [0.5])
    assert part["bounces"] == [whole["bounces"][0][::50]]
    thinned = get(client, f"{line}/diagram", omega=0.5, every=50)
    assert (thinned["every"], thinned["values"]) == (50, whole["gamma"][::50])


def test_a_window_of_a_plane_is_that_part_of_it(client: TestClient, line: str):
    _, whole = unpacked(client, f"{line}/plane")
    _, part = unpacked(client, f"{line}/plane", left=2.0, right=3.51, bottom=0.55)
    inside = (whole["gamma"] >= 2.0) & (whole["gamma"] <= 3.51)
    assert part["gamma"].tolist() == whole["gamma"][inside].tolist()
    assert part["omega"].tolist() == [0.6]
    assert part["bounces"].tolist() == whole["bounces"].reshape(2, 101)[1, inside].tolist()
    _, between = unpacked(client, f"{line}/plane", left=2.03, right=2.04, bottom=0.51, top=0.52)
    assert (len(between["gamma"]), between["omega"].tolist()) == (1, [0.5])
    assert between["gamma"][0] == pytest.approx(2.05)


def test_a_plane_too_large_for_one_answer_comes_thinned(tmp_path: Path):
    with computing(tmp_path, max_points=60) as client:
        here = finished(client, LINE)
        facts, arrays = unpacked(client, f"{here}/plane")
        assert (facts["every_gamma"], facts["every_omega"]) == (2, 2)
        assert len(arrays["gamma"]) == 51
        assert arrays["omega"].tolist() == [0.5]
        facts, arrays = unpacked(client, f"{here}/plane", left=1.0, right=2.0)
        assert (facts["every_gamma"], arrays["outcome"].size) == (1, 42)


def test_a_line_too_long_to_be_read_comes_thinned(
    client: TestClient, line: str, monkeypatch: pytest.MonkeyPatch
):
    whole, cells = unpacked(client, f"{line}/line", omega=0.5)
    assert whole["every"] == 1
    monkeypatch.setattr("service.results.diagram.MAX_READ", 40 * 16)
    facts, arrays = unpacked(client, f"{line}/line", omega=0.5)
    assert facts["every"] == 3
    assert arrays["values"].tolist() == cells["values"][::3].tolist()
    assert arrays["shown"].tolist() == cells["shown"][::3].tolist()


# A cell in motion


def test_a_cell_from_rest_moves_as_the_sweep_saw_it(client: TestClient, line: str):
    found = get(client, f"{line}/trajectory", gamma=2.3, omega=0.5, periods=6)
    assert found["gamma"] == pytest.approx(2.3)
    times = np.array(found["flights"]["flight_time"])
    np.testing.assert_allclose(sorted(times)[:2], [3.722384327764] * 2, atol=1e-6)
    np.testing.assert_allclose(sorted(times)[-2:], [6.284615845152] * 2, atol=1e-6)


@pytest.mark.parametrize(("direction", "bounces"), [("up", False), ("down", True)])
def test_a_cell_of_a_ramp_goes_on_from_where_the_ramp_left_it(
    client: TestClient, ramp: str, direction: str, bounces: bool
):
    """At Γ = Ω = 0.6, ξ = 0.05 the spring rests on the way up and bounces on the way down."""
    found = get(client, f"{ramp}/trajectory", gamma=0.6, direction=direction, periods=10)
    assert any(found["in_flight"]) == bounces
    if bounces:
        stored = get(client, f"{ramp}/diagram", along="gamma", direction=direction)
        cell = int(np.argmin(np.abs(np.array(stored["values"]) - 0.6)))
        known = np.array(stored["flight_time"][cell])
        for time in found["flights"]["flight_time"]:
            assert np.min(np.abs(known - time)) < 1e-4


def test_a_cell_that_no_ramp_has_reached_is_refused(tmp_path: Path):
    with service(tmp_path, Held()) as client:
        here = client.post("/v1/jobs", json=RAMP).headers["Location"]
        answer = client.get(f"{here}/trajectory", params={"gamma": 0.6})
        assert answer.status_code == 422
        assert "not computed yet" in answer.json()["detail"]
        facts, arrays = unpacked(client, f"{here}/line")
        assert facts["missing"] == len(arrays["values"]) == 81
        assert len(arrays["flight_time"]) == 0
