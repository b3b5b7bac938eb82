"""A data folder that release 0.1.0 wrote opens, its jobs go on, and every chunk has the same bytes."""

import json
import sqlite3
import zipfile
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from paths import GOLDEN
from scripted import Scripted, wait_for
from served import get, service
from stores import checksum

from worker import store
from worker.plan import make_plan
from worker.schema import layout
from worker.spec import SweepSpec

RELEASE = "data-folder-0.1.0"
EXPECTED: dict[str, Any] = json.loads((GOLDEN / f"{RELEASE}.json").read_text())
DONE, INTERRUPTED = (f"/v1/jobs/{EXPECTED[name]['id']}" for name in ("done", "interrupted"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with zipfile.ZipFile(GOLDEN / f"{RELEASE}.zip") as archive:
        archive.extractall(tmp_path)
    return tmp_path / "bounce-data"


def store_of(folder: Path, name: str) -> Path:
    return folder / "stores" / f"{EXPECTED[name]['id']}.zarr"


def files(url: Path) -> dict[str, bytes]:
    return {str(path.relative_to(url)): path.read_bytes() for path in url.rglob("*") if path.is_file()}


def recorded_checksums(folder: Path, name: str) -> list[str]:
    """The ledger's, chunk by chunk."""
    query = "SELECT checksum FROM chunks JOIN jobs ON job = seq WHERE id = ? ORDER BY chunk"
    with closing(sqlite3.connect(folder / "ledger.sqlite")) as ledger:
        return [row[0] for row in ledger.execute(query, (EXPECTED[name]["id"],))]


def stored_checksums(folder: Path, name: str) -> list[str]:
    """Of the bytes in the store, chunk by chunk."""
    url = str(store_of(folder, name))
    spec, cut = SweepSpec.parse(store.read_attrs(url)["spec"]), store.chunk_shape(url)
    return [checksum(url, layout(spec, cut), chunk) for chunk in make_plan(spec, chunk_shape=cut)]


def test_the_folder_is_that_of_an_interrupted_service(folder: Path):
    assert recorded_checksums(folder, "done") == EXPECTED["done"]["checksums"]
    assert recorded_checksums(folder, "interrupted") == EXPECTED["interrupted"]["checksums"][:3]


@pytest.mark.parametrize("name", ["done", "interrupted"])
def test_a_store_laid_out_today_has_the_same_bytes(folder: Path, tmp_path: Path, name: str):
    earlier, today = store_of(folder, name), tmp_path / "today.zarr"
    spec = SweepSpec.parse(store.read_attrs(str(earlier))["spec"])
    store.create(str(today), layout(spec, store.chunk_shape(str(earlier))))
    laid_out = files(today)
    assert "zarr.json" in laid_out
    assert laid_out.items() <= files(earlier).items()


def test_jobs_of_an_earlier_release_answer_and_resume(folder: Path):
    before = {name: files(store_of(folder, name)) for name in ("done", "interrupted")}
    with closing(Scripted()) as executor, service(folder, executor) as client:
        assert get(client, DONE)["state"] == "done"
        line = get(client, f"{DONE}/diagram", omega=0.5, xi=0.26)
        assert line["complete"]
        assert len(line["flight_time"]) > 0
        wait_for(lambda: bool(get(client, INTERRUPTED)["state"] == "done"))
        assert get(client, f"{INTERRUPTED}/diagram", omega=0.6, xi=0.1, direction="down")["complete"]
    assert len(executor.tried) == 9  # three of twelve chunks were there
    for name in ("done", "interrupted"):
        assert stored_checksums(folder, name) == EXPECTED[name]["checksums"]
        assert recorded_checksums(folder, name) == EXPECTED[name]["checksums"]
        assert before[name].items() <= files(store_of(folder, name)).items()
    assert before["done"] == files(store_of(folder, "done"))
