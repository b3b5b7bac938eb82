"""Division of a study into chunks, and their order. A plan is pure.

Chunks form a regular grid and are numbered in an order in which they can run, the last axis fastest. On a
ramp, the first chunks of all lines precede the second ones, and "down" follows "up": consecutive numbers
rarely depend on each other. From rest a sweep has about as many chunks along every axis. On a ramp a chunk
has as many lines as are computed side by side, and spans the whole ramp axis if that fits.
"""

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Final, overload

import numpy as np

from kernel.params import FEW, LANES
from worker.cost import cell_seconds, cells_at_once, lines_of
from worker.schema import bytes_per_cell
from worker.spec import AXES, SweepSpec

#: Core-seconds of a chunk: long enough to hide a task's overhead; short enough for progress, for little loss
#: on a failure, and for small jobs to start soon between the chunks of large ones.
TARGET_SECONDS: Final = 0.75
#: A sweep that costs less than FEWEST_CHUNKS * TARGET_SECONDS has FEWEST_CHUNKS chunks, or fewer of
#: SMALLEST_SECONDS each.
SMALLEST_SECONDS: Final = 0.0125
FEWEST_CHUNKS: Final = 8
#: A sweep that would have more chunks has longer ones instead, of LONGEST_SECONDS at most: 15,000 chunks of
#: six arrays are 90,000 files. Like any long chunk, they pause in between.
MANY_CHUNKS: Final = 15_000
LONGEST_SECONDS: Final = 30.0
#: From this many lines of a ramp on, chunks fill all lanes. With fewer, twice as many chunks of half the
#: lanes keep more workers busy.
LINES_TO_FILL: Final = 4 * LANES
#: Before compression; reading one cell reads its whole chunk.
MAX_CHUNK_BYTES: Final = 16 * 2**20
#: The same for sweeps with many chunks: larger chunks are shards, whose parts a reader can read alone.
MAX_SHARD_BYTES: Final = 96 * 2**20

#: Rows and columns of an adaptive map's tiles. Each tile is a chunk, refined by itself (with a margin,
#: together with the blocks just beyond its border). Large enough to fill the lanes in most rounds, small
#: enough that a map of 513 rows and columns has some for every worker.
TILE_SIDE: Final = 128
MAX_TILE_BYTES: Final = 20 * 2**20

Span = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Chunk:
    """A block of cells: half-open index spans along the axes, slowest first."""

    index: int
    spans: tuple[Span, ...]
    direction: int | None = None  # of a sweep: index into the specification's directions
    after: int | None = None  # the chunk that must be done first, a lower number

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along the axes."""
        return tuple(high - low for low, high in self.spans)

    @property
    def cells(self) -> int:
        return math.prod(self.shape)

    @property
    def slices(self) -> tuple[slice, ...]:
        """The chunk's cells along the cell dimensions of a stored array."""
        direction = () if self.direction is None else ((self.direction, self.direction + 1),)
        return tuple(slice(*span) for span in (*direction, *self.spans))


