"""Soak test: consecutive jobs, continuous polls, and one worker killed per minute.

    python -m benchmarks.soak [--minutes 30] [--connections 8] [--kill-every 60] [--rest 0]

Runs `bounce serve` on a free port. Eight sweeps are repeated and deleted after each run; each must store the
same bytes as without kills. Prints one line per minute and at the end the figures of the table in
docs/reliability.md; exits with 1 if a promise is broken.
"""

import argparse
import os
import random
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from benchmarks.machine import describe
from benchmarks.serving import Polls, Serving, sweep

SWEEPS = 8
#: Share of the run before memory is compared: libraries load and caches fill.
WARM_SHARE = 0.2
MORE_MEMORY, MORE_HANDLES = 0.05, 10


class Soak:
    """The run: counts of jobs, wrong results and kills, and samples of the service's memory and handles."""

    def __init__(self, service: Serving) -> None:
        self._service = service
        self._expected = [self._digest(number) for number in range(SWEEPS)]
        self.jobs = self.wrong = self.kills = 0
        self.samples: list[tuple[float, int]] = []  # megabytes, file handles

    def _digest(self, number: int) -> str:
        path = self._service.submit(sweep(number))
        digest = self._service.digest(self._service.wait(path))
        self._service.delete(path)
        return digest

    def compute(self) -> None:
        """Compute one job and check its bytes."""
        number = self.jobs % SWEEPS
        self.wrong += self._digest(number) != self._expected[number]
        self.jobs += 1
        self.samples.append(self._service.used())

    def kill(self, rng: random.Random) -> None:
        """Kill a random worker with SIGKILL."""
        if pids := self._service.worker_pids():
            os.kill(rng.choice(pids), signal.SIGKILL)
            self.kills += 1

    def run(self, seconds: float, kill_every: float, rest: float) -> None:
        """Compute jobs for `seconds`, about `rest` seconds apart, and kill workers at random moments."""
        began = killed = reported = time.monotonic()
        rng = random.Random(1)
        while (now := time.monotonic()) - began < seconds:
            if kill_every and now - killed > kill_every:
                killed = now
                threading.Timer(rng.uniform(0, 2), self.kill, [rng]).start()
            self.compute()
            if now - reported > 60:
                reported = now
                memory, handles = self.samples[-1]
                work = f"{self.jobs} jobs, {self.wrong} wrong, {self.kills} kills"
                print(f"{(now - began) / 60:.0f} min: {work}, {memory:.0f} MB, {handles} handles", flush=True)
            time.sleep(rng.uniform(0, 2 * rest))

    def report(self, polls: Polls) -> int:
        """Print the figures; return 1 if a promise is broken."""
        settled = np.array(self.samples[int(WARM_SHARE * len(self.samples)) :])
        tenth = max(len(settled) // 10, 1)
        first, last = np.median(settled[:tenth], axis=0), np.median(settled[-tenth:], axis=0)
        memory, handles = float(last[0] / first[0] - 1), int(last[1] - first[1])
        p99 = float(np.percentile(polls.seconds, 99)) * 1e3
        print(f"jobs {self.jobs}, wrong {self.wrong}; workers killed {self.kills}")
        print(f"polls {len(polls.seconds)}, p99 {p99:.0f} ms; errors {len(polls.wrong)} {polls.wrong[:3]}")
        print(f"memory {memory:+.1%} of {first[0]:.0f} MB, file handles {handles:+d} of {first[1]:.0f}")
        held = memory <= MORE_MEMORY and abs(handles) <= MORE_HANDLES
        return int(self.wrong > 0 or bool(polls.wrong) or not held)


def main() -> int:
    """Run the test and print the figures."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--minutes", type=float, default=30.0)
    options.add_argument("--connections", type=int, default=8)
    options.add_argument("--kill-every", type=float, default=60.0, help="seconds; 0 for no kills")
    options.add_argument("--rest", type=float, default=0.0, help="approximate seconds between two jobs")
    arguments = options.parse_args()
    print(describe("dask", "fastapi", "uvicorn"))
    with tempfile.TemporaryDirectory() as folder:
        service = Serving(Path(folder))
        try:
            soak = Soak(service)
            with Polls(service.port, "/v1/jobs", arguments.connections, 0.1) as polls:
                soak.run(arguments.minutes * 60, arguments.kill_every, arguments.rest)
            return soak.report(polls)
        finally:
            print(f"shut down in {service.end():.1f} s")


if __name__ == "__main__":
    sys.exit(main())
