"""Adaptive maps against full grids: cells computed, cells wrong, time.

    python -m benchmarks.adaptive [--xi 0.05,0.1,0.26] [--sides 513,1025] [--keep 64] [--rounds 16]
    python -m benchmarks.adaptive --every 3 [--xi 0.05,0.26] [--sides 1025]

Each map is a job of one service with two worker processes: the full grid, then the adaptive ones, one after
the other, so that a ratio of times holds on a busy machine too. Wrong are cells of another class than in the
full grid: by bouncing at rest or not, by mode another outcome, or mode of up to four plate periods.

Then what it costs that the rounds of a tile wait for one another: the kernel's time for --rounds tiles, round
by round as a task computes them, relative to that for the same cells as one line.

With --every n it measures core-seconds instead, which hold on a busy machine: those of every n-th tile,
computed and stored whole and adaptively by turns in this process.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import describe
from benchmarks.tables import short, table
from service.jobs.ledger import Ledger
from service.jobs.manager import JobManager
from service.jobs.model import JobState
from service.settings import Settings
from worker import store
from worker.executors.dask import Dask
from worker.kernel_cache import use_cache
from worker.plan import make_plan
from worker.refinement import Refinement, classes
from worker.schema import MODE_ARRAYS, layout
from worker.spec import SweepSpec
from worker.spec.refine import SETTLE_UNTIL, Refine
from worker.tasks import run_cells, run_chunk

#: The part of the plane at each xi: gamma and omega from where cells rest to where most have no mode.
PLANES: Final = {
    0.05: ((0.3, 4.2), (0.28, 1.4)),
    0.1: ((0.3, 4.5), (0.28, 1.4)),
    0.26: ((0.9, 6.0), (0.2, 1.2)),
}

#: What is compared, by its name in the table.
REFINEMENTS: Final[Mapping[str, dict[str, Any]]] = {
    "bouncing": {"by": "bouncing"},
    "mode": {"by": "mode"},
    "mode, first blocks of 64": {"by": "mode", "coarsest": 64},
    "mode, margin": {"by": "mode", "margin": True},
}

_Map = dict[str, NDArray[Any]]


def sweep(xi: float, side: int, keep: int, refine: dict[str, Any] | None = None) -> SweepSpec:
    """The map at xi on a grid of side x side cells."""
    gamma, omega = PLANES[xi]
    return SweepSpec.parse(
        {
            "name": f"adaptive {refine}",
            "gamma": {"start": gamma[0], "stop": gamma[1], "num": side},
            "omega": {"start": omega[0], "stop": omega[1], "num": side},
            "xi": xi,
            "settle_until": SETTLE_UNTIL,  # of the full grid too
            "keep": keep,
            "model": {"kind": "rigid"},
            "refine": refine,
        }
    )


class Service:
    """A service on two worker processes that runs one job at a time."""

    def __init__(self, folder: Path) -> None:
        self._settings = Settings(data=folder)
        self._executor = Dask(workers=2)
        self._ledger = Ledger(self._settings.ledger_path)
        self._manager = JobManager(self._ledger, self._executor, self._settings)
        self._manager.start()

    def run(self, spec: SweepSpec) -> tuple[_Map, float]:
        """The plane of a map, and the seconds from its submission to its end; the job is deleted."""
        began = time.perf_counter()
        job = self._manager.submit(spec).job
        while job.state is not JobState.DONE:
            time.sleep(0.02)
            found = self._ledger.find(job.id)
            assert found is not None
            assert found.error is None, found.error
            job = found
        took = time.perf_counter() - began
        names = [name for name in (*MODE_ARRAYS, "computed") if name != "computed" or spec.refine]
        stored = store.read_slice(self._settings.store_of(job.id), names, complete=True)
        self._manager.delete(job.id)
        return {name: array[0, 0] for name, array in stored.items()}, took

    def close(self) -> None:
        """Stop the service and its workers."""
        self._manager.stop()
        self._executor.close()


@contextmanager
def serving() -> Iterator[Service]:
    """A service in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder, closing(Service(Path(folder))) as service:
        yield service


class Measured(NamedTuple):
    """One adaptive map against the full grid."""

    xi: float
    side: int
    name: str
    computed: float  # share of the cells
    wrong: int
    full_seconds: float
    seconds: float

    def row(self) -> list[str]:
        """A row of the table."""
        share = self.wrong / self.side**2
        return [
            f"{self.xi:g}, {self.side:,}², {self.name}", f"{100 * self.computed:.2f}", f"{self.wrong:,}",
            f"{100 * share:.3f}", f"{self.full_seconds:.1f}", f"{self.seconds:.2f}",
            short(self.full_seconds / self.seconds, 2),
        ]  # fmt: skip