@dataclass(frozen=True)
class Plan(Sequence[Chunk]):
    """The chunks of a study, computed when indexed: there may be a million.

    Raises ValueError for sizes below 1.
    """

    grid: tuple[int, ...]  # cells along the axes, slowest first
    chunk_shape: tuple[int, ...]  # the ledger keeps it to repeat the plan
    directions: tuple[str, ...] = ()  # of a sweep
    ramp: int | None = None  # axis along which each chunk continues the one before

    def __post_init__(self) -> None:
        if len(self.chunk_shape) != len(self.grid) or min(self.chunk_shape) < 1:
            rule = f"chunk_shape: must be {len(self.grid)} sizes of at least 1"
            raise ValueError(f"{rule}, not {self.chunk_shape}")
        fitting = tuple(min(size, n) for size, n in zip(self.chunk_shape, self.grid, strict=True))
        object.__setattr__(self, "chunk_shape", fitting)

    @property
    def cells(self) -> int:
        return max(len(self.directions), 1) * math.prod(self.grid)

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Chunks along the axes."""
        return tuple(-(-n // size) for n, size in zip(self.grid, self.chunk_shape, strict=True))

    @cached_property
    def lines(self) -> int:
        """Chunks without a predecessor; each other chunk i depends on chunk i - lines."""
        return math.prod(self._counts_beside_ramp)

    def __len__(self) -> int:
        return max(len(self.directions), 1) * math.prod(self.counts)

    @overload
    def __getitem__(self, index: int) -> Chunk: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Chunk]: ...
    def __getitem__(self, index: int | slice) -> Chunk | Sequence[Chunk]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        index = range(len(self))[index]
        wave, line = divmod(index, self.lines)
        coords = [int(coord) for coord in np.unravel_index(line, self._counts_beside_ramp)]
        direction = 0 if self.directions else None
        if self.ramp is not None:
            direction, visit = divmod(wave, self.counts[self.ramp])
            coords[self.ramp] = self._in_visiting_order(direction, visit)
        spans = (
            (coord * size, min((coord + 1) * size, n))
            for coord, size, n in zip(coords, self.chunk_shape, self.grid, strict=True)
        )
        return Chunk(index, tuple(spans), direction, index - self.lines if wave else None)

    def number(self, *coords: int) -> int:
        """Index of the chunk at `coords` in the store's grid of chunks; of a sweep, the direction first."""
        block, wave = list(coords[1:] if self.directions else coords), 0
        if self.ramp is not None:
            visit = self._in_visiting_order(coords[0], block[self.ramp])
            block[self.ramp], wave = 0, coords[0] * self.counts[self.ramp] + visit
        return wave * self.lines + int(np.ravel_multi_index(block, self._counts_beside_ramp))

    def _in_visiting_order(self, direction: int, coord: int) -> int:
        """The coordinate along the ramp as a visit, or a visit as a coordinate."""
        last = self.counts[self.ramp or 0] - 1
        return last - coord if self.directions[direction] == "down" else coord

    @cached_property
    def _counts_beside_ramp(self) -> tuple[int, ...]:
        return tuple(1 if axis == self.ramp else n for axis, n in enumerate(self.counts))


def make_plan(
    spec: SweepSpec, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
) -> Plan:
    """Divide a sweep into chunks of `chunk_shape` cells (xi, omega, gamma).

    By default a chunk costs about TARGET_SECONDS, or up to `longest` if there are many. The division does
    not affect the stored numbers, except for an adaptive map: its chunks are the tiles of `tile_shape` unless
    `chunk_shape` is given. Raises ValueError for a size below 1.
    """
    _, *grid = spec.shape
    if chunk_shape is None and spec.refine is not None:
        chunk_shape = tile_shape(spec, spec.refine.coarsest)
    if chunk_shape is None:
        chunk_shape = block(spec, _cells_per_chunk(spec, longest))
    if spec.refine is not None and chunk_shape[0] > 1:
        raise ValueError(f"chunk_shape: tiles of an adaptive map have one xi, not {chunk_shape[0]}")
    ramp = None if spec.ramp_axis is None else AXES.index(spec.ramp_axis)
    return Plan(tuple(grid), chunk_shape, spec.directions, ramp)


