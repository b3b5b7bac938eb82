"""How a sweep is cut into chunks, and which chunk waits for which.

Pure: computes no physics, touches no disk, holds no list of chunks, so that a plan of
a million of them costs nothing.

Chunks lie on a regular grid. They are numbered in the order they can be run: from rest
that is the grid's own order; on a ramp all lines' first chunks come before any line's
second ones, down after up, so that a chunk never waits for a later number and
neighbouring numbers hardly ever wait for each other.

From rest there are about as many chunks along every axis, so that a line of cells touches few of
them whichever axis it goes along. On a ramp a chunk holds whole lines along it where they fit.
"""

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, overload

from worker.cost import cell_seconds
from worker.schema import bytes_per_cell
from worker.spec import AXES, SweepSpec

#: What one chunk should cost in core-seconds: enough to hide a task's overhead, and small enough to show
#: progress, to lose little, and to let a small job that comes in between have its turn soon.
TARGET_SECONDS: Final = 0.75
SMALLEST_SECONDS: Final = 0.0125
FEWEST_CHUNKS: Final = 8
#: Before compression: who reads one cell reads its chunk.
MAX_CHUNK_BYTES: Final = 16 * 2**20

Span = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Chunk:
    """A block of cells: half-open index spans into the grid. `after`: the chunk to wait for."""

    index: int
    direction: int  # index into the specification's directions
    xi: Span
    omega: Span
    gamma: Span
    after: int | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Cells along (xi, omega, gamma)."""
        xi, omega, gamma = (high - low for low, high in (self.xi, self.omega, self.gamma))
        return xi, omega, gamma

    @property
    def cells(self) -> int:
        return math.prod(self.shape)

    @property
    def slices(self) -> tuple[slice, slice, slice, slice]:
        """Its place in an array of the store."""
        here = slice(self.direction, self.direction + 1)
        return here, slice(*self.xi), slice(*self.omega), slice(*self.gamma)


@dataclass(frozen=True)
class Plan(Sequence[Chunk]):
    """The chunks of a sweep, worked out one by one when asked for."""

    directions: tuple[str, ...]
    grid: tuple[int, int, int]  # cells along (xi, omega, gamma)
    chunk_shape: tuple[int, int, int]
    ramp_axis: str | None

    @property
    def chunks(self) -> Sequence[Chunk]:
        return self

    @property
    def cells(self) -> int:
        return len(self.directions) * math.prod(self.grid)

    @cached_property
    def counts(self) -> tuple[int, int, int]:
        """Chunks along (xi, omega, gamma)."""
        xi, omega, gamma = (-(-n // size) for n, size in zip(self.grid, self.chunk_shape, strict=True))
        return xi, omega, gamma

    @cached_property
    def lines(self) -> int:
        """Chunks that start without a predecessor: independent lines of a ramp, or all."""
        return math.prod(self._counts_beside_ramp)

    def __len__(self) -> int:
        return len(self.directions) * math.prod(self.counts)

    def __iter__(self) -> Iterator[Chunk]:
        return map(self.chunk, range(len(self)))

    @overload
    def __getitem__(self, index: int) -> Chunk: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Chunk]: ...
    def __getitem__(self, index: int | slice) -> Chunk | Sequence[Chunk]:
        if isinstance(index, slice):
            return [self.chunk(i) for i in range(len(self))[index]]
        return self.chunk(range(len(self))[index])

    def chunk(self, index: int) -> Chunk:
        """The chunk of that number, 0 <= index < len(plan)."""
        wave, line = divmod(index, self.lines)
        _, omega, gamma = self._counts_beside_ramp
        block = [line // (omega * gamma), line // gamma % omega, line % gamma]
        direction = 0
        if self.ramp_axis is not None:
            ramp = AXES.index(self.ramp_axis)
            steps = self.counts[ramp]
            direction, visit = divmod(wave, steps)
            block[ramp] = steps - 1 - visit if self.directions[direction] == "down" else visit
        first, second, third = (self._span(axis, place) for axis, place in enumerate(block))
        return Chunk(index, direction, first, second, third, index - self.lines if wave else None)

    def number(self, *coords: int) -> int:
        """The number of the chunk at (direction, xi, omega, gamma) in the grid of chunks."""
        direction, *block = coords
        wave = 0
        if self.ramp_axis is not None:
            ramp = AXES.index(self.ramp_axis)
            steps = self.counts[ramp]
            visit = steps - 1 - block[ramp] if self.directions[direction] == "down" else block[ramp]
            block[ramp], wave = 0, direction * steps + visit
        _, omegas, gammas = self._counts_beside_ramp
        return wave * self.lines + (block[0] * omegas + block[1]) * gammas + block[2]

    def _span(self, axis: int, place: int) -> Span:
        size = self.chunk_shape[axis]
        return place * size, min((place + 1) * size, self.grid[axis])

    @cached_property
    def _counts_beside_ramp(self) -> tuple[int, int, int]:
        xi, omega, gamma = (
            1 if axis == self.ramp_axis else n for axis, n in zip(AXES, self.counts, strict=True)
        )
        return xi, omega, gamma


def make_plan(
    spec: SweepSpec, *, chunk_cells: int | None = None, chunk_shape: tuple[int, ...] | None = None
) -> Plan:
    """Cut a sweep into chunks of about `chunk_cells` cells, or of exactly `chunk_shape` (xi, omega, gamma).

    With neither given, a chunk is worth a second or so of computing. The cut decides nothing
    but speed: every number stored is the same for any. Raises ValueError for a size below 1.
    """
    _, *grid = spec.shape
    if chunk_shape is None:
        chunk_shape = _block(spec, chunk_cells if chunk_cells is not None else _cells_per_chunk(spec))
    if len(chunk_shape) != 3 or min(chunk_shape) < 1:
        raise ValueError(
            f"chunk_shape: must be three sizes of at least 1 (xi, omega, gamma), not {chunk_shape}"
        )
    xi, omega, gamma = (min(size, n) for size, n in zip(chunk_shape, grid, strict=True))
    return Plan(spec.directions, (grid[0], grid[1], grid[2]), (xi, omega, gamma), spec.ramp_axis)


def _cells_per_chunk(spec: SweepSpec) -> int:
    cost = cell_seconds(spec)
    share = math.prod(spec.shape) * cost / FEWEST_CHUNKS
    seconds = min(max(share, SMALLEST_SECONDS), TARGET_SECONDS)
    return max(1, min(math.ceil(seconds / cost), MAX_CHUNK_BYTES // bytes_per_cell(spec)))


def _block(spec: SweepSpec, cells: int) -> tuple[int, int, int]:
    """Up to `cells` cells: as far along the ramp as they go, then about as many chunks along every axis."""
    if cells < 1:
        raise ValueError(f"chunk_cells: must be at least 1, not {cells}")
    grid = dict(zip(AXES, spec.shape[1:], strict=True))
    along = {spec.ramp_axis: _even(grid.pop(spec.ramp_axis), cells)} if spec.ramp_axis else {}
    size = along | _balanced(grid, max(1, cells // math.prod(along.values())))
    return size["xi"], size["omega"], size["gamma"]


def _balanced(grid: Mapping[str, int], cells: int) -> dict[str, int]:
    """Sizes along some axes, of up to `cells` cells together, that cut each into about as many parts."""

    def cut(parts: int) -> dict[str, int]:
        return {axis: -(-n // min(n, parts)) for axis, n in grid.items()}

    every = range(1, max(grid.values()) + 1)
    fits = bisect_left(every, True, key=lambda parts: math.prod(cut(parts).values()) <= cells)
    size = cut(every[fits])
    for axis in ("gamma", "omega", "xi"):  # what is left of the cells goes to the axis most looked along
        if axis in size:
            size[axis] = _even(grid[axis], cells * size[axis] // math.prod(size.values()))
    return size


def _even(n: int, most: int) -> int:
    """The size that cuts n into as few parts as `most` allows, as equal as can be."""
    parts = -(-n // most)
    return -(-n // parts)