def measure(service: Service, xi: float, side: int, keep: int) -> Iterator[Measured]:
    """Every adaptive map against the full grid."""
    full, full_seconds = service.run(sweep(xi, side, keep))
    for name, fields in REFINEMENTS.items():
        spec = sweep(xi, side, keep, fields)
        found, seconds = service.run(spec)
        assert spec.refine is not None
        yield Measured(
            xi, side, name, float(found["computed"].mean()), wrong(spec.refine, full, found), full_seconds,
            seconds,
        )  # fmt: skip


def wrong(refine: Refine, full: _Map, found: _Map) -> int:
    """Cells of another class than in the full grid."""
    kinds = [classes(refine, *(cells[name] for name in MODE_ARRAYS)) for cells in (full, found)]
    return int(np.count_nonzero(kinds[0] != kinds[1]))


def core_seconds(xi: float, side: int, keep: int, every: int) -> dict[str, float]:
    """Core-seconds of every n-th tile, storing included: of all its cells ("full"), and each refinement."""
    specs = {"full": sweep(xi, side, keep)}
    specs |= {name: sweep(xi, side, keep, fields) for name, fields in REFINEMENTS.items()}
    taken = dict.fromkeys(specs, 0.0)
    shape = make_plan(specs["mode"]).chunk_shape
    with tempfile.TemporaryDirectory() as folder:
        plans = {name: make_plan(spec, chunk_shape=shape) for name, spec in specs.items()}
        for name, spec in specs.items():
            store.create(f"{folder}/{name}", layout(spec, shape))
            run_chunk(spec, plans[name][0], f"{folder}/{name}")  # loads the kernel
        for index in range(0, len(plans["full"]), every):
            for name, spec in specs.items():
                began = time.process_time()
                run_chunk(spec, plans[name][index], f"{folder}/{name}")
                taken[name] += time.process_time() - began
    return taken


def cost_of_rounds(spec: SweepSpec, tiles: int) -> float:
    """Time of every round as a line of its own, over that of all cells of a tile as one line."""
    assert spec.refine is not None
    axes = {name: spec.axis_values(name) for name in ("gamma", "omega")}
    xi = float(spec.axis_values("xi")[0])
    plan = make_plan(spec)
    in_rounds = at_once = 0.0
    for index in np.linspace(0, len(plan) - 1, tiles).astype(int).tolist():
        chunk = plan[index]
        gamma, omega = np.meshgrid(axes["gamma"][slice(*chunk.gamma)], axes["omega"][slice(*chunk.omega)])
        known = {name: np.zeros(gamma.size, np.int32) for name in MODE_ARRAYS}
        tile, cells = Refinement(gamma.shape, spec.refine), [np.empty(0, np.int64)]
        while tile.cells.size:
            cells.append(tile.cells)
            began = time.thread_time()
            line = compute(spec, gamma, omega, xi, tile.cells)
            in_rounds += time.thread_time() - began
            for name, array in known.items():
                array[tile.cells] = getattr(line, name)
            tile.split(*(array.reshape(gamma.shape) for array in known.values()))
        began = time.thread_time()
        compute(spec, gamma, omega, xi, np.concatenate(cells))
        at_once += time.thread_time() - began
    return in_rounds / at_once


def compute(
    spec: SweepSpec,
    gamma: NDArray[np.float64],
    omega: NDArray[np.float64],
    xi: float,
    cells: NDArray[np.int64],
) -> Any:
    """The record of some cells of a tile."""
    return run_cells(spec, gamma.flat[cells], omega.flat[cells], np.full(len(cells), xi), None)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--xi", default=",".join(map(str, PLANES)))
    parser.add_argument("--sides", default="513,1025")
    parser.add_argument("--keep", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=16)
    parser.add_argument("--every", type=int, default=0)
    options = parser.parse_args()
    xis, sides = map(float, options.xi.split(",")), [int(side) for side in options.sides.split(",")]
    print(describe("zarr", "distributed"), flush=True)
    if options.every:
        for xi in xis:
            for side in sides:
                taken = core_seconds(xi, side, options.keep, options.every)
                ratios = [f"{name} {taken['full'] / seconds:.2f}" for name, seconds in taken.items()]
                print(f"{xi:g}, {side:,}², full {taken['full']:.1f} core-s; ratios:", *ratios[1:], flush=True)
        return
    use_cache()  # so that one process compiles instead of three
    rows = []
    with serving() as service:
        service.run(sweep(0.26, 129, options.keep))  # starts the workers
        for xi in xis:
            for side in sides:
                for measured in measure(service, xi, side, options.keep):
                    rows.append(measured.row())
                    print("  ".join(rows[-1]), flush=True)
    print(
        table(["xi, grid, by", "computed, %", "wrong", "wrong, %", "full, s", "adaptive, s", "ratio"], rows)
    )
    for by in ("bouncing", "mode") if options.rounds else ():
        cost = cost_of_rounds(sweep(0.05, max(sides), options.keep, {"by": by}), options.rounds)
        print(f"rounds one after the other, by {by}: {cost:.2f} times the time of one line")


if __name__ == "__main__":
    main()
