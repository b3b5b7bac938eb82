"""Stores over HTTP, on a real connection."""

from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path

import httpx2
import pytest
import xarray
from scripted import DEADLINE
from served import RAMP, computing_at, finished


def test_the_store_opens_over_http_with_plain_xarray(tmp_path: Path):
    with (
        computing_at(tmp_path) as address,
        httpx2.Client(base_url=address, timeout=DEADLINE) as client,
    ):
        here = finished(client, RAMP)  # type: ignore[arg-type]
        dataset = xarray.open_zarr(f"{address}{here}/zarr", chunks=None).load()
        (url,) = tmp_path.rglob("*.zarr")
        xarray.testing.assert_identical(dataset, xarray.open_zarr(url, chunks=None).load())
        head = client.head(f"{here}/zarr/zarr.json")
        assert (head.status_code, head.content) == (200, b"")


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


@pytest.fixture(scope="module")
def wire(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str, str]]:
    """A service's host and port, and two jobs of it that are done."""
    with (
        computing_at(tmp_path_factory.mktemp("data")) as address,
        httpx2.Client(base_url=address, timeout=DEADLINE) as client,
    ):
        first, other = (finished(client, {**RAMP, "settle": settle}) for settle in (10, 11))  # type: ignore[arg-type]
        yield address.removeprefix("http://"), first, other


def on_the_wire(host: str, path: str) -> tuple[int, bytes]:
    """GET a path exactly as it is written, which no well-behaved client does."""
    connection = HTTPConnection(host, timeout=DEADLINE)
    connection.request("GET", path)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


def test_only_the_stores_own_keys_lead_anywhere(wire: tuple[str, str, str]):
    """Not to the ledger, and not to another job."""
    host, here, other = wire
    name = other.rsplit("/", 1)[1]
    ways = (f"../{name}.zarr", f"%2e%2e/{name}.zarr", f"..%2f{name}.zarr", f"../../{name}/zarr")
    for key, expected in (KEYS | {f"{way}/zarr.json": 404 for way in ways}).items():
        status, content = on_the_wire(host, f"{here}/zarr/{key}")
        assert status == expected, key
        assert b"SQLite" not in content
