"""A whole sweep with the service and with alternatives, on two processes each.

    python -m benchmarks.sweeps [--gamma 1000 --omega 20 --xi 5] [--cells 16] [--repeat 3]

`rigid`, 300 plate periods per cell from rest, over the range of the atlas; every time includes storing the
results. joblib and dask.bag map scipy's solve_ivp (DOP853, benchmarks/scipy_rival.py) over --cells random
cells of the grid, extrapolated to the whole grid. xsweep and joblib with this project's kernel compute the
whole grid in lines along Gamma and keep the same flights and outcomes: xsweep in its zarr store, joblib in
memory. In both, the kernel is compiled and the workers are running beforehand.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dask.bag
import joblib
import numpy as np
import xarray as xr
import xsweep

from benchmarks import scipy_rival
from benchmarks.atlas import atlas, warm
from benchmarks.machine import describe
from benchmarks.tables import short, table
from kernel.params import Line
from service.client import Client
from service.server import embedded
from tests.support.plates import Model, run_line
from worker.spec import SweepSpec

PERIODS = 300
KEEP = 16
PROCESSES = 2


def kernel_line(gamma: np.ndarray, omega: float, xi: float) -> Line:
    """All values of Gamma at one Omega and xi, as a task of the service computes them."""
    full = np.full_like
    return run_line(
        gamma, full(gamma, omega), full(gamma, xi), model=Model.RIGID, restitution=full(gamma, 0.0),
        penetration=full(gamma, 1e-3), adhesive=True, carry=False, settle=200, observe=100, keep=KEEP,
    )  # fmt: skip


def scipy_cell(cell: tuple[float, float, float]) -> list[float]:
    """The last flights of one cell, as a script would keep them."""
    return scipy_rival.run(*cell, PERIODS)[-KEEP:]


@xsweep.sweep(
    "loop(omega, xi) vec(gamma) -> flight_time(gamma, flight), takeoff_phase(gamma, flight), outcome(gamma)",
    version="1",
)
def swept_line(gamma: Any, omega: float, xi: float) -> Any:
    """The same line, for xsweep."""
    done = kernel_line(np.ascontiguousarray(gamma, float), float(omega), float(xi))
    return xr.Dataset(
        {
            "flight_time": (("gamma", "flight"), done.flight_time),
            "takeoff_phase": (("gamma", "flight"), done.takeoff_phase),
            "outcome": (("gamma",), done.outcome.astype(float)),
        }
    )


def by_xsweep(axes: dict[str, np.ndarray], folder: Path) -> None:
    """xsweep on two threads (the kernel releases the GIL), with its zarr store."""
    space = xr.Dataset({name: (name, values) for name, values in axes.items()})
    space = space.assign_coords(flight=np.arange(KEEP))  # xsweep needs the length of every dimension
    policy = xsweep.SweepPolicy(store=folder / "xsweep.zarr", executor="thread", max_workers=PROCESSES)
    swept_line(space, policy=policy)


def by_joblib_kernel(axes: dict[str, np.ndarray]) -> None:
    """joblib with the same kernel, results in memory."""
    lines = ((axes["gamma"], omega, xi) for omega in axes["omega"] for xi in axes["xi"])
    joblib.Parallel(n_jobs=PROCESSES)(joblib.delayed(kernel_line)(*line) for line in lines)


def by_joblib_scipy(cells: list[tuple[float, float, float]]) -> None:
    """The loop of a script over processes of joblib."""
    joblib.Parallel(n_jobs=PROCESSES)(joblib.delayed(scipy_cell)(cell) for cell in cells)


def by_bag_scipy(cells: list[tuple[float, float, float]]) -> None:
    """The same with dask.bag."""
    bag = dask.bag.from_sequence(cells, partition_size=2)
    bag.map(scipy_cell).compute(scheduler="processes", num_workers=PROCESSES)


def seconds(run: Callable[[], Any], repeat: int, first: bool = True) -> float:
    """Median wall time, s; with `first`, a run beforehand, which starts the processes, is not counted."""
    if first:
        run()
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def by_service(spec: dict[str, Any], repeat: int) -> float:
    """Time over HTTP from submission to completion, on warm workers; every repetition is a new job."""
    with tempfile.TemporaryDirectory() as folder:
        settings = embedded.settings(data=Path(folder), workers=PROCESSES, host="127.0.0.1", port=0)
        with embedded.running(settings) as url, Client(url) as client:
            warm(client)
            shifts = iter(range(repeat))

            def run() -> None:
                gamma = spec["gamma"] | {"start": spec["gamma"]["start"] + 1e-9 * next(shifts)}
                client.submit(spec | {"gamma": gamma}).wait(progress=False)

            return seconds(run, repeat, first=False)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, default in (("gamma", 1000), ("omega", 20), ("xi", 5), ("cells", 16), ("repeat", 3)):
        parser.add_argument(f"--{name}", type=int, default=default)
    arguments = parser.parse_args()
    print(describe("scipy", "joblib", "dask", "xsweep"), flush=True)
    spec = atlas(arguments.gamma, arguments.omega, arguments.xi)
    axes = {name: SweepSpec.model_validate(spec).axis_values(name) for name in ("gamma", "omega", "xi")}
    rng = np.random.default_rng(1)
    cells = [tuple(float(rng.choice(axes[name])) for name in axes) for _ in range(arguments.cells)]
    kernel_line(axes["gamma"][:8], 1.0, 0.1)  # compile before processes are forked
    whole = arguments.gamma * arguments.omega * arguments.xi
    rows: list[tuple[str, int, float]] = []
    times = []
    for _ in range(arguments.repeat):
        with tempfile.TemporaryDirectory() as folder:
            times.append(seconds(lambda f=folder: by_xsweep(axes, Path(f)), 1, first=False))
    rows.append(("xsweep, the same kernel", whole, statistics.median(times)))
    rows.append(("joblib, the same kernel", whole, seconds(lambda: by_joblib_kernel(axes), arguments.repeat)))
    rows.append(("joblib over scipy DOP853", len(cells), seconds(lambda: by_joblib_scipy(cells), 1)))
    rows.append(("dask.bag over scipy DOP853", len(cells), seconds(lambda: by_bag_scipy(cells), 1, False)))
    own = by_service(spec, arguments.repeat)
    rows.insert(0, ("this service, over HTTP", whole, own))
    head = ["", "cells computed", "s", f"s for {whole:,} cells", "relative to the service"]
    shown = [
        (name, f"{cells:,}", short(took), short(took / cells * whole), short(took / cells * whole / own))
        for name, cells, took in rows
    ]
    print("\n" + table(head, shown))


if __name__ == "__main__":
    main()
