"""A shared file as a job of another service: the same bytes, or a sentence that says why not."""

import hashlib
import html
import io
import json
import re
import shutil
import tracemalloc
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from pyarrow import parquet
from scripted import wait_for
from served import RAMP, computing, finished, get
from stores import files, store_in
from tables import for_each

from kernel.params import KERNEL_VERSION
from service.errors import InvalidRequest
from service.jobs.stores import sharing
from worker import store
from worker.studies import from_json, study_of

#: A shared file and the files of its store; a service and its data folder.
Shared = tuple[bytes, dict[str, bytes]]
Elsewhere = tuple[TestClient, Path]

HTML = {"Content-Type": "application/octet-stream"}

#: Software of a time that no file could tell.
NEVER = b'[{"release": "1", "python": "3", "libraries": {}, "processor": "", "began": 1e300}]'

#: Texts that hold more objects than any shared file, in as many bytes.
CROWDED = (
    '{"a": [' + "{}, " * 1_000_000 + "{}]}",
    "{" + ", ".join(f'"{i}": ""' for i in range(300_000)) + "}",
    json.dumps({"zarr.json": b64encode(b'{"attributes": [' + b"{}, " * 1_000_000 + b"{}]}").decode()}),
)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Shared:
    """A shared file, and the store that it is of."""
    folder = tmp_path_factory.mktemp("first")
    with computing(folder) as client:
        here = finished(client, RAMP)
        page = client.get(f"{here}/export?format=html").content
    return page, files(store_in(folder, here.rsplit("/", 1)[1]))


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TestClient, Path]]:
    folder = tmp_path_factory.mktemp("second")
    with computing(folder) as client:
        yield client, folder


def test_it_is_the_same_job_with_the_same_bytes(shared: Shared, elsewhere: Elsewhere):
    (page, stored), (client, folder) = shared, elsewhere
    left = (
        folder / "stores" / f"1000-{from_json(json.dumps(RAMP)).job_id(KERNEL_VERSION)}.zarr"
    )  # by an import that was interrupted
    left.mkdir(parents=True)
    client.app.state.service.manager.supervisor.unknown_stores = [left.name]  # type: ignore[attr-defined]
    assert "notices" in client.get("/readyz").json()
    for status in (201, 200):
        answer = client.post("/v1/imports", content=page, headers=HTML)
        assert answer.status_code == status, answer.text
    job = answer.json()
    assert (job["state"], job["progress"]["percent"], job["name"]) == ("done", 100, RAMP["name"])
    assert files(store_in(folder, job["id"])) == stored
    assert not left.exists()
    wait_for(lambda: client.get("/readyz").json() == {"status": "ok"})
    here = answer.headers["Location"]
    assert get(client, f"{here}/modes", xi=0.26, direction="up")["attrs"]["complete"]
    table = client.get(f"{here}/export?format=parquet").content
    about = parquet.read_schema(io.BytesIO(table)).metadata
    assert re.findall(rb"Z (\w+)", about[b"history"]) == [b"computing", b"accepted", b"taken"]
    assert about[b"software"].decode() in html.unescape(page.decode())
    numbers, again = map(sharing._BLOCK.search, (page, client.get(f"{here}/export?format=html").content))
    assert numbers[1] == again[1]  # the checksum
    assert client.delete(here).status_code == 204
    again = client.post("/v1/imports", content=page, headers=HTML)  # before the other is removed
    assert again.status_code == 201
    wait_for(lambda: len(list((folder / "stores").glob("*.zarr*"))) == 1)
    assert files(store_in(folder, job["id"])) == stored
    assert client.delete(here).status_code == 204


def test_a_whole_store_that_the_ledger_does_not_know_stays(shared: Shared, elsewhere: Elsewhere):
    (page, stored), (client, folder) = shared, elsewhere
    root = folder / "stores" / f"1000-{from_json(json.dumps(RAMP)).job_id(KERNEL_VERSION)}.zarr" / "zarr.json"
    root.parent.mkdir(parents=True)
    root.write_bytes(stored["zarr.json"])
    answer = client.post("/v1/imports", content=page, headers=HTML)
    assert answer.status_code == 201
    assert root.read_bytes() == stored["zarr.json"]
    shutil.rmtree(root.parent)
    assert client.delete(answer.headers["Location"]).status_code == 204


def test_an_import_that_dies_has_its_software_or_is_no_job(
    shared: Shared, elsewhere: Elsewhere, monkeypatch: pytest.MonkeyPatch
):
    (page, _), (client, _) = shared, elsewhere
    service = client.app.state.service  # type: ignore[attr-defined]

    def die(*_: Any) -> None:
        raise SystemExit

    monkeypatch.setattr(sharing, "find_unknown", die)
    with pytest.raises(SystemExit):
        sharing.import_shared(service.ledger, service.settings, service.manager.check, page)
    job = service.ledger.find(from_json(json.dumps(RAMP)).job_id(KERNEL_VERSION))
    assert json.loads(job.runs)
    service.manager.delete(job.id)


def _resealed(change: Callable[[dict[str, bytes]], None]) -> Callable[[bytes], bytes]:
    """A page with other files and their right checksum."""

    def forge(page: bytes) -> bytes:
        block = sharing._BLOCK.search(page)
        contents = {key: b64decode(text) for key, text in json.loads(block[2]).items()}
        change(contents)
        text = json.dumps({key: b64encode(content).decode() for key, content in contents.items()})
        digest = hashlib.sha256(text.encode()).hexdigest()
        return page.replace(block[0], f'{sharing._OPENS}{digest}">{text}</script>'.encode())

    return forge


