"""CPU time of one time step of `stepped`, and of the same step in a plain C loop.

    python -m benchmarks.stepped [--repeat 9] [--compiler cc]

The cell of Fig. 2 at Gamma = 1.5 from rest, adhesive contact, 20 steps per contact. The C loop is
`stepped_loop.c`, compiled with -O3 -march=native. Medians over the repetitions, which alternate.
"""

import argparse
import ctypes
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.machine import describe
from kernel.restitution import damping_ratio
from kernel.step_limits import Scheme, steps_per_period
from tests.support.plates import Model, run_line

CELL = (1.5, 0.5, 0.26)
RESTITUTION = 0.1
PERIODS = 100
PENETRATIONS = (1e-2, 1e-3, 1e-4)


def compile_loop(compiler: str, folder: str) -> Callable[[float, int], float]:
    """Compile the C loop: (penetration, steps per plate period) -> its longest last flight, rad."""
    source, library = Path(__file__).with_name("stepped_loop.c"), Path(folder) / "stepped_loop.so"
    flags = ["-O3", "-march=native", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-o", str(library), str(source), "-lm"], check=True)
    loop = ctypes.CDLL(str(library)).stepped_loop
    real, whole = ctypes.c_double, ctypes.c_int64
    loop.argtypes = [real] * 5 + [whole] * 2 + [ctypes.POINTER(real), ctypes.POINTER(whole)]
    loop.restype = real
    zeta = float(damping_ratio(RESTITUTION, adhesive=True))

    def run(penetration: float, steps: int) -> float:
        longest, flights = real(), whole()
        loop(*CELL, zeta, penetration, steps, PERIODS, longest, flights)
        return longest.value

    return run


def run_kernel(penetration: float, scheme: str) -> float:
    """The longest of the last flights of `stepped`, rad."""
    unit = np.ones(1)
    gamma, omega, xi = (value * unit for value in CELL)
    line = run_line(
        gamma, omega, xi, model=Model.STEPPED, restitution=RESTITUTION * unit, penetration=penetration * unit,
        adhesive=True, carry=False, settle=PERIODS // 2, observe=PERIODS - PERIODS // 2, keep=8,
        scheme=scheme,
    )  # fmt: skip
    return float(np.nanmax(line.flight_time))


def nanoseconds(run: Callable[[], float], steps: int) -> float:
    """CPU time of one step, ns."""
    start = time.process_time()
    run()
    return (time.process_time() - start) / (steps * PERIODS) * 1e9


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=9)
    parser.add_argument("--compiler", default="cc")
    arguments = parser.parse_args()
    print(describe())
    print(f"\n{'d':>8}{'steps/period':>14}{'':4}{'':10}{'ns/step':>9}{'of C':>7}{'longest flight':>18}")
    with tempfile.TemporaryDirectory() as folder:
        loop = compile_loop(arguments.compiler, folder)
        for d in PENETRATIONS:
            steps = int(steps_per_period(RESTITUTION, d, 20))
            runs = {"C loop": lambda d=d, n=steps: loop(d, n)}
            runs |= {s.name.lower(): lambda d=d, s=s: run_kernel(d, s.name.lower()) for s in Scheme}
            flights = {name: run() for name, run in runs.items()}
            times: dict[str, list[float]] = {name: [] for name in runs}
            for _ in range(arguments.repeat):
                for name, run in runs.items():
                    times[name].append(nanoseconds(run, steps))
            cost = {name: statistics.median(each) for name, each in times.items()}
            for name in runs:
                ratio = cost[name] / cost["C loop"]
                print(f"{d:8g}{steps:14}{'':4}{name:10}{cost[name]:9.2f}{ratio:7.2f}{flights[name]:18.9f}")


if __name__ == "__main__":
    main()
