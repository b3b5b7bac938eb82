"""The zarr store over HTTP: ranges of bytes, pages of other origins, dask arrays, and its own address."""

import asyncio
import json
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from answering import Answer, scripted
from fastapi.testclient import TestClient
from scripted import wait_for
from served import RAMP, computing, computing_at, finished
from zarr.abc.store import RangeByteRequest
from zarr.core.buffer import default_buffer_prototype

from service.client import Client, NotFound
from service.client.zarr_store import HTTPStore
from service.jobs.prepare import PreparedJob
from worker.study import layout

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


def test_what_is_no_range_gets_everything(served: tuple[TestClient, str, bytes]):
    client, here, whole = served
    for asked in ("bytes=9-0", "bytes=-", "lines=0-1", "bytes=0-1,4-5", "0-9"):
        answer = client.get(f"{here}/{KEY}", headers={"Range": asked})
        assert (answer.status_code, answer.content) == (200, whole)
    changed = {"Range": "bytes=0-9", "If-Range": '"another"'}
    assert client.get(f"{here}/{KEY}", headers=changed).content == whole


def test_a_range_behind_the_end_is_said(served: tuple[TestClient, str, bytes]):
    client, here, whole = served
    for asked in (f"bytes={len(whole)}-", "bytes=-0"):
        answer = client.get(f"{here}/{KEY}", headers={"Range": asked})
        assert answer.status_code == 416
        assert answer.headers["Content-Range"] == f"bytes */{len(whole)}"
        assert answer.headers["Content-Type"] == "application/problem+json"


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
    assert client.post("/v1/jobs", headers=browser, content=json.dumps(RAMP)).status_code == 403


def test_a_browser_is_told_what_a_page_may_send(served: tuple[TestClient, str, bytes]):
    asked = {"Access-Control-Request-Method": "GET", "Access-Control-Request-Headers": "authorization,range"}
    for origin, status in ((ORIGIN, 200), ("https://evil.example", 400)):
        browser = {"Origin": origin, "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}
        told = served[0].options("/v1/jobs", headers=browser | asked)
        assert told.status_code == status
    told = served[0].options("/v1/jobs", headers=browser | asked | {"Origin": ORIGIN})
    assert told.headers["Access-Control-Allow-Origin"] == ORIGIN
    assert told.headers["Access-Control-Allow-Methods"] == "GET, HEAD"
    assert {"Authorization", "Range"} <= set(told.headers["Access-Control-Allow-Headers"].split(", "))


# The client


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A finished job of a service whose larger chunks are shards, and its client."""
    folder = tmp_path_factory.mktemp("served")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(layout, "WHOLE_BYTES", 500)
        patch.setattr(layout, "INNER_BYTES", 500)
        with computing_at(folder) as address, Client(address) as client:
            grid = RAMP | {"omega": [0.5, 0.7, 0.9, 1.1], "protocol": {"kind": "rest"}}
            grid["gamma"] = {"start": 0.6, "stop": 1.6, "num": 16}
            yield client.submit(grid).wait()


def test_open_with_chunks_gives_dask_arrays_that_can_be_pickled(job: Any):
    for direct in (False, True):
        lazy = job.open(chunks={}, direct=direct)
        assert lazy["flight_time"].chunks is not None
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


def test_of_all_bytes_that_a_proxy_may_send_the_part_is_taken():
    with scripted(Answer(200, b"0123456789")) as (_, client):
        store = HTTPStore(client._transport, "/zarr")
        part = asyncio.run(store.get("gamma/c.0", default_buffer_prototype(), RangeByteRequest(2, 5)))
    assert part.to_bytes() == b"234"


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


def test_of_a_deleted_job_no_cell_is_read_as_missing(tmp_path: Path):
    """Where a key has no value zarr takes its fill value, and the cells would have no flights."""
    with computing_at(tmp_path) as address, Client(address) as client:
        job = client.submit(RAMP).wait()
        opened = [job.open(), job.open(chunks={}), job.open(direct=True)]
        without_client, folder = xarray.open_zarr(f"{address}/v1/jobs/{job.id}/zarr"), Path(job.store_url)
        assert all(dataset.flights.sum() > 0 for dataset in [job.open(), job.open(direct=True)])
        job.delete()
        wait_for(lambda: not folder.exists())
        for dataset in opened:
            with pytest.raises(NotFound, match="was it deleted"):
                dataset.flights.load()
        with pytest.raises(Exception, match="410"):
            without_client.flights.load()
        with pytest.raises(NotFound, match="was it deleted"):
            job.open()


def test_of_a_job_deleted_before_its_file_is_read_no_cell_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    with computing(tmp_path) as client:
        here, read = finished(client, RAMP), PreparedJob.read_file

        def read_late(job: PreparedJob, key: str, **state: bool) -> bytes | None:
            client.delete(here)
            wait_for(lambda: not Path(job.store_url).exists())
            return read(job, key, **state)

        monkeypatch.setattr(PreparedJob, "read_file", read_late)
        assert client.get(f"{here}/zarr/{KEY}").status_code == 410
