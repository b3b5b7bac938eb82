"""Stores in an S3-compatible bucket (a server of moto's): the same bytes as in a folder."""

import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from chunks import planned
from extras import SYSTEM
from fastapi.testclient import TestClient
from pyarrow import parquet
from scripted import DEADLINE, Held, wait_for
from served import RAMP, finished, get, service
from stores import files, store_in

from worker.executors.dask import Dask
from worker.executors.inline import Inline
from worker.store import backend
from worker.studies import run_task
from worker.study import ChunkOptions
from worker.study.chunks import with_options
from worker.sweep import SweepSpec

ThreadedMotoServer = pytest.importorskip("moto.server", reason=SYSTEM).ThreadedMotoServer

BUCKET_URL = "s3://results/of/sweeps"

ENVIRONMENT = {
    "AWS_ENDPOINT_URL": "the server's",
    "AWS_ACCESS_KEY_ID": "test",
    "AWS_SECRET_ACCESS_KEY": "test",
    "AWS_REGION": "us-east-1",
    "AWS_ALLOW_HTTP": "true",
}


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    """The address of a server with one empty bucket; the environment variables point to it."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    address = f"http://{host}:{port}"
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (ENVIRONMENT | {"AWS_ENDPOINT_URL": address}).items():
            patch.setenv(name, value)
        assert httpx2.put(f"{address}/results", timeout=DEADLINE).status_code == 200
        yield address
    backend._client.cache_clear()  # its connections are to this server
    server.stop()


@pytest.fixture(scope="module")
def both(
    bucket: str, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, tuple[TestClient, str]]]:
    """The same job done by two services, one with a folder and one with the bucket."""
    executor = Inline()
    folders = [tmp_path_factory.mktemp("data") for _ in range(2)]
    with service(folders[0], executor) as local, service(folders[1], executor, stores=BUCKET_URL) as remote:
        yield {"folder": (local, finished(local, RAMP)), "bucket": (remote, finished(remote, RAMP))}
    executor.close()


def test_every_answer_is_the_same(both: dict[str, tuple[TestClient, str]]):
    settings = both["bucket"][0].app.state.service.settings  # type: ignore[attr-defined]
    assert not list(settings.data.rglob("*.zarr"))
    for query in (
        "diagram?omega=0.5&xi=0.26&direction=down",
        "diagram?omega=0.5&xi=0.26&format=csv",
        "modes?xi=0.05",
        "threshold?xi=0.05",
    ):
        answers = [client.get(f"{here}/{query}") for client, here in both.values()]
        assert [answer.status_code for answer in answers] == [200, 200]
        assert answers[0].content == answers[1].content
    files = [client.get(f"{here}/export?format=parquet").content for client, here in both.values()]
    tables = [parquet.read_table(io.BytesIO(content)) for content in files]
    assert tables[0].equals(tables[1])  # but for the times in their metadata


def test_every_byte_is_the_same(both: dict[str, tuple[TestClient, str]]):
    (local, here), (remote, there) = both["folder"], both["bucket"]
    settings = local.app.state.service.settings  # type: ignore[attr-defined]
    stored = files(store_in(settings.data, here.rsplit("/", 1)[1]))
    assert len([key for key in stored if key.startswith("flight_time/c.")]) > 1
    for key, content in stored.items():
        if not key.startswith("."):
            assert remote.get(f"{there}/zarr/{key}").content == content, key


class Counting:
    """A bucket's client that notes its calls."""

    def __init__(self, real: Any) -> None:
        self._real, self.calls = real, []

    def __getattr__(self, name: str) -> Any:
        self.calls.append(name)
        return getattr(self._real, name)


def test_a_chunk_is_stored_with_few_requests(bucket: str, monkeypatch: pytest.MonkeyPatch):
    """One for each array; what the chunks before it have asked is not asked again."""
    spec, url = SweepSpec(**RAMP | {"protocol": {"kind": "rest"}}), f"{BUCKET_URL}/few.zarr"
    plan = planned(url, spec, (1, 1, 4))
    real = backend._client
    counting = Counting(real(url))
    monkeypatch.setattr(backend, "_client", lambda address: counting if address == url else real(address))
    with with_options(ChunkOptions(begins=True)):
        run_task(spec, plan[0], url)
        first = len(counting.calls)
        for chunk in plan[1:4]:
            run_task(spec, chunk, url)
    assert counting.calls[first:] == ["put"] * 6 * 3


