"""Basins of attraction: the time of a large plane, attractors told apart in random cells, coexisting ones.

    python -m benchmarks.basins time [--side 256]
    python -m benchmarks.basins cells [--kind rigid] [--seed 11] [--count 14] [--side 64]
    python -m benchmarks.basins planes [--side 40]

`time`: one cell of `side` x `side` drops with the default windows, settle 1,500 at xi .05; such a cell is one
task on one core.

`cells`: random cells in which a coarse plane shows more than one motion. A few starts of every attractor
found are run for 5,000 plate periods and grouped independently: cycles by mode and flights within 1e-6 rad,
other motions by which parts of the plane (flight time, take-off phase) they visit in 3,000 plate periods.
Spurious is an attractor of more than 0.3 % that shares such a group with another; merged, one that is in two.

`planes`: multistability over `side` x `side` cells at two xi, 24 drops a cell: the share of cells with two
attractors or more.
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.measuring import describe, options, short, table
from kernel.line import run_line
from kernel.params import Line, Outcome, counted_flights
from service.views.multistability import MultistabilityQuery, compute
from service.views.selection import Stored
from worker import store
from worker.basins.attractors import Found, find
from worker.basins.multistability import run_chunk as compute_lines
from worker.basins.specification import BasinSpec, MultistabilitySpec
from worker.basins.starts import starts_of
from worker.basins.task import run_chunk
from worker.studies import STUDIES
from worker.sweep import AXES
from worker.work import plate_of

#: Of `time`: cells with a smooth and with a fractal boundary, with a chaotic attractor and with slow cycles.
TIMED: Final = (
    (3.6, 0.5, 0.26), (1.27, 0.5, 0.26), (5.0, 0.5, 0.26), (0.7, 0.6, 0.05), (1.0, 0.34, 0.05),
    (3.8, 1.0, 0.05),
)  # fmt: skip

#: Of `planes`: xi, and the ranges of gamma and omega.
PLANES: Final = ((0.05, (0.3, 4.2), (0.28, 1.4)), (0.26, (0.9, 6.0), (0.2, 1.2)))

#: Of `cells`: the contact, and the ranges of gamma and omega.
KINDS: Final[dict[str, tuple[dict[str, Any], tuple[float, float]]]] = {
    "rigid": ({"kind": "rigid"}, (0.5, 6.0)),
    "high": ({"kind": "rigid"}, (6.0, 20.0)),
    "restitution": ({"kind": "rigid", "restitution": 0.3}, (0.9, 6.0)),
    "soft": ({"kind": "soft"}, (0.9, 6.0)),
}
OMEGAS: Final = (0.25, 1.5)
XIS: Final = (0.05, 0.1, 0.26, 0.5)

#: Starts of each attractor that are run on, plate periods before and in their window, flights kept of it.
STARTS: Final = 6
LONG: Final = (5000, 3000, 4096)
SAME: Final = 1e-6
#: Parts along each side of the plane (flight time, take-off phase), and the share of the flights of one run
#: that must lie in parts which another visits.
PARTS: Final = 24
VISITED: Final = 0.8
#: Attractors with fewer starts than this share do not count.
SMALL: Final = 0.003


def spec_of(cell: tuple[float, float, float], model: dict[str, Any], side: int) -> BasinSpec:
    gamma, omega, xi = cell
    protocol = {"kind": "basin", "rows": side, "columns": side}
    return BasinSpec.parse(
        {"gamma": gamma, "omega": omega, "xi": xi, "model": model, "protocol": protocol,
         "settle": 500 if xi > 0.08 else 1500}
    )  # fmt: skip


def _cell(spec: BasinSpec) -> tuple[float, float, float]:
    xi, omega, gamma = (float(spec.axis_values(axis)[0]) for axis in AXES)
    return gamma, omega, xi


def run(spec: BasinSpec, states: NDArray[np.float64], settle: int, observe: int, keep: int) -> Line:
    """The starts `states` of the cell of `spec`, followed."""
    return _followed(spec, states=np.ascontiguousarray(states), settle=settle, observe=observe, keep=keep)


def _followed(spec: BasinSpec, states: NDArray[np.float64], **window: Any) -> Line:
    cells = [np.full(len(states), value) for value in _cell(spec)]
    plate = plate_of(spec.model, *cells)
    return run_line(*cells, plate=plate, carry=False, micro_flight=spec.micro_flight, states=states, **window)


def search(spec: BasinSpec) -> Found:
    """The attractors of the cell, as a task finds them."""

    def answer(request: Any, reduce: Any) -> Any:
        return reduce(_followed(spec, **request._asdict()))

    return find(starts_of(spec, *_cell(spec)), spec, answer)


def groups_of(spec: BasinSpec, found: Found) -> tuple[list[int], list[list[int]]]:
    """The attractor of each start that is run on, and the starts grouped by what long runs show."""
    chance = np.random.default_rng(1)
    chosen: list[int] = []
    for number in range(1, len(found.attractors) + 1):
        starts = np.flatnonzero(found.ids == number)
        chosen += chance.choice(starts, min(STARTS, len(starts)), replace=False).tolist()
    line = run(spec, starts_of(spec, *_cell(spec))[chosen], *LONG)
    flights = [counted_flights(line, i, spec.micro_flight) for i in range(len(chosen))]
    longest = max([time.max(initial=0.0) for time, _ in flights]) or 1.0
    visits = [_visits(*pair, longest) for pair in flights]
    groups: list[list[int]] = []
    for i in range(len(chosen)):
        group = next((group for group in groups if _same(line, flights, visits, i, group)), None)
        if group is None:
            groups.append([i])
        else:
            group.append(i)
    return [int(found.ids[start]) for start in chosen], groups


def _visits(time: NDArray[np.float64], phase: NDArray[np.float64], longest: float) -> NDArray[np.int64]:
    row = np.minimum(time / longest * PARTS, PARTS - 1).astype(int)
    column = np.minimum(phase % (2.0 * np.pi) / (2.0 * np.pi) * PARTS, PARTS - 1).astype(int)
    return np.bincount(row * PARTS + column, minlength=PARTS**2)


def _same(line: Line, flights: list[Any], visits: list[Any], i: int, group: list[int]) -> bool:
    """Whether run i shows what those of a group do."""
    first = group[0]
    if Outcome.PERIODIC in (line.outcome[i], line.outcome[first]):
        modes = [(line.outcome[j], line.bounces[j], line.periods[j]) for j in (i, first)]
        if modes[0] != modes[1]:
            return False
        cycles = [np.sort(flights[j][0][-line.bounces[j] :]) for j in (i, first)]
        return bool(np.all(np.abs(cycles[0] - cycles[1]) < SAME))
    if Outcome.AT_REST in (line.outcome[i], line.outcome[first]):
        return bool(line.outcome[i] == line.outcome[first])
    own, others = visits[i], sum(visits[j] for j in group)
    shares = (own[others > 0].sum() / max(own.sum(), 1), others[own > 0].sum() / max(others.sum(), 1))
    return max(shares) > VISITED


def judged(spec: BasinSpec) -> tuple[str, int, int]:
    """What is found in a cell, and how many of its attractors are spurious and merged."""
    found = search(spec)
    owners, groups = groups_of(spec, found)
    counted = {n for n, attractor in enumerate(found.attractors, 1) if attractor.fraction > SMALL}
    numbers = [{owners[i] for i in group} & counted for group in groups]
    spurious = sum(len(group) - 1 for group in numbers if group)
    merged = sum(sum(n in group for group in numbers) > 1 for n in counted)
    names = [f"{_name(a.outcome, a.bounces, a.periods)} {100.0 * a.fraction:.2f} %" for a in found.attractors]
    undecided = float(np.mean(found.ids == 0))
    return (
        ", ".join([*names, *([f"undecided {100 * undecided:.2f} %"] if undecided else [])]),
        spurious,
        merged,
    )


def _name(outcome: int, bounces: int, periods: int) -> str:
    return f"({bounces},{periods})" if outcome == Outcome.PERIODIC else Outcome(outcome).name.lower()


def candidates(kind: str, seed: int, count: int, side: int) -> Iterator[BasinSpec]:
    """Random cells of which 6 x 6 drops show more than one motion."""
    chance = np.random.default_rng(seed)
    model, gammas = KINDS[kind]
    while count:
        cell = (
            round(chance.uniform(*gammas), 4),
            round(chance.uniform(*OMEGAS), 4),
            float(chance.choice(XIS)),
        )
        coarse = spec_of(cell, model, 6)
        line = run(coarse, starts_of(coarse, *cell), coarse.settle, coarse.observe, 64)
        if (
            len(set(zip(line.outcome.tolist(), line.bounces.tolist(), line.periods.tolist(), strict=True)))
            > 1
        ):
            count -= 1
            yield spec_of(cell, model, side)


def cells(kind: str, seed: int, count: int, side: int) -> None:
    rows = []
    for spec in candidates(kind, seed, count, side):
        began = time.process_time()
        text, spurious, merged = judged(spec)
        gamma, omega, xi = _cell(spec)
        seconds = time.process_time() - began
        rows.append([f"{gamma:g}, {omega:g}, {xi:g}", text, spurious, merged, short(seconds)])
        print(*rows[-1], sep=" | ", flush=True)
    print(table(["Γ, Ω, ξ", "attractors found", "spurious", "merged", "core-s with the check"], rows))
    print(f"{len(rows)} cells: {sum(row[2] for row in rows)} spurious, {sum(row[3] for row in rows)} merged")


def planes(side: int) -> None:
    rows = []
    for xi, gamma, omega in PLANES:
        axes = [{"start": low, "stop": high, "num": side} for low, high in (gamma, omega)]
        spec = MultistabilitySpec.parse(
            {"gamma": axes[0], "omega": axes[1], "xi": xi, "model": {"kind": "rigid"},
             "protocol": {"kind": "multistability"}}
        )  # fmt: skip
        plan = STUDIES["multistability"].plan(spec)
        with tempfile.TemporaryDirectory() as folder:
            url = str(Path(folder) / "plane.zarr")
            store.create(url, STUDIES["multistability"].variables(spec, plan.chunk_shape))
            core = time.process_time()
            for chunk in plan:
                compute_lines(spec, chunk, url)
            core = time.process_time() - core
            found = compute(Stored(spec, url), MultistabilityQuery())
        shares = [
            f"{100.0 * share:.1f}" for share in (found.attrs["several_by_drops"], found.attrs["several"])
        ]
        rows.append([f"{xi:g}", *shares, short(core)])
        print(*rows[-1], sep=" | ", flush=True)
    print(table(["ξ", "several by drops, %", "several, %", "core-s"], rows))


def times(side: int) -> None:
    _timed(spec_of(TIMED[0], {"kind": "rigid"}, 8))  # loads the kernels
    rows = []
    for cell in TIMED:
        spec = spec_of(cell, {"kind": "rigid"}, side)
        wall, core = _timed(spec)
        rows.append([", ".join(f"{value:g}" for value in cell), spec.settle, short(wall), short(core)])
        print(*rows[-1], sep=" | ", flush=True)
    print(table(["Γ, Ω, ξ", "settle", "s", "core-s"], rows))


def _timed(spec: BasinSpec) -> tuple[float, float]:
    """Seconds and core-seconds of the one task of a cell, storing included."""
    plan = STUDIES["basin"].plan(spec)
    with tempfile.TemporaryDirectory() as folder:
        url = str(Path(folder) / "basin.zarr")
        store.create(url, STUDIES["basin"].variables(spec, plan.chunk_shape))
        wall, core = time.perf_counter(), time.process_time()
        run_chunk(spec, plan[0], url)
        return time.perf_counter() - wall, time.process_time() - core


def main() -> None:
    given = options(__doc__, what=["time", "cells", "planes"], side=0, kind="rigid", seed=11, count=14)
    print(describe())
    if "time" in given.what:
        times(given.side or 256)
    if "cells" in given.what:
        cells(given.kind, given.seed, given.count, given.side or 64)
    if "planes" in given.what:
        planes(given.side or 40)


if __name__ == "__main__":
    main()
