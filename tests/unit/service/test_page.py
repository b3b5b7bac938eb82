"""The page's files and the data of its views, which agree with the public API."""

import graphlib
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
from served import computing, finished, read, service
from tables import for_each

from kernel.params import Outcome
from service.api.routers import page

SCRIPTS = page.FILES / "js"

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
    """Decode the binary form as static/js/lib/api.js does: (header, arrays)."""
    response = client.get(path, params=query)
    assert response.status_code == 200, response.text
    line, _, body = response.content.partition(b"\n")
    header = json.loads(line)
    assert (len(line) + 1) % 8 == 0
    arrays = {
        name: np.frombuffer(body, np.dtype(kind), length, offset)
        for name, (kind, offset, length) in header.pop("arrays").items()
    }
    return header, arrays


# Files


def test_the_page_loads_only_its_own_files(client: TestClient):
    response = client.get("/")
    assert response.headers["content-type"].startswith("text/html")
    policy = response.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert not re.search(r"<script(?![^>]*\bsrc=)|\bon[a-z]+=|\bstyle=", response.text)


def test_the_page_s_files_refer_to_each_other_and_to_nothing_missing(client: TestClient):
    paths, seen = ["/"], set[str]()
    while paths:
        path = paths.pop()
        if path in seen:
            continue
        seen.add(path)
        response = client.get(path)
        assert response.status_code == 200, path
        html = path in ("/", "/docs")
        references = re.findall(r'(?:src|href)="(/?(?:static|docs)[^"]*)"', response.text) if html else []
        if path.endswith(".js"):
            assert "javascript" in response.headers["content-type"]
            references = re.findall(r'from "(\.\.?/[^"]+)"', response.text)
        paths += [urljoin(path, reference) for reference in references]
    shipped = {f"/static/{file.relative_to(page.FILES)}" for file in page.FILES.rglob("*") if file.is_file()}
    assert shipped - seen == {"/static/index.html"}


@for_each("file", sorted(page.FILES.rglob("*.*")))
def test_files_name_no_other_host(file: Path):
    text = file.read_text()
    assert set(re.findall(r"https?://[^\s\"'`)]+", text)) <= {"http://www.w3.org/2000/svg"}


#: Folders of scripts; each may import from itself and from those listed.
LAYERS: dict[str, set[str]] = {
    "lib": set(),
    "plot": {"lib"},
    "motion": {"plot", "lib"},
    "form": {"lib"},
    "views": {"form", "motion", "plot", "lib"},
    "start": {"views", "form", "motion", "lib"},
    "explore": {"views", "motion", "plot", "lib"},
}


@for_each("folder", LAYERS)
def test_scripts_import_only_from_the_layers_below(folder: str):
    files = sorted((SCRIPTS / folder).glob("*.js"))
    assert 0 < len(files) <= 16
    imported = {name for file in files for name in re.findall(r'from "\.\./([^/"]+)', file.read_text())}
    assert imported <= LAYERS[folder]


def test_the_scripts_do_not_import_each_other_in_cycles():
    imports = {
        file: [(file.parent / path).resolve() for path in re.findall(r'from "([^"]+)"', file.read_text())]
        for file in SCRIPTS.rglob("*.js")
    }
    graph = graphlib.TopologicalSorter(imports)
    graph.prepare()  # raises CycleError


def codes_of(constant: str) -> dict[str, int]:
    """The codes of a constant of physics.js by name, in lower case with hyphens."""
    listed = re.search(rf"{constant} = \{{ (.*?) \}}", (SCRIPTS / "lib" / "physics.js").read_text())
    assert listed
    pairs = (pair.split(": ") for pair in listed[1].split(", "))
    return {re.sub("[A-Z]", lambda letter: f"-{letter[0].lower()}", name): int(code) for name, code in pairs}


def test_the_scripts_know_the_kernel_s_outcome_codes():
    assert codes_of("OUTCOME") == {
        outcome.name.lower().replace("_", "-"): outcome.value for outcome in Outcome
    }


@pytest.mark.parametrize("min_flight", [None, 3.0])
def test_diagram_and_mode_map_count_the_same_flights(client: TestClient, line: str, min_flight: float | None):
    query = {} if min_flight is None else {"min_flight": min_flight}
    diagram, modes = (
        read(client, f"{line}/diagram", omega=0.5, **query),
        read(client, f"{line}/modes", **query),
    )
    header, plane = unpacked(client, f"{line}/plane", **query)
    shortest = {diagram.attrs["min_flight"], modes.attrs["min_flight"], header["min_flight"]}
    assert shortest == {0.05 if min_flight is None else min_flight}
    for name in ("outcome", "bounces", "periods"):
        np.testing.assert_array_equal(diagram[name], modes[name][0])
        np.testing.assert_array_equal(diagram[name], plane[name][: diagram.sizes["gamma"]])
    stored = read(client, f"{line}/diagram", omega=0.5)
    assert stored.bounces.equals(diagram.bounces) == (min_flight != 3.0)


def test_files_outside_the_folder_are_not_served(client: TestClient):
    for path in ("/static/../page.py", "/static/%2e%2e/page.py", "/static/js/..%2f..%2fpage.py"):
        assert client.get(path).status_code == 404


