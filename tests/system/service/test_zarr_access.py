"""The zarr store over HTTP: ranges of bytes, pages of other origins, dask arrays, and its own address."""

import asyncio
import json
import pickle
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import xarray
from answering import Answer, scripted
from fastapi.testclient import TestClient
from pydantic import ValidationError
from served import RAMP, computing, finished
from zarr.abc.store import OffsetByteRequest, RangeByteRequest, SuffixByteRequest
from zarr.core.buffer import default_buffer_prototype

from service.api.app import create_app
from service.client import BadRequest, Client, UnexpectedAnswer
from service.client.zarr_store import HTTPStore, store_url
from service.server import embedded
from service.settings import Settings
from worker import schema
from worker.executors.inline import Inline

ORIGIN = "https://viewer.example"
KEY = "flight_time/c.0.0.0.0.0"


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TestClient, str, bytes]]:
    """A service with a finished job, the address of its store, and what is under KEY."""
    with computing(tmp_path_factory.mktemp("data"), cors_origins=ORIGIN) as client:
        here = f"{finished(client, RAMP)}/zarr"
        yield client, here, client.get(f"{here}/{KEY}").content


# Ranges


def test_ranges_are_parts_of_the_whole(served: tuple[TestClient, str, bytes]):
    client, here, whole = served
    size = len(whole)
    for asked, first, last in (
        ("0-9", 0, 9), ("5-5", 5, 5), ("10-", 10, size - 1), ("-7", size - 7, size - 1),
        (f"0-{size + 99}", 0, size - 1), (f"-{size + 99}", 0, size - 1),
    ):  # fmt: skip
        answer = client.get(f"{here}/{KEY}", headers={"Range": f"bytes={asked}"})
        assert answer.status_code == 206, asked
        assert answer.content == whole[first : last + 1]
        assert answer.headers["Content-Range"] == f"bytes {first}-{last}/{size}"
        assert int(answer.headers["Content-Length"]) == last - first + 1


@pytest.mark.parametrize(
    "asked", ["bytes=9-0", "bytes=-", "bytes=a-b", "lines=0-1", "bytes=0-1,4-5", "0-9", ""]
)
def test_what_is_no_range_gets_everything(served: tuple[TestClient, str, bytes], asked: str):
    client, here, whole = served
    answer = client.get(f"{here}/{KEY}", headers={"Range": asked})
    assert (answer.status_code, answer.content) == (200, whole)
    assert answer.headers["Accept-Ranges"] == "bytes"


def test_a_range_behind_the_end_is_said(served: tuple[TestClient, str, bytes]):
    client, here, whole = served
    for asked in (f"bytes={len(whole)}-", "bytes=-0"):
        answer = client.get(f"{here}/{KEY}", headers={"Range": asked})
        assert answer.status_code == 416
        assert answer.headers["Content-Range"] == f"bytes */{len(whole)}"
        assert answer.headers["Content-Type"] == "application/problem+json"


def test_a_range_of_what_may_have_changed_gets_everything(served: tuple[TestClient, str, bytes]):
    client, here, whole = served
    answer = client.get(f"{here}/{KEY}", headers={"Range": "bytes=0-9", "If-Range": '"another"'})
    assert (answer.status_code, answer.content) == (200, whole)


def test_head_tells_the_size(served: tuple[TestClient, str, bytes]):
    client, here, whole = served
    answer = client.head(f"{here}/{KEY}")
    assert (answer.status_code, answer.content) == (200, b"")
    assert int(answer.headers["Content-Length"]) == len(whole)
    assert answer.headers["Accept-Ranges"] == "bytes"
    assert client.head(f"{here}/outcome/c.9.9.9.9").status_code == 404


# Pages of other origins


