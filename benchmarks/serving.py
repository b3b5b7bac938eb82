"""A `bounce serve` process, jobs for it, and connections that poll it."""

import asyncio
import hashlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import httpx2
import psutil

from benchmarks.measuring import HERE

MB = 1 << 20
#: Time-out of a request, s; the machine may be busy.
TIMEOUT = 60.0
#: Seconds after which the service closes a connection without a request: the default of uvicorn.
KEEP_ALIVE = 5.0


def sweep(number: int, gammas: int = 400, settle: int = 4_000) -> dict[str, Any]:
    """A sweep for each number, all of the same work: about a second of one core."""
    return {
        "name": f"benchmark {number}",
        "gamma": {"start": 1.0, "stop": 5.0, "num": gammas},
        "omega": 0.4 + 0.001 * number,
        "xi": [0.1, 0.26],
        "model": {"kind": "rigid"},
        "settle": settle,
        "observe": 50,
        "keep": 16,
    }


class Serving:
    """The service of a checkout on a free port with its own folder, which is ready when this returns."""

    def __init__(self, folder: Path, *more_options: str, tree: Path = HERE) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.url, self.data = f"http://127.0.0.1:{self.port}", folder / "data"
        options = ["--port", str(self.port), "--data", str(self.data), *more_options]
        with (folder / "service.log").open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "service.cli.entry", "serve", *options],
                cwd=tree, env=os.environ | {"PYTHONPATH": str(tree)}, stdout=log, stderr=log,
            )  # fmt: skip
        self.me = psutil.Process(self.process.pid)
        while not self._answers():
            time.sleep(0.2)

    def __enter__(self) -> "Serving":
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.end()

    def _answers(self) -> bool:
        if self.process.poll() is not None:
            raise SystemExit("the service ended")
        try:
            return httpx2.get(f"{self.url}/readyz", timeout=10).status_code == 200
        except httpx2.TransportError:
            return False

    def used(self) -> tuple[float, int]:
        """Megabytes and file handles of the service's own process."""
        return self.me.memory_info().rss / MB, self.me.num_fds()

    def answer_processes(self) -> list[psutil.Process]:
        """The processes in which it computes answers: those of lower priority."""
        return [child for child in self.me.children() if child.nice() > self.me.nice()]

    def submit(self, spec: dict[str, Any]) -> str:
        """The path of the job."""
        return str(httpx2.post(f"{self.url}/v1/jobs", json=spec, timeout=TIMEOUT).headers["Location"])

    def wait(self, path: str) -> dict[str, Any]:
        """The job when it is done; raises SystemExit if it fails."""
        while (job := self._job(path))["state"] in ("queued", "running"):
            time.sleep(0.05)
        if job["state"] != "done":
            raise SystemExit(f"a job is {job['state']}: {json.dumps(job)[:2000]}")
        return job

    def _job(self, path: str) -> dict[str, Any]:
        """The job, asked for again while the service says that it is not ready."""
        while (answer := httpx2.get(self.url + path, timeout=TIMEOUT)).status_code == 503:
            time.sleep(0.5)
        return dict(answer.raise_for_status().json())

    def cells_done(self, path: str) -> int:
        """How many cells of a job are done."""
        return int(self._job(path)["progress"]["cells_done"])

    def cancel(self, path: str) -> None:
        """Cancel a job."""
        httpx2.post(f"{self.url}{path}/cancel", timeout=TIMEOUT).raise_for_status()

    def delete(self, path: str) -> None:
        """Delete a job."""
        httpx2.delete(self.url + path, timeout=TIMEOUT).raise_for_status()

    def digests(self, job: dict[str, Any]) -> dict[str, str]:
        """SHA-256 of every file of a job's store, by its name."""
        [store] = (self.data / "stores").glob(f"*{job['id']}.zarr")
        return {
            str(path.relative_to(store)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(path for path in store.rglob("*") if path.is_file())
        }

    def digest(self, job: dict[str, Any]) -> str:
        """SHA-256 of all files of a job's store together."""
        return hashlib.sha256(repr(self.digests(job)).encode()).hexdigest()

    def end(self) -> float:
        """Stop it with SIGTERM and return how long that took, s."""
        began = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(60)
        return time.monotonic() - began


def used(service: Serving) -> float:
    """Megabytes of the service with the processes that compute its answers."""
    return service.used()[0] + sum(map(megabytes, service.answer_processes()))


def megabytes(process: psutil.Process) -> float:
    """Memory of a process, which may have ended."""
    try:
        return float(process.memory_info().rss) / MB
    except psutil.NoSuchProcess:
        return 0.0


class Polls:
    """Connections that request one path repeatedly, `pause` seconds after each response.

    They use sockets directly: a client library would use more processor time than the service. A connection
    that the service closed after KEEP_ALIVE seconds without a request is opened anew and counted.
    """

    def __init__(self, port: int, path: str, connections: int, pause: float) -> None:
        self.seconds: list[float] = []
        self.wrong: list[str] = []
        self.reopened = 0
        self._port, self._pause, self._connections = port, pause, connections
        self._request = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
        self._over = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._work()))

    def __enter__(self) -> "Polls":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    async def _work(self) -> None:
        await asyncio.gather(*(self._poll(number) for number in range(self._connections)))

    async def _poll(self, number: int) -> None:
        await asyncio.sleep(self._pause * number / self._connections)
        reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
        answered = time.perf_counter()
        while not self._over.is_set():
            began = time.perf_counter()
            try:
                status = await self._send(reader, writer)
            except (OSError, asyncio.IncompleteReadError) as error:
                if time.perf_counter() - answered >= KEEP_ALIVE:
                    self.reopened += 1
                else:
                    self.wrong.append(repr(error))
                reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
                answered = time.perf_counter()
                continue
            answered = time.perf_counter()
            self.seconds.append(answered - began)
            if status >= 400:
                self.wrong.append(str(status))
            await asyncio.sleep(self._pause)
        writer.close()

    async def _send(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> int:
        writer.write(self._request)
        head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").lower()
        await reader.readexactly(int(head.split("content-length: ")[1].split("\r\n")[0]))
        return int(head.split()[1])
