"""Soak test: jobs, faults and clients mixed, for an hour.

    python -m benchmarks.soak [--minutes 60] [--connections 8] [--fault-every 30] [--clients 3] [--rest 0]

Runs `bounce serve` on a free port, with a scheduler and two workers that are restarted when they end. Eight
sweeps are repeated and deleted after each run; each must store the same bytes as before the first fault.
Meanwhile, one after the other in random order: a worker, the scheduler, or a process that computes answers is
killed; a chunk of a job that is done is damaged; the ledger is locked from outside for eight seconds. Clients
ask for pictures, tables, files and motions; each answer must have the same bytes as before, one client in
five leaves without reading it. Prints a line per minute and at the end the figures of the table in
docs/reliability.md; exits with 1 if a promise is broken.

On a machine that does much else, a request may wait because nothing runs. So waits are bounded by progress,
not by the clock: what takes longer than PATIENCE seconds is a defect, where a second counts by the share of
the time in which threads of the service and its cluster were run, of that in which they could have been; one
in which all of them waited for something else counts in full. A request that times out earlier is repeated,
and what is wrong is printed at once. A poll whose kept connection the service closed as idle, after
KEEP_ALIVE seconds without a request, is sent again on a new one, as HTTP asks of clients.
"""

import argparse
import hashlib
import random
import signal
import socket
import sqlite3
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, Final

import httpx2
import numpy as np
import psutil
import pyarrow
from pyarrow import parquet

from benchmarks.burst import used
from benchmarks.machine import describe
from benchmarks.serving import KEEP_ALIVE, Cluster, Polls, Serving, sweep

SWEEPS: Final = 8
#: Jobs at a time.
JOBS: Final = 2
#: Share of the run before memory is compared: libraries load and caches fill.
WARM_SHARE: Final = 0.2
MORE_MEMORY: Final = 0.05
MORE_HANDLES: Final = 10
LOCKED_SECONDS: Final = 8.0
#: Seconds of progress until an answer must come, damage be repaired and a job done, with faults.
PATIENCE: Final = 300.0
#: Seconds between two counts of progress; the system counts a thread's wait for a processor when it ends.
TICK: Final = 5.0
#: Nanoseconds of a processor below which there was nothing to run.
BLINK: Final = 1_000_000
#: What clients may be told instead of an answer: come again, or that there are no workers or it is repaired.
LATER: Final = (202, 429, 503)


def body_digest(path: str, content: bytes) -> str:
    """Of an answer's bytes; of a Parquet file's columns, as its metadata tells when the job was repaired."""
    if path.endswith("format=parquet"):
        table = parquet.read_table(pyarrow.BufferReader(content)).replace_schema_metadata(None)
        sink = pyarrow.BufferOutputStream()
        with pyarrow.ipc.new_stream(sink, table.schema) as stream:
            stream.write_table(table.combine_chunks())
        content = sink.getvalue().to_pybytes()
    return hashlib.sha256(content).hexdigest()


class Progress:
    """Seconds, each counted by the share for which the machine ran the threads that could run."""

    def __init__(self, processes: Callable[[], list[int]]) -> None:
        self.seconds = 0.0
        self._processes = processes
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._count, daemon=True)
        self._thread.start()

    def _count(self) -> None:
        before, counted = self._times(), time.monotonic()
        while not self._over.wait(TICK):
            times, now = self._times(), time.monotonic()
            known = [(times[thread], before[thread]) for thread in times.keys() & before.keys()]
            ran, waited = (sum(new[i] - old[i] for new, old in known) for i in (0, 1))
            self.seconds += (now - counted) * (ran + BLINK) / (ran + waited + BLINK)
            before, counted = times, now

    def _times(self) -> dict[Path, tuple[int, int]]:
        """Of each thread the nanoseconds for which it ran, and for which it could have."""
        times = {}
        for pid in self._processes():
            for file in Path(f"/proc/{pid}/task").glob("*/schedstat"):
                with suppress(OSError, ValueError):
                    ran, waited, _ = map(int, file.read_text().split())
                    times[file] = ran, waited
        return times

    def end(self) -> None:
        """Count no more."""
        self._over.set()
        self._thread.join()