def _root(old: str, new: str) -> Callable[[bytes], bytes]:
    def change(contents: dict[str, bytes]) -> None:
        assert old.encode() in contents["zarr.json"]
        contents["zarr.json"] = contents["zarr.json"].replace(old.encode(), new.encode())

    return _resealed(change)


def _swapped(contents: dict[str, bytes]) -> None:
    """Two chunks in each other's place: whole by themselves."""
    one, other = [key for key in contents if key.startswith("flight_time/c.")][:2]
    contents[one], contents[other] = contents[other], contents[one]


def _impossible(array: str, value: float) -> Callable[[bytes], bytes]:
    """A chunk of numbers that no cell has, with its seal."""

    def change(contents: dict[str, bytes]) -> None:
        spec = from_json(json.dumps(RAMP))
        plan = study_of(spec).plan(spec)
        layout = study_of(spec).variables(spec, plan.chunk_shape)
        with TemporaryDirectory() as folder:
            url = f"{folder}/a.zarr"
            store.restore(url, {key: contents[key] for key in store.keys_of(layout, plan)}, layout)
            record = store.read_chunk(url, plan[0], layout.names)
            record[array][...] = value
            store.write_chunk(url, plan[0], record)
            contents |= files(Path(url))

    return _resealed(change)


@for_each(("change", "status", "said"), [
    (lambda page: b"<html><p>A letter.</p></html>", 422, "is not one that bounce share wrote"),
    (lambda page: page[: page.index(b"</script>") - 9], 422, "is damaged"),
    (lambda page: re.sub(rb'(outcome/c[^"]*": "....)....', rb"\1AAAA", page), 422, "is damaged"),
    (lambda page: sharing._BLOCK.sub(b"", page), 422, "holds only a part of its numbers"),
    (_resealed(_swapped), 422, "is damaged"),
    (_impossible("flights", 2**31 - 1), 422, "is damaged"),
    (_impossible("end_state", np.nan), 422, "is damaged"),
    (_impossible("end_state", 7.0), 422, "is damaged"),  # a phase beyond 2 pi
    (_resealed(lambda contents: contents.update({"../../evil": b"x"})), 422, "is damaged"),
    (_resealed(lambda contents: contents.pop("zarr.json") and None), 422, "is damaged"),
    (_resealed(lambda contents: contents.update(runs=NEVER)), 422, "is damaged"),
    (_root(f'version": "{KERNEL_VERSION}"', 'version": "0"'), 422, "computed by kernel version 0"),
    (_root('"attributes": {', '"attributes": [], "": {'), 422, "is damaged"),
    (_root('"spec": ', '"spec": [], "": '), 422, "is damaged"),
    (_root('num\\": 11', 'num\\": 12'), 422, "is damaged"),
    (lambda page: page + b" " * 2**25, 413, "longer than 33,554,432 bytes"),
])  # fmt: skip
def test_what_is_none_is_refused_in_one_sentence(
    shared: Shared, elsewhere: Elsewhere, change: Callable[[bytes], bytes], status: int, said: str
):
    client, folder = elsewhere
    answer = client.post("/v1/imports", content=change(shared[0]), headers=HTML)
    assert (answer.status_code, said in answer.json()["detail"]) == (status, True), answer.text
    assert get(client, "/v1/jobs")["jobs"] == []
    wait_for(lambda: not list((folder / "stores").glob("*.zarr*")))


@for_each("text", CROWDED)
def test_what_holds_more_than_any_is_refused_unparsed(text: str):
    digest = hashlib.sha256(text.encode()).hexdigest()
    page = f'{sharing._OPENS}{digest}">{text}</script>'.encode()
    tracemalloc.start()
    with pytest.raises(InvalidRequest, match="is damaged"):
        sharing.import_shared(None, None, None, page)  # type: ignore[arg-type]
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4 * len(page)


@pytest.mark.parametrize(("status", "said"), [(422, "is damaged"), (409, "submitted meanwhile")])
def test_a_store_that_is_not_adopted_says_why(
    shared: Shared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, status: int, said: str
):
    with computing(tmp_path) as client:

        def restore(url: str, *rest: Any) -> None:
            restored(url, *rest)
            if status == 409:
                client.post("/v1/jobs", json=RAMP)
            else:
                Path(url, "zarr.json").write_text("{")

        restored = store.restore
        monkeypatch.setattr(store, "restore", restore)
        answer = client.post("/v1/imports", content=shared[0], headers=HTML)
        assert (answer.status_code, said in answer.json()["detail"]) == (status, True), answer.text


def test_what_is_too_large_for_a_file_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sharing, "MOST_STORED", 1000)
    monkeypatch.setattr("service.views.shared.MOST_BYTES", 6000)
    with computing(tmp_path) as client:
        page = client.get(f"{finished(client, RAMP)}/export?format=html").text
        assert "its numbers are too many to be imported" in page
        assert "Diagrams: 1 line in 2. " in page
        answer = client.post("/v1/imports", content=page.encode(), headers=HTML)
        assert "holds only a part of its numbers" in answer.json()["detail"]
