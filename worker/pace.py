"""The pace of a study: what a sample of it takes on this worker, relative to the table of costs.

The sample of an adaptive map also tells how many of its cells are computed. The table is of contact models,
and of one machine. Studies of the same contact differ by the shares of their cells that rest, are certified,
or are aperiodic.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.line import LineRun
from kernel.params import Cell, Line
from worker.basins.attractors import Request, find
from worker.basins.plan import estimate_basins, plan_basins, start_seconds
from worker.basins.specification import BasinSpec
from worker.basins.starts import run_of_starts, starts_of
from worker.maps import plan as maps
from worker.maps.refinement import Tile, refine_of
from worker.studies import study_of
from worker.sweep import AXES
from worker.sweep.plan import CHUNK_SECONDS, cell_seconds, cells_at_once
from worker.sweep.schema import MODE_ARRAYS
from worker.sweep.specification import SweepSpec, is_open
from worker.sweep.task import line_run, to_end
from worker.work import compile_for, is_compiled

#: Core-seconds of a sample by the table, and its most cells, or starts. There is none of fewer than FEWEST.
#: Samples of a map or basins take up to CELLS times as long.
SECONDS: Final = 0.1
FEWEST, MOST = 16, 512
#: Neighbouring values of a ramp's axis in a sample. The first one is far from the state before.
NEIGHBOURS: Final = 32
#: Core-seconds that storing a byte takes, before compression: more than computing it where cells rest.
BYTE_SECONDS: Final = 1.2e-9
#: Blocks of a map that are a sample, and the most samples.
BLOCKS, SAMPLES = 16, 12
#: Cells of a grid whose starts are a sample.
CELLS: Final = 4
#: Most plate periods that representatives of a sampled basin settle.
SHORT: Final = 200


def pace(spec: Any) -> float | None:
    """What a sample of a study takes, in processor time, over what the table of costs says.

    None if a sample would take long: the kernel is not compiled, or its cells take long; and for `auto`.
    """
    if not hasattr(spec, "model") or is_open(spec) or not is_compiled(spec):
        return None
    whole, sample = math.prod(spec.shape), _of_cells if isinstance(spec, SweepSpec) else _of_starts
    if isinstance(spec, SweepSpec):
        seconds = cell_seconds(spec)
    else:
        seconds = start_seconds(spec)
        whole *= spec.protocol.rows * spec.protocol.columns
    number = int(min(SECONDS / seconds, MOST))
    if number < FEWEST:
        return None
    number, random = min(number, whole), np.random.default_rng(0)
    compile_for(spec)  # loads the kernels
    if spec.fills_in:
        return _of_map(spec, random)
    if isinstance(spec, BasinSpec):
        return _of_basins(spec, number, random)
    # few cells may take most of the time: cheap samples are repeated
    took, computed, samples = 0.0, 0, 0
    while took < SECONDS and samples < SAMPLES:
        more, cells = _timed(sample(spec, number, random))
        took, computed, samples = took + more, computed + cells, samples + 1
    plan = study_of(spec).plan(spec)
    cost = study_of(spec).estimate(spec, plan)
    paced = took / computed / seconds
    storing = (1.0 - paced) * CHUNK_SECONDS * len(plan) + BYTE_SECONDS * cost.bytes
    return paced + storing / cost.core_seconds


def _timed(runs: Iterator[LineRun]) -> tuple[float, int]:
    """Processor time of these runs, s, and the number of their cells."""
    took, computed = 0.0, 0
    for run in runs:
        before = time.thread_time()
        computed += len(to_end(run).outcome)
        took += time.thread_time() - before
    return took, computed


def _of_map(spec: Any, random: np.random.Generator) -> float:
    """The pace of an adaptive map, by samples of BLOCKS blocks, whose shares differ much."""
    took, computed, shares = 0.0, 0, list[float]()
    while took < CELLS * SECONDS and len(shares) < SAMPLES:
        blocks = _Blocks(spec, random)
        seconds, cells = _timed(blocks.runs())
        took, computed = took + seconds, computed + cells
        shares.append(blocks.share)
    plan = maps.make_plan(spec)
    seconds = took / computed * math.fsum(shares) / len(shares) * math.prod(spec.shape)
    seconds += maps.TILE_SECONDS[refine_of(spec).by] * len(plan)
    return float(seconds / maps.estimate(spec, plan).core_seconds)


def _of_cells(spec: Any, number: int, random: np.random.Generator) -> Iterator[LineRun]:
    """Runs of `number` cells drawn from a sweep; on a ramp of parts of as many lines as are side by side."""
    axis, at_once = spec.ramp_axis, cells_at_once(spec)
    if axis is None:
        yield line_run(spec, [random.choice(spec.axis_values(name), number) for name in Cell._fields], [])
        return
    along = spec.axis_values(axis)[:: -1 if spec.directions[0] == "down" else 1]
    length = min(NEIGHBOURS, len(along), max(number // at_once, 1))
    parts = max(number // (at_once * length), 1)
    firsts = np.sort(random.integers(0, len(along) - length + 1, (at_once, parts)))
    beside = {name: random.choice(spec.axis_values(name), at_once) for name in Cell._fields}
    cells = {name: np.repeat(values, parts * length) for name, values in beside.items()}
    cells[axis] = along[firsts[..., None] + np.arange(length)].ravel()
    yield line_run(spec, list(cells.values()), [None] * at_once)


class _Blocks:
    """Some of the coarsest blocks of an adaptive map, refined side by side."""

    def __init__(self, spec: Any, random: np.random.Generator) -> None:
        self._spec, refine = spec, refine_of(spec)
        _, xis, *grid = spec.shape
        _, *tile = maps.tile_shape(spec, refine.coarsest)  # smaller than a block of many flights
        self._shape = tuple(min(refine.coarsest + 1, *sizes) for sizes in zip(grid, tile, strict=True))
        self._first = [  # one in each of BLOCKS equal parts, in both directions
            ((random.permutation(BLOCKS) + random.random(BLOCKS)) / BLOCKS * (a - b + 1)).astype(int)
            for a, b in zip(grid, self._shape, strict=True)
        ]
        self._xi = random.integers(0, xis, BLOCKS)
        self._tiles = [Tile(self._shape, refine) for _ in range(BLOCKS)]
        self._found = np.zeros((len(MODE_ARRAYS), BLOCKS, math.prod(self._shape)), np.int64)
        self._computed = np.zeros((BLOCKS, math.prod(self._shape)), np.bool_)

    def runs(self) -> Iterator[LineRun]:
        """The rounds of the refinement."""
        while wanted := [(i, cell) for i, tile in enumerate(self._tiles) for cell in tile.cells]:
            blocks, cells = np.array(wanted).T
            row, column = np.unravel_index(cells, self._shape)
            indices = {
                "xi": self._xi[blocks],
                "omega": self._first[0][blocks] + row,
                "gamma": self._first[1][blocks] + column,
            }
            run = line_run(
                self._spec, [self._spec.axis_values(name)[indices[name]] for name in Cell._fields], []
            )
            yield run
            self._computed[blocks, cells] = True
            for array, name in zip(self._found, MODE_ARRAYS, strict=True):
                array[blocks, cells] = getattr(run.line, name)
            for i, tile in enumerate(self._tiles):
                tile.split(*(array[i].reshape(self._shape) for array in self._found))

    @property
    def share(self) -> float:
        """The share of cells computed; neighbours share edges and corners of a block."""
        weights = [np.r_[0.5, np.ones(max(n - 2, 0)), 0.5] if n > 1 else np.ones(1) for n in self._shape]
        weight = np.outer(*weights).ravel()
        return float((self._computed * weight).mean(axis=0).sum() / weight.sum())


def _of_starts(spec: Any, number: int, random: np.random.Generator) -> Iterator[LineRun]:
    """Runs of `number` starts drawn from a few cells of a grid."""
    for cell in _drawn_cells(spec, CELLS, random):
        states = random.choice(starts_of(spec, *cell), max(number // CELLS, 1))
        cells = [np.full(len(states), value) for value in cell]
        window = {"settle": spec.settle, "observe": spec.observe, "keep": spec.keep}
        yield run_of_starts(spec, cells, states=states, **window)


def _drawn_cells(spec: Any, number: int, random: np.random.Generator) -> list[Cell]:
    """At most this many cells of a grid, each once."""
    whole = math.prod(spec.shape)
    indices = np.unravel_index(random.choice(whole, min(number, whole), replace=False), spec.shape)
    values = {name: spec.axis_values(name)[index] for name, index in zip(AXES, indices, strict=True)}
    return [Cell(*cell) for cell in zip(*(values[name].tolist() for name in Cell._fields), strict=True)]


@dataclass
class _TimedSearch:
    """The runs of a search among some starts of a cell, and their processor time, s."""

    spec: BasinSpec
    cell: Cell
    every: float = 0.0  # of the starts' own runs
    left_out: float = 0.0  # that representatives would have settled for

    def answer(self, request: Request, reduce: Callable[[Line], dict[str, NDArray[Any]]]) -> Any:
        """The answer to a request; representatives settle for at most SHORT plate periods."""
        settle = request.settle if request.every else min(request.settle, SHORT)
        window = request._replace(settle=settle).window()
        before = time.thread_time()
        cells = [np.full(len(request.states), value) for value in self.cell]
        answer = reduce(to_end(run_of_starts(self.spec, cells, **window)))
        took = time.thread_time() - before
        self.every += took if request.every else 0.0
        self.left_out += took * (request.settle - settle) / (settle + request.observe)
        return answer


def _of_basins(spec: BasinSpec, number: int, random: np.random.Generator) -> float:
    """The pace of basins, by searches among some starts of two cells or more.

    Their representatives are as many as of all starts.
    """
    every, others, sampled, began = 0.0, 0.0, 0, time.thread_time()
    for cell in _drawn_cells(spec, SAMPLES, random):
        before = time.thread_time()
        if sampled > 1 and before - began > CELLS * SECONDS:
            break
        states = random.choice(starts_of(spec, *cell), max(number // CELLS, FEWEST))
        search = _TimedSearch(spec, cell)
        find(states, spec, search.answer)
        every += search.every / len(states)
        others += time.thread_time() - before - search.every + search.left_out
        sampled += 1
    plan = plan_basins(spec)
    starts = spec.protocol.rows * spec.protocol.columns
    seconds = (every * starts + others) / sampled * plan.cells + CHUNK_SECONDS * len(plan)
    return seconds / estimate_basins(spec, plan).core_seconds