# A line


def test_points_are_the_flights_of_the_diagram(client: TestClient, line: str):
    query = {"along": "gamma", "omega": 0.6, "min_flight": 0.5}
    header, arrays = unpacked(client, f"{line}/line", **query)
    diagram = read(client, f"{line}/diagram", **query)
    assert header["fixed"] == {axis: diagram[axis].item() for axis in ("omega", "xi")}
    assert header["direction"] == diagram.direction
    assert header["missing"] == 0
    assert arrays["values"].tolist() == diagram.gamma.values.tolist()
    for name in ("outcome", "bounces", "periods"):
        np.testing.assert_array_equal(arrays[name], diagram[name])
    np.testing.assert_array_equal(arrays["shown"], diagram.flight_time.count("flight"))
    flights = diagram.flight_time.values[diagram.flight_time.notnull()]
    np.testing.assert_allclose(arrays["flight_time"], flights, rtol=1e-6)
    assert header["points"] == len(flights)
    assert header["highest"] == pytest.approx(flights.max(), rel=1e-6)


@pytest.mark.parametrize(("path", "encoding"), [("plane", "gzip"), ("line?omega=0.5", None)])
def test_a_mode_map_is_compressed_and_points_are_not(
    client: TestClient, line: str, path: str, encoding: str | None
):
    response = client.get(f"{line}/{path}", headers={"Accept-Encoding": "gzip"})
    assert response.status_code == 200
    assert response.headers.get("content-encoding") == encoding


@for_each(
    ("query", "field"),
    [
        ({}, "omega"),
        ({"omega": 0.5, "width": 0}, "width"),
        ({"omega": 0.5, "most": 10**9}, "most"),
        ({"omega": 0.5, "log": "true", "left": 0}, "left"),
    ],
)
def test_an_invalid_line_query_is_refused(client: TestClient, line: str, query: dict[str, Any], field: str):
    response = client.get(f"{line}/line", params=query)
    assert response.status_code == 422
    assert response.json()["errors"][0]["field"] == field


# A plane


def test_a_plane_is_the_mode_map(client: TestClient, line: str):
    header, arrays = unpacked(client, f"{line}/plane", xi=0.26)
    modes = read(client, f"{line}/modes", xi=0.26)
    whole = {"every_gamma": 1, "every_omega": 1, "min_flight": 0.05}
    assert header == {"xi": 0.26, "direction": "rest", "complete": True} | whole
    for name in ("gamma", "omega"):
        np.testing.assert_array_equal(arrays[name], modes[name])
    for name in ("outcome", "bounces", "periods"):
        np.testing.assert_array_equal(arrays[name], modes[name].values.ravel())


def test_a_plane_of_too_many_cells_is_thinned(tmp_path: Path):
    with computing(tmp_path, max_points=60) as client:
        job_url = finished(client, LINE)
        header, arrays = unpacked(client, f"{job_url}/plane")
        assert (header["every_gamma"], header["every_omega"]) == (2, 2)
        assert len(arrays["gamma"]) == 51
        assert arrays["omega"].tolist() == [0.5]
        header, arrays = unpacked(client, f"{job_url}/plane", left=1.0, right=2.0)
        assert (header["every_gamma"], arrays["outcome"].size) == (1, 42)


# The trajectory of a cell


def test_the_trajectory_of_a_cell_from_rest_has_the_stored_flights(client: TestClient, line: str):
    found = read(client, f"{line}/trajectory", gamma=2.3, omega=0.5, periods=6)
    assert found.gamma.item() == pytest.approx(2.3)
    times = found.flight_time.values
    np.testing.assert_allclose(sorted(times)[:2], [3.722384327764] * 2, atol=1e-6)
    np.testing.assert_allclose(sorted(times)[-2:], [6.284615845152] * 2, atol=1e-6)


@pytest.mark.parametrize(("direction", "bounces"), [("up", False), ("down", True)])
def test_the_trajectory_of_a_ramp_cell_starts_from_its_stored_state(
    client: TestClient, ramp: str, direction: str, bounces: bool
):
    """At Γ = Ω = 0.6, ξ = 0.05 the spring rests on the ramp up and bounces on the ramp down."""
    found = read(client, f"{ramp}/trajectory", gamma=0.6, direction=direction, periods=10)
    assert found.in_flight.any() == bounces
    if bounces:
        stored = read(client, f"{ramp}/diagram", along="gamma", direction=direction)
        known = stored.flight_time.sel(gamma=0.6, method="nearest").values
        for time in found.flight_time.values:
            assert np.nanmin(np.abs(known - time)) < 1e-4


def test_the_trajectory_of_a_cell_not_computed_yet_is_refused(tmp_path: Path):
    with service(tmp_path, Held()) as client:
        job_url = client.post("/v1/jobs", json=RAMP).headers["Location"]
        response = client.get(f"{job_url}/trajectory", params={"gamma": 0.6})
        assert response.status_code == 422
        assert "not computed yet" in response.json()["detail"]
        header, arrays = unpacked(client, f"{job_url}/line")
        assert header["missing"] == len(arrays["values"]) == 81
        assert len(arrays["flight_time"]) == 0
