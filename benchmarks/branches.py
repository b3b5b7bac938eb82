"""CPU time of branches with their events, and of thresholds, beside the simulation of one sweep line.

    python -m benchmarks.branches [--repeat 9] [--http]

"branches" is (1,1) and (1,2) on 400 points with every event, "threshold" is Gamma_down with its cause; each
at 20 springs spread over Omega and xi. "line" simulates 400 cells of one such spring for 100 plate periods
each, as a sweep does. Median and largest over the springs of the least of the repetitions, in milliseconds of
CPU time, and medians as ratios to "line". The first spring, Omega = 0.26 and xi = 0.02, has the most events.

--http starts a service and asks it for the orbits (two modes, 400 points, all events) and the thresholds of
200 springs, one at a time: median and 95th percentile of the wall time, and the mean of the service's CPU
time, in milliseconds.
"""

import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import httpx2
import numpy as np

from benchmarks.measuring import describe, options, seconds, short, table
from benchmarks.serving import TIMEOUT, Serving
from kernel.cycles.events import branch_and_events
from kernel.cycles.thresholds import Thresholds, closed_form, thresholds
from tests.support.plates import Model, run_line

OMEGA = np.linspace(0.26, 1.6, 20)
XI = np.geomspace(0.02, 1.0, 20)[np.argsort(np.arange(20) * 7 % 20)]
PERIODS = 100


def both(omega: float, xi: float) -> None:
    """The branches (1,1) and (1,2)."""
    for periods in (1, 2):
        branch_and_events(omega, xi, periods)


def simulated(omega: float, xi: float) -> None:
    """A line of 400 cells over Gamma, from rest."""
    gamma = np.linspace(0.5, 8.0, 400)
    same = np.ones(400)
    run_line(
        gamma, omega * same, xi * same, model=Model.RIGID, restitution=0.0 * same, penetration=same,
        carry=False, settle=PERIODS // 2, observe=PERIODS - PERIODS // 2, keep=16,
    )  # fmt: skip


def milliseconds(call: Callable[[float, float], object], repeat: int) -> tuple[float, float]:
    """The median over the springs, and the largest."""
    times = []
    for omega, xi in zip(OMEGA, XI, strict=True):
        once = partial(call, float(omega), float(xi))
        times.append(1e3 * min(seconds(once, time.process_time) for _ in range(repeat)))
    return statistics.median(times), max(times)


def requests(service: Serving, path: str, count: int = 200) -> tuple[float, float, float]:
    """Median and 95th percentile of the wall time of a request, and the service's CPU time for one; in ms.

    Every spring is asked for once.
    """
    draw = np.random.default_rng(12)
    times = []
    with httpx2.Client(base_url=service.url, timeout=TIMEOUT) as client:
        client.get(path, params={"omega": 0.6, "xi": 0.05})
        before = sum(service.me.cpu_times()[:2])
        for _ in range(count):
            spring = {"omega": draw.uniform(0.26, 1.6), "xi": draw.choice([0.02, 0.05, 0.1, 0.26, 0.8])}
            spring["xi"] *= draw.uniform(0.9, 1.1)
            began = time.perf_counter()
            client.get(path, params=spring).raise_for_status()
            times.append(1e3 * (time.perf_counter() - began))
        taken = 1e3 * (sum(service.me.cpu_times()[:2]) - before) / count
    return float(np.percentile(times, 50)), float(np.percentile(times, 95)), taken


def over_http() -> None:
    """Print what requests take in a service."""
    paths = {"orbits": "/v1/orbits", "threshold": "/v1/threshold"}
    with tempfile.TemporaryDirectory() as folder, Serving(Path(folder)) as service:
        rows = [[name, *map(short, requests(service, path))] for name, path in paths.items()]
    print(table(["over HTTP", "median ms", "p95 ms", "CPU ms"], rows))


def anew(omega: float, xi: float) -> Thresholds:
    """The thresholds of a spring, none of which is kept from before."""
    closed_form.cache_clear()
    return thresholds(omega, xi)


def main() -> None:
    """Print the tables."""
    given = options(__doc__, repeat=9, http=False)
    simulated(0.6, 0.05)  # compiles
    rows = {"branches": both, "threshold": anew, "line": simulated}
    times = {name: milliseconds(call, given.repeat) for name, call in rows.items()}
    print(describe())
    over = times["line"][0]
    shown = [[name, *map(short, (median, most, median / over))] for name, (median, most) in times.items()]
    print(table(["", "ms", "largest", "over a line"], shown))
    if given.http:
        over_http()


if __name__ == "__main__":
    main()
