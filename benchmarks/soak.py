"""Leave the service running: jobs one after the other, polls all the time, and a worker killed a minute.

    python -m benchmarks.soak [--minutes 30] [--connections 8] [--kill-every 60] [--rest 0]

A real `bounce serve` on a free port. Eight sweeps come again and again, deleted each time; each must leave
the bytes that it left when nobody was killed. Prints a line a minute and, at the end, the figures of the
table of docs/reliability.md; exits with 1 if one is missed.
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
#: Memory is compared from here on: libraries load and caches fill before.
WARM_SHARE = 0.2
MORE_MEMORY, MORE_HANDLES = 0.05, 10


class Soak:
    """What was done so far, and what the service's process used meanwhile."""

    def __init__(self, service: Serving) -> None:
        self._service = service
        self._expected = [self._digest(number) for number in range(SWEEPS)]
        self.jobs = self.wrong = self.kills = 0
        self.samples: list[tuple[float, int]] = []  # megabytes, file handles

    def _digest(self, number: int) -> str:
        path = self._service.submit(sweep(number))
        found = self._service.digest(self._service.wait(path))
        self._service.delete(path)
        return found

    def compute(self) -> None:
        """One job, and whether it is right."""
        number = self.jobs % SWEEPS
        self.wrong += self._digest(number) != self._expected[number]
        self.jobs += 1
        self.samples.append(self._service.used())

    def kill(self, chance: random.Random) -> None:
        """End a worker without a word."""
        if pids := self._service.worker_pids():
            os.kill(chance.choice(pids), signal.SIGKILL)
            self.kills += 1

    def go_on(self, seconds: float, kill_every: float, rest: float) -> None:
        """Jobs, with `rest` seconds between two, and kills at random moments of them."""
        began = killed = told = time.monotonic()
        chance = random.Random(1)
        while (now := time.monotonic()) - began < seconds:
            if kill_every and now - killed > kill_every:
                killed = now
                threading.Timer(chance.uniform(0, 2), self.kill, [chance]).start()
            self.compute()
            if now - told > 60:
                told = now
                memory, handles = self.samples[-1]
                work = f"{self.jobs} jobs, {self.wrong} wrong, {self.kills} kills"
                print(f"{(now - began) / 60:.0f} min: {work}, {memory:.0f} MB, {handles} handles", flush=True)
            time.sleep(chance.uniform(0, 2 * rest))

    def told(self, polls: Polls) -> int:
        """Print the figures; 0 if all are as promised."""
        settled = np.array(self.samples[int(WARM_SHARE * len(self.samples)) :])
        tenth = max(len(settled) // 10, 1)
        first, last = np.median(settled[:tenth], axis=0), np.median(settled[-tenth:], axis=0)
        memory, handles = float(last[0] / first[0] - 1), int(last[1] - first[1])
        p99 = float(np.percentile(polls.seconds, 99)) * 1e3
        print(f"jobs {self.jobs}, of which wrong {self.wrong}; workers killed {self.kills}")
        print(f"polls {len(polls.seconds)}, p99 {p99:.0f} ms; errors {len(polls.wrong)} {polls.wrong[:3]}")
        print(f"memory {memory:+.1%} of {first[0]:.0f} MB, file handles {handles:+d} of {first[1]:.0f}")
        held = memory <= MORE_MEMORY and abs(handles) <= MORE_HANDLES
        return int(self.wrong > 0 or bool(polls.wrong) or not held)


def main() -> int:
    """Soak, and print the figures."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--minutes", type=float, default=30.0)
    options.add_argument("--connections", type=int, default=8)
    options.add_argument("--kill-every", type=float, default=60.0, help="seconds; 0 kills nobody")
    options.add_argument("--rest", type=float, default=0.0, help="seconds between two jobs, about")
    given = options.parse_args()
    print(describe("dask", "fastapi", "uvicorn"))
    with tempfile.TemporaryDirectory() as folder:
        service = Serving(Path(folder))
        try:
            soak = Soak(service)
            with Polls(service.port, "/v1/jobs", given.connections, 0.1) as polls:
                soak.go_on(given.minutes * 60, given.kill_every, given.rest)
            return soak.told(polls)
        finally:
            print(f"shut down in {service.end():.1f} s")


if __name__ == "__main__":
    sys.exit(main())