class Soak:
    """The run: counts of jobs, answers and faults, what was wrong, samples of memory and handles."""

    def __init__(self, service: Serving, cluster: Cluster) -> None:
        self._service, self._cluster = service, cluster
        self._over, self._lock = threading.Event(), threading.Lock()
        self._progress = Progress(self._processes)
        self._began = time.monotonic()
        self.repeated = 0  # requests that timed out before PATIENCE seconds of progress
        self.jobs, self.faults, self.answers = 0, Counter[str](), Counter[int]()
        self.left, self.wrong = 0, list[str]()
        self.samples: list[tuple[float, float, int]] = []  # MB of the service, with its processes; handles
        self._expected = [self._digests(sweep(number)) for number in range(SWEEPS)]
        self._kept = self._submit(sweep(SWEEPS, gammas=2_000, settle=100))
        self._kept_digest = self._service.digest(self._wait(self._kept))
        self._paths = [
            "diagram?xi=0.26", "diagram?xi=0.26&format=csv", "diagram?xi=0.26&format=png",
            "diagram?xi=0.1&format=svg", "modes?xi=0.26", "export?format=parquet",
            "trajectory?gamma=2&xi=0.26", "threshold?xi=0.26",
        ]  # fmt: skip
        self._bodies = {path: self._body(path) for path in self._paths}

    def _processes(self) -> list[int]:
        """The processes of the service and its cluster."""
        programs = (self._service, self._cluster.scheduler, self._cluster.workers)
        roots = [program.process.pid for program in programs]
        found = list(roots)
        for root in roots:
            with suppress(psutil.NoSuchProcess):
                found += [child.pid for child in psutil.Process(root).children(recursive=True)]
        return found

    def _send(self, method: str, path: str, json: Any = None) -> httpx2.Response:
        """The answer to a request. Raises httpx2.TimeoutException after PATIENCE seconds of progress."""
        until = self._progress.seconds + PATIENCE
        while True:
            try:
                return httpx2.request(method, self._service.url + path, json=json, timeout=PATIENCE)
            except httpx2.TimeoutException:
                if self._progress.seconds > until - 1.0:
                    raise
                with self._lock:
                    self.repeated += 1

    def _persist(self, method: str, path: str, json: Any = None) -> httpx2.Response:
        """The answer, asked for again while the ledger is locked. Raises SystemExit on failure."""
        until, repeated = self._progress.seconds + PATIENCE, self.repeated
        while (answer := self._send(method, path, json)).status_code == 503:
            if self._progress.seconds > until:
                break
            time.sleep(1.0)
        gone = method == "DELETE" and answer.status_code == 404 and self.repeated > repeated
        if answer.status_code >= 400 and not gone:
            raise SystemExit(f"{answer.status_code}: {answer.text[:500]}")
        return answer

    def _body(self, path: str) -> str:
        answer = self._send("GET", f"{self._kept}/{path}")
        answer.raise_for_status()
        return body_digest(path, answer.content)

    def _submit(self, spec: dict[str, Any]) -> str:
        return str(self._persist("POST", "/v1/jobs", spec).headers["Location"])

    def _wait(self, path: str) -> dict[str, Any]:
        """The job when it is done. Raises SystemExit if it fails or takes too long."""
        until = self._progress.seconds + PATIENCE
        while (job := self._send("GET", path).json())["state"] in ("queued", "running"):
            if self._progress.seconds > until:
                break
            time.sleep(0.05)
        if job["state"] != "done":
            raise SystemExit(f"a job is {job['state']}: {str(job)[:2000]}")
        return dict(job)

    def _digests(self, spec: dict[str, Any]) -> dict[str, str]:
        path = self._submit(spec)
        digest = self._service.digests(self._wait(path))
        self._persist("DELETE", path)
        return digest

    def _note_wrong(self, what: str) -> None:
        with self._lock:
            self.wrong.append(what)
        print(f"WRONG {what}", flush=True)

    def _in_turn(self, name: str, work: Callable[[random.Random], None], seed: int) -> threading.Thread:
        """A thread that works until the end; an error is noted and does not end it."""

        def loop() -> None:
            rng = random.Random(seed)
            while not self._over.is_set():
                try:
                    work(rng)
                except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it is, it is wrong
                    self._note_wrong(f"{name}: {type(error).__name__}: {error}")
                    self._over.wait(1.0)

        thread = threading.Thread(target=loop, name=name)
        thread.start()
        return thread

    # Jobs

    def _compute(self, numbers: list[int], rest: float) -> Callable[[random.Random], None]:
        """Compute one job after another, and check the bytes of each."""

        def work(rng: random.Random) -> None:
            number = numbers[self.jobs % len(numbers)]
            found, expected = self._digests(sweep(number)), self._expected[number]
            if found != expected:
                names = sorted(name for name, _ in found.items() ^ expected.items())
                self._note_wrong(f"job {number}: {', '.join(names)}")
            with self._lock:
                self.jobs += 1
            self._over.wait(rng.uniform(0, 2 * rest))

        return work

    # Clients

    def _ask(self, rng: random.Random) -> None:
        """One costly request, and its bytes compared with those before the first fault."""
        path = rng.choice(self._paths)
        if rng.random() < 0.2:
            self._leave(path)
        else:
            answer = self._send("GET", f"{self._kept}/{path}")
            with self._lock:
                self.answers[answer.status_code] += 1
            whole = answer.headers.get("Bounce-Complete", "true") == "true"
            if answer.status_code == 200:
                same = body_digest(path, answer.content) == self._bodies[path]
                if not same and whole and b'"complete":false' not in answer.content[-1000:]:
                    self._note_wrong(f"answer {path}")
            elif answer.status_code not in LATER:
                self._note_wrong(f"{answer.status_code} {path}: {answer.text[:200]}")
        self._over.wait(rng.uniform(0, 2.0))

    def _leave(self, path: str) -> None:
        """Ask, and leave while the answer is computed."""
        with socket.create_connection(("127.0.0.1", self._service.port)) as connection:
            connection.sendall(f"GET {self._kept}/{path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
            time.sleep(0.05)
        with self._lock:
            self.left += 1

    # Faults

    def _harm(self, every: float) -> Callable[[random.Random], None]:
        """One fault after the other, all kinds in random order."""
        kinds = [self._kill_worker, self._kill_scheduler, self._kill_answers, self._damage, self._hold_ledger]
        left: list[Callable[[random.Random], str]] = []

        def work(rng: random.Random) -> None:
            if self._over.wait(rng.uniform(0.5, 1.5) * every):
                return
            if not left:
                left.extend(rng.sample(kinds, len(kinds)))
            what = left.pop()(rng)
            with self._lock:
                self.faults[what] += 1

        return work

    def _kill_worker(self, rng: random.Random) -> str:
        family = self._cluster.workers.family()
        processes = [process for process in family if process.memory_info().rss > 100 << 20]
        return self._kill(processes, rng, "workers killed")

    def _kill_scheduler(self, rng: random.Random) -> str:
        self._cluster.scheduler.process.send_signal(signal.SIGKILL)
        return "schedulers killed"

    def _kill_answers(self, rng: random.Random) -> str:
        return self._kill(self._service.answer_processes(), rng, "answer processes killed")

    def _kill(self, processes: list[psutil.Process], rng: random.Random, what: str) -> str:
        if not processes:
            return f"{what} (none there)"
        with suppress(psutil.NoSuchProcess):
            rng.choice(processes).kill()
        return what

    def _damage(self, rng: random.Random) -> str:
        """Change a byte of a stored chunk, ask until it is found, and wait until it is repaired."""
        store = self._service.data / "stores" / f"{self._kept.rpartition('/')[2]}.zarr"
        chunk = rng.choice(sorted((store / "flight_time").glob("c.*")))
        content = bytearray(chunk.read_bytes())
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        chunk.write_bytes(content)
        until = self._progress.seconds + PATIENCE
        while self._service.digest({"id": store.stem}) != self._kept_digest:
            if self._progress.seconds > until:
                self._note_wrong(f"damage of {chunk.name} not repaired")
                break
            for xi in ("0.1", "0.26"):
                self._send("GET", f"{self._kept}/diagram?xi={xi}")
            time.sleep(0.5)
        self._wait(self._kept)
        return "chunks damaged"

    def _hold_ledger(self, rng: random.Random) -> str:
        ledger = self._service.data / "ledger.sqlite"
        with closing(sqlite3.connect(ledger, timeout=PATIENCE, isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            time.sleep(LOCKED_SECONDS)
            other.execute("ROLLBACK")
        return "ledger locked"

    # The run

    def run(self, seconds: float, fault_every: float, clients: int, rest: float) -> None:
        """Everything at once for `seconds`; one line per minute."""
        threads = [
            self._in_turn(f"jobs {i}", self._compute(list(range(i, SWEEPS, JOBS)), rest), i)
            for i in range(JOBS)
        ]
        threads += [self._in_turn(f"client {i}", self._ask, 100 + i) for i in range(clients)]
        if fault_every:
            threads.append(self._in_turn("faults", self._harm(fault_every), 1))
        began = reported = time.monotonic()
        try:
            while (now := time.monotonic()) - began < seconds:
                time.sleep(1.0)
                memory, handles = self._service.used()
                self.samples.append((memory, used(self._service)[0], handles))
                if now - reported > 60:
                    reported = now
                    print(f"{(now - began) / 60:.0f} min: {self._line()}", flush=True)
        finally:
            self._over.set()
            for thread in threads:
                thread.join()
            self._progress.end()

    def _line(self) -> str:
        memory, whole, handles = self.samples[-1]
        return (
            f"{self.jobs} jobs, {sum(self.answers.values())} answers, {sum(self.faults.values())} faults, "
            f"{len(self.wrong)} wrong, {memory:.0f} MB ({whole:.0f} with answers), {handles} handles"
        )

    def report(self, polls: Polls) -> int:
        """Print the figures; return 1 if a promise is broken."""
        settled = np.array(self.samples[int(WARM_SHARE * len(self.samples)) :])
        tenth = max(len(settled) // 10, 1)
        first, last = np.median(settled[:tenth], axis=0), np.median(settled[-tenth:], axis=0)
        memory, handles = float(last[0] / first[0] - 1), int(last[2] - first[2])
        p99 = float(np.percentile(polls.seconds, 99)) * 1e3
        print(f"jobs {self.jobs}; answers {dict(self.answers)}, {self.left} left unread")
        print(f"faults: {dict(self.faults)}")
        print(f"wrong: {len(self.wrong)} {self.wrong[:10]}")
        print(f"polls {len(polls.seconds)}, p99 {p99:.0f} ms; errors {len(polls.wrong)} {polls.wrong[:3]}")
        print(
            f"the machine ran the service for {self._progress.seconds:.0f} of "
            f"{time.monotonic() - self._began:.0f} s; defect: a wait of {PATIENCE:.0f} of the former; "
            f"{self.repeated} requests repeated, {polls.reopened} polls after {KEEP_ALIVE:.0f} s without one"
        )
        print(
            f"memory {memory:+.1%} of {first[0]:.0f} MB, with the processes that compute answers "
            f"{first[1]:.0f} MB, then {last[1]:.0f} MB, at most {settled[:, 1].max():.0f} MB; "
            f"file handles {handles:+d} of {first[2]:.0f}"
        )
        held = memory <= MORE_MEMORY and abs(handles) <= MORE_HANDLES
        return int(bool(self.wrong) or bool(polls.wrong) or not held)


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> int:
    """Run the test and print the figures."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--minutes", type=float, default=60.0)
    options.add_argument("--connections", type=int, default=8, help="that poll the list of jobs")
    options.add_argument("--fault-every", type=float, default=30.0, help="seconds; 0 for no faults")
    options.add_argument("--clients", type=int, default=3)
    options.add_argument("--rest", type=float, default=0.0, help="approximate seconds between two jobs")
    arguments = options.parse_args()
    print(describe("dask", "fastapi", "uvicorn"), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        cluster = Cluster(Path(folder), free_port())
        try:
            service = Serving(Path(folder), "--scheduler", cluster.address)
            try:
                soak = Soak(service, cluster)
                with Polls(service.port, "/v1/jobs", arguments.connections, 0.1) as polls:
                    soak.run(arguments.minutes * 60, arguments.fault_every, arguments.clients, arguments.rest)
                return soak.report(polls)
            finally:
                print(f"shut down in {service.end():.1f} s")
        finally:
            cluster.end()


if __name__ == "__main__":
    sys.exit(main())
