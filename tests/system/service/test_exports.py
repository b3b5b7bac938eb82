"""Stores over HTTP, on a real connection."""

from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path

import httpx2
import xarray
from scripted import DEADLINE
from served import RAMP, computing_at, finished
from stores import store_in

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
