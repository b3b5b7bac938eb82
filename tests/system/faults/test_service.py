"""A service that is killed: at every step between accepting a job and its end, and at random moments.

Nothing is lost or orphaned, and only chunks that were in flight are computed again.
`BOUNCE_TEST_RUNS=10` for the long version.
"""

import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from paths import ROOT
from scripted import DEADLINE, wait_for
from served import Serving, serving
from service_life import STEPS
from stores import files, marked_and_sound, store_in
from studies import spec_of

from service.settings import Settings

RUNS = int(os.environ.get("BOUNCE_TEST_RUNS", "2"))

#: Those that come once.
ONCE = ("store laid out", "job ends")
#: The step, and how many times it comes before the service is killed.
KILLS = [(step, times) for step in STEPS for times in (1, 3) if times == 1 or step not in ONCE]

SWEEP = spec_of((2.0, 5.0, 40), 0.5, 0.26, window=(10_000, 20, 8))


class Lives:
    """Runs of a service, one after the other, on one data folder (see service_life.py)."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "data"
        (folder / "spec.json").write_text(json.dumps(SWEEP))
        command = [sys.executable, str(ROOT / "tests" / "support" / "service_life.py")]
        self._process = subprocess.Popen(
            [*command, str(self.folder), str(folder / "spec.json")], cwd=ROOT, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=os.environ | {"PYTHONPATH": str(ROOT)},
        )  # fmt: skip

    def live(self, step: str = "-", times: int = 1, seconds: float | None = None) -> dict[str, Any]:
        self._process.stdin.write(json.dumps([step, times, seconds]) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line, f"service_life.py ended with {self._process.wait()}"
        return json.loads(line)

    def forget(self) -> None:
        shutil.rmtree(self.folder)

    def end(self) -> None:
        with self._process:
            self._process.stdin.close()


@pytest.fixture(scope="module")
def lives(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lives]:
    lives = Lives(tmp_path_factory.mktemp("lives"))
    yield lives
    lives.end()


@pytest.fixture(scope="module")
def calm(lives: Lives) -> dict[str, bytes]:
    """The files after a run without faults."""
    assert lives.live()["state"] == "done"
    return files(lives.folder / "stores")


@pytest.mark.parametrize(("step", "times"), KILLS)
def test_killed_at_a_step_nothing_is_lost_and_little_is_computed_again(
    lives: Lives, calm: dict[str, bytes], step: str, times: int
):
    lives.forget()
    first = lives.live(step, times)
    assert first["killed"]
    second = lives.live()
    assert second["state"] == "done"
    again = set(first["chunks"]) & set(second["chunks"])
    assert len(again) <= 3  # one in work, one whose report was on its way, one not yet in the ledger
    assert files(lives.folder / "stores") == calm


def test_killed_at_any_moment(lives: Lives, calm: dict[str, bytes]):
    chance = random.Random(7)
    for _ in range(RUNS):
        lives.forget()
        ends = []
        while not ends or ends[-1]["killed"]:
            ends.append(lives.live(seconds=None if len(ends) > 4 else chance.uniform(0.05, 0.6)))
        computed = [chunk for life in ends for chunk in life["chunks"]]
        assert ends[-1]["state"] == "done"
        assert len(computed) - len(set(computed)) <= 2 * len(ends)
        assert files(lives.folder / "stores") == calm


#: As a script starts background jobs.
IGNORING_SIGINT = ("sh", "-c", 'trap "" INT; exec "$@"', "sh")


def chunks_done(service: Serving, path: str) -> int:
    return int(service.ask("GET", path).json()["progress"]["chunks_done"])


def test_the_real_service_killed_stopped_and_started_again(tmp_path: Path):
    """kill -9 with chunks at its workers; SIGTERM with a request that never ends; SIGINT, ignored at first.

    The last two with SIGINT ignored by whoever started the service: it stops on both signals all the same.
    """
    sweep = SWEEP | {"gamma": {"start": 2.0, "stop": 5.0, "num": 20_000}, "settle": 12_000}
    one_worker = {"BOUNCE_WORKERS": "1"}
    with serving(tmp_path, variables=one_worker) as service:
        path = service.ask("POST", "/v1/jobs", json=sweep).headers["Location"]
        wait_for(lambda: chunks_done(service, path) >= 2)
        service.process.send_signal(signal.SIGKILL)
        service.process.wait()
    with serving(tmp_path, IGNORING_SIGINT, variables=one_worker) as service:
        done = chunks_done(service, path)
        assert done >= 2
        wait_for(lambda: chunks_done(service, path) > done)
        with socket.create_connection(("127.0.0.1", httpx2.URL(service.url).port)) as stalled:
            stalled.sendall(b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n{")
            time.sleep(0.2)
            service.process.terminate()
            assert service.process.wait(DEADLINE) == 0
    with serving(tmp_path, IGNORING_SIGINT, variables=one_worker) as service:
        job = service.ask("GET", path).json()
        assert job["state"] in ("running", "queued", "done")
        assert job["progress"]["chunks_done"] > done
        service.ask("POST", f"{path}/cancel")
        wait_for(lambda: service.ask("GET", path).json()["state"] in ("cancelled", "done"))
        service.process.send_signal(signal.SIGINT)
        assert service.process.wait(DEADLINE) == 130
    assert marked_and_sound(Settings(data=tmp_path / "data"), job["id"]) > done


def test_the_log_has_one_object_a_line_where_a_worker_raises_too(tmp_path: Path):
    with serving(tmp_path, variables={"BOUNCE_WORKERS": "1"}) as service:
        path = service.ask("POST", "/v1/jobs", json=SWEEP | {"settle": 10}).headers["Location"]
        wait_for(lambda: service.ask("GET", path).json()["state"] == "done")
        (store_in(tmp_path / "data", path.rpartition("/")[2]) / "zarr.json").unlink()
        wait_for(lambda: service.ask("GET", f"{path}/audit").status_code == 503)
    lines = [line for line in service.log.read_text().splitlines() if not line.startswith("bounce listens")]
    assert [line for line in lines if not isinstance(json.loads(line), dict)] == []
