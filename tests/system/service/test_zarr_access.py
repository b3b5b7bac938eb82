"""The zarr store over HTTP: ranges of bytes, pages of other origins, dask arrays, and its own address."""

import asyncio
import pickle
from collections.abc import Iterator
from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import xarray
from answering import Answer, scripted
from fastapi.testclient import TestClient
from scripted import DEADLINE, wait_for
from served import RAMP, computing, computing_at, finished
from stores import store_in
from zarr.abc.store import RangeByteRequest
from zarr.core.buffer import default_buffer_prototype

from service.client import Client, NotFound
from service.client.zarr_store import HTTPStore
from service.jobs.prepare import PreparedJob
from worker.study import layout

KEY = "flight_time/c.0.0.0.0.0"


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TestClient, str, bytes]]:
    """A service with a finished job, the address of its store, and what is under KEY."""
    with computing(tmp_path_factory.mktemp("data")) as client:
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
    lazy = job.open(chunks={})
    assert lazy["flight_time"].chunks is not None
    again = pickle.loads(pickle.dumps(lazy))
    xarray.testing.assert_identical(again.load(), job.open().load())
    xarray.testing.assert_equal(xarray.open_zarr(job.store_url).load(), job.open().load())


def test_of_all_bytes_that_a_proxy_may_send_the_part_is_taken():
    with scripted(Answer(200, b"0123456789")) as (_, client):
        store = HTTPStore(client._transport, "/zarr")
        part = asyncio.run(store.get("gamma/c.0", default_buffer_prototype(), RangeByteRequest(2, 5)))
    assert part.to_bytes() == b"234"


def test_whatever_zarr_reads_by_comes_from_the_service(job: Any):
    """`_get_many` of any zarr, `get_ranges` of later ones: no value is read as fill values."""
    store, prototype = HTTPStore(job._transport, f"/v1/jobs/{job.id}/zarr"), default_buffer_prototype()

    async def read() -> list[Any]:
        found = [value async for _, value in store._get_many([("outcome/c.0.0.0.0", prototype, None)])]
        if hasattr(store, "get_ranges"):
            groups = store.get_ranges("outcome/c.0.0.0.0", [RangeByteRequest(0, 8)], prototype=prototype)
            found += [value async for group in groups for _, value in group]
        return found

    assert all(value is not None and len(value) > 0 for value in asyncio.run(read()))


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
    cell = job.open()["flight_time"][0, 0, 0, -1].values
    np.testing.assert_array_equal(cell, whole[0, 0, 0, -1])
    assert cell[0] > 0
    assert {status for status, _ in received} == {206}
    [shard] = sorted(Path(job.store_url, "flight_time").glob("c.0.0.0.0*"))
    assert sum(size for _, size in received) < shard.stat().st_size


def test_of_a_deleted_job_no_cell_is_read_as_missing(tmp_path: Path):
    """Where a key has no value zarr takes its fill value, and the cells would have no flights."""
    with computing_at(tmp_path) as address, Client(address) as client:
        job = client.submit(RAMP).wait()
        opened = [job.open(), job.open(chunks={})]
        without_client, folder = xarray.open_zarr(f"{address}/v1/jobs/{job.id}/zarr"), Path(job.store_url)
        assert job.open().flights.sum() > 0
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


KEYS = {
    "zarr.json": 200,
    "outcome/zarr.json": 200,
    "outcome/c.0.0.0.0": 200,
    "outcome": 404,
    "outcome/c.0.0.0.999999": 404,
    "outcome/c.0.0.0.%D9%A3": 404,  # a three, though not an ASCII one
    "../../ledger.sqlite": 404,
    "%2e%2e/%2e%2e/ledger.sqlite": 404,
    "..%5c..%5cledger.sqlite": 404,
    "/etc/passwd": 404,
    "outcome/../zarr.json": 404,
    "zarr.json%0a": 404,
    ".zarr.json.partial": 404,
    "zarr.json%FF": 404,
}


def on_the_wire(host: str, path: str) -> tuple[int, bytes]:
    """GET a path exactly as it is written, which no well-behaved client does."""
    with closing(HTTPConnection(host, timeout=DEADLINE)) as connection:
        connection.request("GET", path)
        answer = connection.getresponse()
        return answer.status, answer.read()


def test_plain_xarray_opens_the_store_and_only_its_own_keys_lead_anywhere(tmp_path: Path):
    """Not to the ledger, and not to another job."""
    with computing_at(tmp_path) as address, httpx2.Client(base_url=address, timeout=DEADLINE) as client:
        here, other = (finished(client, RAMP | {"settle": settle}) for settle in (10, 11))
        dataset = xarray.open_zarr(f"{address}{here}/zarr", chunks=None).load()
        stored = xarray.open_zarr(store_in(tmp_path, here.rsplit("/", 1)[1]), chunks=None).load()
        xarray.testing.assert_identical(dataset, stored)
        head = client.head(f"{here}/zarr/zarr.json")
        assert (head.status_code, head.content) == (200, b"")
        name = other.rsplit("/", 1)[1]
        ways = (f"../{name}.zarr", f"%2e%2e/{name}.zarr", f"..%2f{name}.zarr", f"../../{name}/zarr")
        for key, expected in (KEYS | {f"{way}/zarr.json": 404 for way in ways}).items():
            status, content = on_the_wire(address.removeprefix("http://"), f"{here}/zarr/{key}")
            assert status == expected, key
            assert b"SQLite" not in content
