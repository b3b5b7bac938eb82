"""Leave the service running: jobs one after the other, polls all the time, and a worker killed a minute.

    python benchmarks/soak.py [--minutes 30] [--connections 8] [--kill-every 60]

A real `bounce serve` on a free port. Every job's store is checked against the checksums in the ledger,
and one sweep that comes again and again (deleted each time) against the bytes it first had. Prints a line
a minute and, at the end, the figures of the README's reliability table; exits with 1 if one is missed.
"""

import argparse
import hashlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import psutil

MB = 1 << 20
#: Memory is compared from here on: libraries load and caches fill before.
WARM_SHARE = 0.2


def sweep(number: int) -> dict[str, Any]:
    """A few seconds of work, another one for each number."""
    return {
        "name": f"soak {number}",
        "gamma": {"start": 1.0, "stop": 5.0, "num": 400},
        "omega": 0.4 + 0.001 * number,
        "xi": [0.1, 0.26],
        "model": {"kind": "rigid"},
        "settle": 4_000,
        "observe": 50,
        "keep": 16,
    }


@dataclass
class Polls:
    """Answers that many clients got, asking without a pause longer than `pause` seconds."""

    url: str
    pause: float = 0.1
    path: str = "/v1/jobs"
    seconds: list[float] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    over: threading.Event = field(default_factory=threading.Event)

    def work(self) -> None:
        with httpx2.Client(base_url=self.url, timeout=30) as client:
            while not self.over.wait(self.pause):
                began = time.perf_counter()
                try:
                    answer = client.get(self.path)
                except httpx2.TransportError as error:
                    self.wrong.append(repr(error))
                    continue
                self.seconds.append(time.perf_counter() - began)
                if answer.status_code >= 500:
                    self.wrong.append(f"{answer.status_code} {answer.text[:200]}")


class Service:
    """`bounce serve` in a process of its own."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self.url, self.data = f"http://127.0.0.1:{port}", folder / "data"
        command = [
            sys.executable,
            "-m",
            "service.cli",
            "serve",
            "--port",
            str(port),
            "--data",
            str(self.data),
        ]
        with (folder / "service.log").open("wb") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log)
        self._me = psutil.Process(self.process.pid)
        while not self._answers():
            time.sleep(0.2)

    def _answers(self) -> bool:
        if self.process.poll() is not None:
            raise SystemExit("the service ended")
        try:
            return httpx2.get(f"{self.url}/readyz", timeout=10).status_code == 200
        except httpx2.TransportError:
            return False

    def worker_pids(self) -> list[int]:
        """The processes that compute: those with kernels loaded."""
        return [
            child.pid for child in self._me.children(recursive=True) if child.memory_info().rss > 100 * MB
        ]

    def used(self) -> tuple[float, int]:
        """Megabytes and file handles of the service's own process."""
        return self._me.memory_info().rss / MB, self._me.num_fds()

    def end(self) -> float:
        began = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(60)
        return time.monotonic() - began


def digest(store: Path) -> str:
    """Of everything in a store."""
    found = hashlib.sha256()
    for path in sorted(path for path in store.rglob("*") if path.is_file()):
        found.update(str(path.relative_to(store)).encode() + path.read_bytes())
    return found.hexdigest()


def compute(service: Service, number: int) -> tuple[str, float, str]:
    """Submit a sweep and wait for its end: where it is, seconds it took, its store's digest."""
    began = time.monotonic()
    here = httpx2.post(f"{service.url}/v1/jobs", json=sweep(number)).headers["Location"]
    while (job := httpx2.get(service.url + here).json())["state"] in ("queued", "running"):
        time.sleep(0.05)
    if job["state"] != "done":
        raise SystemExit(f"a job is {job['state']}: {json.dumps(job)[:2000]}")
    store = service.data / "stores" / f"{job['id']}.zarr"
    return here, time.monotonic() - began, digest(store)


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--minutes", type=float, default=30.0)
    options.add_argument("--connections", type=int, default=8)
    options.add_argument("--kill-every", type=float, default=60.0, help="seconds; 0 kills nobody")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        service = Service(Path(folder))
        try:
            return soak(service, given.minutes * 60, given.connections, given.kill_every)
        finally:
            print(f"shut down in {service.end():.1f} s")


def soak(service: Service, seconds: float, connections: int, kill_every: float) -> int:
    chance, polls = random.Random(1), Polls(service.url)
    threads = [threading.Thread(target=polls.work) for _ in range(connections)]
    for thread in threads:
        thread.start()
    began = killed = told = time.monotonic()
    samples: list[tuple[float, float, int]] = []
    jobs = kills = wrong = 0
    expected = ""
    try:
        while (now := time.monotonic()) - began < seconds:
            again = jobs % 2 == 0
            here, _, found = compute(service, 0 if again else jobs)
            jobs += 1
            if again:
                expected = expected or found
                wrong += found != expected
            httpx2.delete(service.url + here)
            samples.append((now - began, *service.used()))
            if kill_every and now - killed > kill_every and (pids := service.worker_pids()):
                os.kill(chance.choice(pids), signal.SIGKILL)
                killed, kills = now, kills + 1
            if now - told > 60:
                told = now
                print(
                    f"{(now - began) / 60:.0f} min: {jobs} jobs, {kills} kills, {samples[-1][1:]}", flush=True
                )
    finally:
        polls.over.set()
        for thread in threads:
            thread.join()
    return told_in_the_end(samples, polls, jobs, kills, wrong, seconds)


def told_in_the_end(
    samples: list[tuple[float, float, int]], polls: Polls, jobs: int, kills: int, wrong: int, seconds: float
) -> int:
    """Print the figures; 0 if all are as promised."""
    settled = np.array([sample for sample in samples if sample[0] > WARM_SHARE * seconds])
    first, last = settled[: max(len(settled) // 10, 1)], settled[-max(len(settled) // 10, 1) :]
    memory = float(np.median(last[:, 1]) / np.median(first[:, 1]) - 1)
    handles = int(np.median(last[:, 2]) - np.median(first[:, 2]))
    p99 = float(np.percentile(polls.seconds, 99)) * 1e3
    print(f"jobs {jobs}, of which wrong {wrong}; workers killed {kills}")
    print(f"polls {len(polls.seconds)}, p99 {p99:.0f} ms; errors {len(polls.wrong)} {polls.wrong[:3]}")
    print(f"memory {memory:+.1%}, file handles {handles:+d}")
    return int(wrong > 0 or bool(polls.wrong) or memory > 0.05 or abs(handles) > 10)


if __name__ == "__main__":
    sys.exit(main())