def test_pages_of_the_origins_in_the_settings_may_read(served: tuple[TestClient, str, bytes]):
    client, here, whole = served
    browser = {"Origin": ORIGIN, "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}
    answer = client.get(f"{here}/{KEY}", headers=browser | {"Range": "bytes=0-9"})
    assert (answer.status_code, answer.content) == (206, whole[:10])
    assert answer.headers["Access-Control-Allow-Origin"] == ORIGIN
    assert "Content-Range" in answer.headers["Access-Control-Expose-Headers"]
    assert answer.headers["Cross-Origin-Resource-Policy"] == "cross-origin"
    assert "Origin" in answer.headers["Vary"]
    assert "Access-Control-Allow-Credentials" not in answer.headers


def test_others_may_not_and_nobody_may_change_anything(served: tuple[TestClient, str, bytes]):
    client, here, _ = served
    for origin in ("https://evil.example", "https://viewer.example.evil.example", "null"):
        browser = {"Origin": origin, "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}
        answer = client.get(f"{here}/{KEY}", headers=browser)
        assert answer.status_code == 403
        assert "Access-Control-Allow-Origin" not in answer.headers
    browser = {"Origin": ORIGIN, "Sec-Fetch-Site": "cross-site", "Content-Type": "application/json"}
    refused = client.post("/v1/jobs", headers=browser, content=json.dumps(RAMP))
    assert refused.status_code == 403
    assert "Access-Control-Allow-Origin" not in refused.headers


def preflight(client: TestClient, path: str, origin: str, method: str = "GET") -> httpx2.Response:
    asked = {"Access-Control-Request-Method": method, "Access-Control-Request-Headers": "authorization,range"}
    browser = {"Origin": origin, "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}
    return client.options(path, headers=browser | asked)  # type: ignore[return-value]


def test_a_browser_is_told_what_a_page_may_send(tmp_path: Path):
    settings = Settings(data=tmp_path, token="secret-token-of-16-characters", cors_origins=f" {ORIGIN}/ ")
    with closing(Inline()) as executor, TestClient(
        create_app(settings, executor), base_url="http://localhost"
    ) as client:  # fmt: skip
        told = preflight(client, "/v1/jobs", ORIGIN)
        assert told.status_code == 204
        assert told.headers["Access-Control-Allow-Origin"] == ORIGIN
        assert told.headers["Access-Control-Allow-Methods"] == "GET, HEAD"
        assert {"Authorization", "Range"} <= set(told.headers["Access-Control-Allow-Headers"].split(", "))
        assert preflight(client, "/v1/jobs", "https://evil.example").status_code == 403
        browser = {"Origin": ORIGIN, "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}
        assert client.get("/v1/jobs", headers=browser).status_code == 401
        browser["Authorization"] = "Bearer secret-token-of-16-characters"
        assert client.get("/v1/jobs", headers=browser).status_code == 200


def test_without_the_setting_no_page_may(tmp_path: Path):
    with computing(tmp_path) as client:
        browser = {"Origin": ORIGIN, "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}
        answer = client.get("/v1/jobs", headers=browser)
        assert answer.status_code == 403
        assert "Vary" not in answer.headers
        assert preflight(client, "/v1/jobs", ORIGIN).status_code == 403


@pytest.mark.parametrize("origin", ["*", "null", "viewer.example", "https://viewer.example/page", "file://x"])
def test_what_is_no_origin_is_refused(origin: str):
    with pytest.raises(ValidationError, match="an origin is"):
        Settings(cors_origins=origin)


# The client


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A finished job of a service whose larger chunks are shards, and its client."""
    folder = tmp_path_factory.mktemp("served")
    with pytest.MonkeyPatch.context() as patch, closing(Inline()) as executor:
        patch.setattr(schema, "SHARD_BYTES", 500)
        patch.setattr(schema, "INNER_BYTES", 500)
        settings = embedded.settings(data=folder, port=0, heartbeat_seconds=0.2)
        with embedded.running(settings, executor) as address, Client(address) as client:
            grid = RAMP | {"omega": [0.5, 0.7, 0.9, 1.1], "protocol": {"kind": "rest"}}
            grid["gamma"] = {"start": 0.6, "stop": 1.6, "num": 16}
            yield client.submit(grid).wait()


def test_open_with_chunks_gives_dask_arrays_as_stored(job: Any):
    lazy, eager = job.open(chunks={}), job.open().load()
    assert lazy["flight_time"].chunks is not None
    xarray.testing.assert_identical(lazy.load(), eager)


def test_such_a_dataset_can_be_pickled(job: Any):
    for direct in (False, True):
        lazy = job.open(chunks={}, direct=direct)
        again = pickle.loads(pickle.dumps(lazy))
        xarray.testing.assert_identical(again.load(), job.open().load())


def store_of(job: Any, address: str | None = None) -> HTTPStore:
    return HTTPStore(job._transport, job._path("zarr"), address)


def test_the_store_is_read_directly_where_it_is_the_same(job: Any, tmp_path: Path):
    assert Path(job.store_url, "zarr.json").is_file()
    assert store_of(job, job.store_url).reads_directly
    other = tmp_path / "other.zarr"
    other.mkdir()
    (other / "zarr.json").write_text("{}")
    for address in (str(other), str(tmp_path / "nowhere"), "s3://nowhere/at-all"):
        assert not store_of(job, address).reads_directly
    assert not store_of(job).reads_directly


def test_a_store_is_read_only(job: Any):
    buffer = default_buffer_prototype().buffer.from_bytes(b"")
    for store in (store_of(job), store_of(job, job.store_url)._direct):
        assert store is not None
        assert store.read_only
    store = store_of(job)
    assert (store.supports_writes, store.supports_deletes, store.supports_listing) == (False,) * 3
    for change in (lambda: store.set("zarr.json", buffer), lambda: store.delete("zarr.json")):
        with pytest.raises(PermissionError, match="read only"):
            asyncio.run(change())


def test_stores_are_the_same_where_they_read_the_same(job: Any):
    store = store_of(job)
    assert store == store_of(job)
    assert hash(store) == hash(store_of(job))
    assert str(store) == f"{job._transport.url}/v1/jobs/{job.id}/zarr"
    other = HTTPStore(job._transport, "/v1/jobs/other/zarr")
    assert store != other
    assert store != (store._transport, store._path)
    assert len({store, store_of(job), other}) == 2


#: Parts of a value, and what they are of ten bytes.
PARTS = (
    (None, slice(None)),
    (RangeByteRequest(2, 5), slice(2, 5)),
    (RangeByteRequest(4, 4), slice(4, 4)),
    (OffsetByteRequest(7), slice(7, None)),
    (SuffixByteRequest(3), slice(-3, None)),
)


async def read(store: HTTPStore, key: str) -> tuple[bytes | None, list[bytes | None], bool]:
    """A key's value, its PARTS, and whether there is one."""
    prototype = default_buffer_prototype()
    value = await store.get(key, prototype)
    parts = await store.get_partial_values(prototype, [(key, part) for part, _ in PARTS])
    contents = [None if part is None else part.to_bytes() for part in parts]
    return None if value is None else value.to_bytes(), contents, await store.exists(key)


def test_a_part_of_a_value_is_that_part(job: Any):
    whole = Path(job.store_url, "outcome", "c.0.0.0.0").read_bytes()
    for address in (None, job.store_url):
        content, parts, exists = asyncio.run(read(store_of(job, address), "outcome/c.0.0.0.0"))
        assert (content, exists) == (whole, True)
        assert parts == [whole[part] for _, part in PARTS]
    behind = OffsetByteRequest(len(whole))
    store = store_of(job)
    found = asyncio.run(store.get("outcome/c.0.0.0.0", default_buffer_prototype(), behind))
    assert found is not None
    assert found.to_bytes() == b""


def test_what_is_not_there_has_no_value(job: Any):
    for key in ("outcome/c.9.9.9.9", "outcome/.zarray", ".zgroup"):
        assert asyncio.run(read(store_of(job), key)) == (None, [None] * len(PARTS), False)


def test_a_service_that_sends_all_bytes_has_their_part_taken(job: Any):
    """As a proxy may."""
    content = b"0123456789"
    answers = [Answer(200, content) for _ in (None, *PARTS, None)]
    with scripted(*answers) as (server, client):
        store = HTTPStore(client._transport, "/zarr")
        value, parts, exists = asyncio.run(read(store, "gamma/c.0"))
    assert (value, exists) == (content, True)
    assert parts == [content[part] for _, part in PARTS]
    asked = [headers.get("Range") for _, _, headers in server.requests]
    assert asked == [None, None, "bytes=2-4", None, "bytes=7-", "bytes=-3", None]


def test_what_a_store_refuses_is_told(job: Any):
    with scripted(Answer(400, {"detail": "no"}), Answer(body={})) as (_, client):
        store = HTTPStore(client._transport, "/zarr")
        with pytest.raises(BadRequest, match="no"):
            store._read("gamma/c.0")
        with pytest.raises(UnexpectedAnswer, match="does not tell where it has its stores"):
            store_url(client._transport, "/zarr", "0" * 32)


def test_reading_directly_asks_the_service_for_metadata_alone(job: Any, monkeypatch: pytest.MonkeyPatch):
    asked: list[str] = []
    real = type(job._transport).get

    def get(self: Any, path: str, *given: Any, **more: Any) -> Any:
        asked.append(path)
        return real(self, path, *given, **more)

    monkeypatch.setattr(type(job._transport), "get", get)
    directly = job.open(direct=True).load()
    # Where the store is, whether it is the same there, and what it holds: of the service each time.
    assert [path.rpartition("/zarr/")[2] for path in asked] == ["zarr.json"] * 3
    asked.clear()
    for given, elsewhere in (({"chunks": {}}, False), ({}, True), ({"chunks": {}, "direct": False}, True)):
        job.open(**given).outcome.load()
        assert any("/c." in path for path in asked) is elsewhere
        asked.clear()
    job.open()
    assert len([path for path in asked if path.endswith("/zarr.json")]) == 1  # of all arrays at once
    asked.clear()
    xarray.testing.assert_identical(job.open(chunks={}, direct=False).load(), directly)
    assert any("/c." in path for path in asked)


def test_of_a_shard_parts_are_sent(job: Any, monkeypatch: pytest.MonkeyPatch):
    received: list[tuple[int, int]] = []
    real = type(job._transport).get

    def get(self: Any, path: str, *given: Any, **more: Any) -> Any:
        answer = real(self, path, *given, **more)
        if "flight_time/c." in path:
            received.append((answer.status_code, len(answer.content)))
        return answer

    dataset = job.open()
    whole = dataset["flight_time"].values
    monkeypatch.setattr(type(job._transport), "get", get)
    cell = job.open()["flight_time"][0, 0, 0, 0].values
    np.testing.assert_array_equal(cell, whole[0, 0, 0, 0])
    assert {status for status, _ in received} == {206}
    [shard] = sorted(Path(job.store_url, "flight_time").glob("c.0.0.0.0*"))
    assert sum(size for _, size in received) < shard.stat().st_size