def test_a_bucket_that_fails_in_mid_chunk_costs_no_try(
    bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    held = Held(capacity=1)
    monkeypatch.setattr(backend, "_RETRY_TIMEOUT", backend._RETRY_TIMEOUT / 30)
    with service(tmp_path, held, stores=f"{BUCKET_URL}/middle", chunk_tries=1) as client:
        here = client.post("/v1/jobs", json=RAMP).headers["Location"]
        wait_for(held.held)
        with monkeypatch.context() as away:
            away.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
            backend._client.cache_clear()
            held.let_go()
        backend._client.cache_clear()  # no other makes one with the address that is away
        held.let_go_until(lambda: get(client, here)["state"] not in ("queued", "running"))
        assert get(client, here)["state"] == "done"


def test_delete_leaves_nothing(bucket: str, tmp_path: Path):
    executor = Inline()
    with service(tmp_path, executor, stores=f"{BUCKET_URL}/delete") as client:
        here = finished(client, RAMP)
        url = client.app.state.service.settings.store_of(f"1-{here.rsplit('/', 1)[1]}.zarr")  # type: ignore[attr-defined]
        assert backend.read_key(url, "zarr.json") is not None
        assert client.delete(here).status_code == 204
        wait_for(lambda: backend.read_key(url, "zarr.json") is None)
        wait_for(lambda: not list(backend._client(url).list()))
    executor.close()


def test_workers_of_a_cluster_write_to_the_bucket(
    bucket: str, both: dict[str, tuple[TestClient, str]], tmp_path: Path, cluster: Dask
):
    """Worker processes that know the bucket from their environment variables, as in a deployment."""
    run = cluster._connection.client.run
    known = {name: os.environ[name] for name in ENVIRONMENT}
    run(os.environ.update, known)
    try:
        with service(tmp_path, cluster, stores=f"{BUCKET_URL}/cluster") as client:
            here = finished(client, RAMP)
            _, inline = both["bucket"]
            for key in ("outcome/c.0.0.0.0", "flight_time/c.1.0.0.0.0", "end_state/c.0.0.0.0.0"):
                stored = client.get(f"{here}/zarr/{key}")
                assert stored.status_code == 200
                assert stored.content == both["bucket"][0].get(f"{inline}/zarr/{key}").content
            long = {**RAMP, "settle": 1_000_000, "protocol": {"kind": "rest"}}
            slow = client.post("/v1/jobs", json=long).headers["Location"]
            wait_for(lambda: get(client, slow)["state"] == "running")
            client.post(f"{slow}/cancel")
            wait_for(lambda: get(client, slow)["state"] == "cancelled")
    finally:
        for name in known:
            run(os.environ.pop, name, None)


def test_a_bucket_that_is_missing_is_named_in_one_line(bucket: str):
    for ask in (lambda: backend.names_in("s3://none/x"), lambda: backend.put("s3://none/x", "a", b"")):
        with pytest.raises(backend.Unreachable, match=r"^[^\n<]*: The specified bucket does not exist$"):
            ask()


def test_a_bucket_that_does_not_answer_is_waited_for(
    bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    address = os.environ["AWS_ENDPOINT_URL"]
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setattr(backend, "_RETRY_TIMEOUT", backend._RETRY_TIMEOUT / 30)
    executor = Inline()
    with service(tmp_path, executor, stores=f"{BUCKET_URL}/away") as client:
        here = client.post("/v1/jobs", json=RAMP).headers["Location"]
        wait_for(lambda: sum("its bucket does not answer" in message for message in caplog.messages) >= 2)
        job = get(client, here)
        assert (job["state"], job["notice"]) == ("queued", client.get("/readyz").json()["detail"])
        assert "bucket of the stores does not answer" in job["notice"]
        answer: Any = client.get(f"{here}/modes?xi=0.26")
        assert (answer.status_code, answer.headers["Retry-After"]) == (503, "2")
        assert "does not answer" in answer.json()["detail"]
        assert "127.0.0.1" not in answer.text
        assert client.get("/healthz").status_code == 200
        monkeypatch.setenv("AWS_ENDPOINT_URL", address)
        backend._client.cache_clear()
        wait_for(lambda: get(client, here)["state"] == "done")
        assert client.get("/readyz").status_code == 200
    executor.close()