def tile_shape(spec: SweepSpec, coarsest: int) -> tuple[int, int, int]:
    """Cells of an adaptive map's tiles along (xi, omega, gamma).

    As many blocks of `coarsest` as fit into TILE_SIDE, plus the row and column of the blocks' last corners.
    Depends on the specification alone, not on its cost or the workers.
    """
    most = math.isqrt(MAX_TILE_BYTES // bytes_per_cell(spec))
    side = min(max(TILE_SIDE // coarsest, 1), max((most - 1) // coarsest, 1)) * coarsest + 1
    side = max(min(side, most), 1)
    return 1, side, side


def _cells_per_chunk(spec: SweepSpec, longest: float) -> int:
    cost, cells = cell_seconds(spec), math.prod(spec.shape)
    seconds = min(max(cells * cost / FEWEST_CHUNKS, SMALLEST_SECONDS), TARGET_SECONDS)
    seconds = max(seconds, min(cells * cost / MANY_CHUNKS, longest))
    size = bytes_per_cell(spec)
    most_bytes = min(max(MAX_CHUNK_BYTES, cells * size // MANY_CHUNKS), MAX_SHARD_BYTES)
    return max(min(math.ceil(seconds / cost), most_bytes // size), cells_at_once(spec))


def _halvable(size: int, cells: int) -> int:
    """The length of a shard along an axis of `size` cells: a length that can be halved a few times."""
    if size >= cells:
        return cells
    return size - size % next(unit for unit in (8, 4, 2, 1) if size >= unit * unit or unit == 1)


def block(spec: SweepSpec, cells: int) -> tuple[int, ...]:
    """Chunk shape of at most `cells` cells: as long as possible along the ramp, then balanced."""
    grid = dict(zip(AXES, spec.shape[1:], strict=True))
    is_long = cells * bytes_per_cell(spec) > MAX_CHUNK_BYTES
    size, at_once = dict[str, int](), 1
    if spec.ramp_axis:
        # all lanes, or one vector of them if there are few lines
        at_once = cells_at_once(spec)
        at_once = at_once if lines_of(spec) >= LINES_TO_FILL else min(at_once, LANES // 2)
        length = even(grid.pop(spec.ramp_axis), max(1, cells // at_once))
        size, cells = {spec.ramp_axis: length}, cells // length
        cells -= cells % at_once if cells > at_once else 0  # lines that fill the lanes
    size |= (_filling if 1 < cells <= at_once else _balanced)(grid, max(1, cells))
    shape = tuple(size[axis] for axis in AXES)
    return tuple(map(_halvable, shape, spec.shape[1:])) if is_long else shape


def _balanced(grid: Mapping[str, int], cells: int) -> dict[str, int]:
    """Chunk sizes of at most `cells` cells that divide every axis of `grid` into about as many parts."""

    def cut(parts: int) -> dict[str, int]:
        return {axis: -(-n // min(n, parts)) for axis, n in grid.items()}

    every = range(1, max(grid.values()) + 1)
    fits = bisect_left(every, True, key=lambda parts: math.prod(cut(parts).values()) <= cells)
    size = cut(every[fits])
    for axis in ("gamma", "omega", "xi"):  # remaining cells extend the axis of most diagrams first
        if axis in size:
            size[axis] = even(grid[axis], cells * size[axis] // math.prod(size.values()))
    return size


def _filling(grid: Mapping[str, int], most: int) -> dict[str, int]:
    """Chunk sizes of at most `most` lines of a ramp that leave the fewest lanes idle."""
    (slow, height), (fast, width) = grid.items()

    def lanes(size: Mapping[str, int]) -> float:
        rows, columns = ([(each, grid[axis] // each), (grid[axis] % each, 1)] for axis, each in size.items())
        return sum(n * m * _lanes(a * b) for (a, n), (b, m) in product(rows, columns))

    sizes = [{slow: even(height, n), fast: even(width, most // n)} for n in range(1, min(height, most) + 1)]
    return min(sizes, key=lanes)


def _lanes(lines: int) -> float:
    """Lanes that take as long as a chunk of so many lines; FEW of them, one by one, take that of a vector."""
    vector = LANES // 2
    return lines * vector / FEW if lines <= FEW else vector * -(-lines // vector)


def even(n: int, max_size: int) -> int:
    """The size that divides n into the fewest parts of at most `max_size`, as equal as possible."""
    parts = -(-n // max_size)
    return -(-n // parts)
