"""Jobs, reads and faults at once for two minutes, or BOUNCE_TEST_MINUTES: all is right, nothing is held."""

import os
import random
import sqlite3
import time
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import httpx2
import psutil
import pytest
from dask_processes import Cluster, family
from paths import CACHE, ROOT
from scripted import free_port
from stores import store_in

from benchmarks.serving import Polls, Serving, sweep

SECONDS, PATIENCE = 60.0 * float(os.environ.get("BOUNCE_TEST_MINUTES", "2")), 300.0
READS = ("diagram?xi=0.26&format=csv", "diagram?xi=0.1&format=svg", "modes?xi=0.26", "threshold?xi=0.26")


def ask(service: Serving, method: str, path: str, json: object = None) -> httpx2.Response:
    """The answer, asked for again while workers are lost, a chunk is repaired or the ledger is locked."""
    until = time.monotonic() + PATIENCE
    while True:
        answer = httpx2.request(method, service.url + path, json=json, timeout=PATIENCE)
        whole = answer.headers.get("Bounce-Complete") != "false" and answer.status_code not in (429, 503)
        if whole or time.monotonic() > until:
            return answer.raise_for_status()
        time.sleep(0.5)


def harm(service: Serving, cluster: Cluster, store: Path) -> None:
    """Kill a worker, the scheduler or an answer process, lock the ledger, or cut a chunk."""
    kind = random.randrange(5)
    if kind == 3:
        with closing(sqlite3.connect(service.data / "ledger.sqlite", timeout=PATIENCE)) as other:
            other.execute("BEGIN IMMEDIATE")
            time.sleep(8.0)
    elif kind == 4:
        chunk = random.choice(sorted((store / "flight_time").glob("c.*")))
        chunk.write_bytes(chunk.read_bytes()[:-1])
    else:
        workers, scheduler = (family(each.process) for each in (cluster.workers, cluster.scheduler))
        with suppress(psutil.NoSuchProcess, IndexError):
            random.choice([workers, scheduler, service.answer_processes()][kind]).kill()


@pytest.mark.timeout(SECONDS + 4 * PATIENCE)
def test_everything_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(CACHE))
    cluster = Cluster(tmp_path, free_port(), {"PYTHONPATH": str(ROOT)})
    with ExitStack() as stack:
        stack.callback(cluster.end)
        service = stack.enter_context(Serving(tmp_path, "--scheduler", cluster.address))
        kept = service.wait(service.submit(sweep(9, gammas=2_000, settle=100)))
        store, whole = store_in(service.data, kept["id"]), service.digest(kept)

        def results(number: int) -> list[object]:
            job = ask(service, "POST", "/v1/jobs", sweep(number)).headers["Location"]
            files = service.digests(service.wait(job))
            ask(service, "DELETE", job)
            return [files, *(ask(service, "GET", f"/v1/jobs/{kept['id']}/{path}").content for path in READS)]

        def check(number: int) -> None:
            while time.monotonic() < end:
                assert results(number) == expected[number]

        expected, before = [results(number) for number in range(3)], service.used()
        pool, end = stack.enter_context(ThreadPoolExecutor()), time.monotonic() + SECONDS
        with Polls(service.port, "/v1/jobs", 8, 0.1) as polls:
            checks = [pool.submit(check, number) for number in range(3)]
            while wait(checks, 10.0, FIRST_EXCEPTION).not_done and time.monotonic() < end:
                harm(service, cluster, store)
            assert [each.result() for each in checks] == [None] * 3
        assert (polls.wrong, results(0), service.digest(kept)) == ([], expected[0], whole)
        after = service.used()
        assert (after[0] < 1.2 * before[0] + 50.0, after[1] < before[1] + 10) == (True, True), after
