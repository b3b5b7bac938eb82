"""Adaptive maps against full grids: cells computed, cells wrong, time.

    python -m benchmarks.adaptive [--xi 0.05,0.1,0.26] [--sides 513,1025] [--keep 64]
    python -m benchmarks.adaptive --every 3 [--xi 0.05,0.26] [--sides 1025]

Each map is a job of one service with two worker processes: the full grid, then the adaptive ones, one after
the other, so that a ratio of times holds on a busy machine too. Wrong are cells of another class than in the
full grid: by bouncing at rest or not, by mode another outcome, or mode of up to four plate periods.

With --every n it measures core-seconds instead, which hold on a busy machine: those of every n-th tile,
computed and stored whole and adaptively by turns in this process.
"""

import itertools
import tempfile
import time
from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.measuring import Running, describe, options, service, short, table
from worker import store
from worker.maps.refinement import classes
from worker.spec.refine import Refine
from worker.studies import run_task, study_of
from worker.sweep import SweepSpec
from worker.sweep.schema import MODE_ARRAYS, layout

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
    "mode, first blocks of 8": {"by": "mode", "coarsest": 8},
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
            "keep": keep,
            "model": {"kind": "rigid"},
            "refine": refine,
        }
    )


def plane(running: Running, spec: SweepSpec) -> tuple[_Map, float]:
    """The plane of a map, and the seconds from its submission to its end; the job is deleted."""
    began = time.perf_counter()
    job = running.client.submit(spec).wait(progress=False)
    took = time.perf_counter() - began
    names = [*MODE_ARRAYS, *(["computed"] if spec.refine else [])]
    stored = store.read_slice(
        str(next((running.data / "stores").glob(f"*{job.id}.zarr"))), names, complete=True
    )
    job.delete()
    return {name: array[0, 0] for name, array in stored.items()}, took


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


def measure(running: Running, xi: float, side: int, keep: int) -> Iterator[Measured]:
    """Every adaptive map against the full grid."""
    full, full_seconds = plane(running, sweep(xi, side, keep))
    for name, fields in REFINEMENTS.items():
        spec = sweep(xi, side, keep, fields)
        found, took = plane(running, spec)
        assert spec.refine is not None
        share, differ = float(found["computed"].mean()), wrong(spec.refine, full, found)
        yield Measured(xi, side, name, share, differ, full_seconds, took)


def wrong(refine: Refine, full: _Map, found: _Map) -> int:
    """Cells of another class than in the full grid."""
    kinds = [classes(refine, *(cells[name] for name in MODE_ARRAYS)) for cells in (full, found)]
    return int(np.count_nonzero(kinds[0] != kinds[1]))


def core_seconds(xi: float, side: int, keep: int, every: int) -> dict[str, float]:
    """Core-seconds of every n-th tile, storing included: of all its cells ("full"), and each refinement."""
    specs = {"full": sweep(xi, side, keep)}
    specs |= {name: sweep(xi, side, keep, fields) for name, fields in REFINEMENTS.items()}
    taken = dict.fromkeys(specs, 0.0)
    shape = study_of(specs["mode"]).plan(specs["mode"]).chunk_shape
    with tempfile.TemporaryDirectory() as folder:
        plans = {name: study_of(spec).plan(spec, shape) for name, spec in specs.items()}
        for name, spec in specs.items():
            store.create(f"{folder}/{name}", layout(spec, shape))
            run_task(spec, plans[name][0], f"{folder}/{name}")  # loads the kernel
        for index in range(0, len(plans["full"]), every):
            for name, spec in specs.items():
                began = time.process_time()
                run_task(spec, plans[name][index], f"{folder}/{name}")
                taken[name] += time.process_time() - began
    return taken


def main() -> None:
    """Measure and print."""
    given = options(__doc__, xi=",".join(map(str, PLANES)), sides="513,1025", keep=64, every=0)
    maps = list(itertools.product(map(float, given.xi.split(",")), map(int, given.sides.split(","))))
    print(describe("zarr", "distributed"), flush=True)
    if given.every:
        for xi, side in maps:
            taken = core_seconds(xi, side, given.keep, given.every)
            ratios = [f"{name} {taken['full'] / seconds:.2f}" for name, seconds in taken.items()]
            print(f"{xi:g}, {side:,}², full {taken['full']:.1f} core-s; ratios:", *ratios[1:], flush=True)
        return
    rows = []
    with service() as running:
        plane(running, sweep(0.26, 129, given.keep))  # starts the workers
        for xi, side in maps:
            for measured in measure(running, xi, side, given.keep):
                rows.append(measured.row())
                print("  ".join(rows[-1]), flush=True)
    head = ["xi, grid, by", "computed, %", "wrong", "wrong, %", "full, s", "adaptive, s", "ratio"]
    print(table(head, rows))


if __name__ == "__main__":
    main()
