"""The page's files and the data of its views, which agree with the public API."""

import graphlib
import re
from pathlib import Path

from fastapi.testclient import TestClient
from scripted import Held
from served import service
from studies import spec_of
from tables import for_each

from service.api.routers import page

SCRIPTS = page.FILES / "js"

RAMP = spec_of((0.4, 1.2, 81), 0.6, 0.05, ramp="both", window=(120, 30))


# Files


def test_the_page_loads_only_its_own_files(client: TestClient):
    response = client.get("/")
    assert response.headers["content-type"].startswith("text/html")
    policy = response.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert not re.search(r"<script(?![^>]*\bsrc=)|\bon[a-z]+=|\bstyle=", response.text)


@for_each("file", sorted(page.FILES.rglob("*.*")))
def test_files_name_no_other_host(file: Path):
    own = {"http://www.w3.org/2000/svg", "http://127.0.0.1:8000"}
    assert set(re.findall(r"https?://[^\s\"'`)]+", file.read_text())) <= own


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
    imported = {name for file in files for name in re.findall(r'from "\.\./([^/".]+)', file.read_text())}
    assert imported <= LAYERS[folder]


def test_the_scripts_do_not_import_each_other_in_cycles():
    imports = {
        file: [(file.parent / path).resolve() for path in re.findall(r'from "([^"]+)"', file.read_text())]
        for file in SCRIPTS.rglob("*.js")
    }
    graph = graphlib.TopologicalSorter(imports)
    graph.prepare()  # raises CycleError


def test_files_outside_the_folder_are_not_served(client: TestClient):
    for path in ("/static/../page.py", "/static/%2e%2e/page.py", "/static/js/..%2f..%2fpage.py"):
        assert client.get(path).status_code == 404


# The trajectory of a cell


def test_the_trajectory_of_a_cell_not_computed_yet_is_refused(tmp_path: Path):
    with service(tmp_path, Held()) as client:
        job_url = client.post("/v1/jobs", json=RAMP).headers["Location"]
        response = client.get(f"{job_url}/trajectory", params={"gamma": 0.6})
        assert response.status_code == 422
        assert "not computed yet" in response.json()["detail"]
