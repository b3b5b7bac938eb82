"""Division of a sweep into chunks.

From rest a sweep has about as many chunks along every axis. On a ramp a chunk has as many lines as are
computed side by side, and spans the whole ramp axis if that fits.
"""

import math
from bisect import bisect_left
from collections.abc import Mapping
from itertools import product
from typing import Final

from kernel.params import FEW, LANES
from worker.study.plan import LONGEST_SECONDS, MAX_CHUNK_BYTES, TARGET_SECONDS, Plan, even
from worker.sweep.cost import cell_seconds, cells_at_once, lines_of
from worker.sweep.schema import bytes_per_cell
from worker.sweep.specification import AXES, SweepSpec

#: A sweep that costs less than FEWEST_CHUNKS * TARGET_SECONDS has FEWEST_CHUNKS chunks, or fewer of
#: SMALLEST_SECONDS each.
SMALLEST_SECONDS: Final = 0.0125
FEWEST_CHUNKS: Final = 8
#: A sweep that would have more chunks has longer ones instead, of LONGEST_SECONDS at most: 15,000 chunks of
#: six arrays are 90,000 files. Like any long chunk, they pause in between.
MANY_CHUNKS: Final = 15_000
#: From this many lines of a ramp on, chunks fill all lanes. With fewer, twice as many chunks of half the
#: lanes keep more workers busy.
LINES_TO_FILL: Final = 4 * LANES
#: The same for sweeps with many chunks: larger chunks are shards, whose parts a reader can read alone.
MAX_SHARD_BYTES: Final = 96 * 2**20


def make_plan(
    spec: SweepSpec, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
) -> Plan:
    """Divide a sweep into chunks of `chunk_shape` cells (xi, omega, gamma).

    By default a chunk costs about TARGET_SECONDS, or up to `longest` if there are many. The division does
    not affect the stored numbers. Raises ValueError for a size below 1.
    """
    _, *grid = spec.shape
    if chunk_shape is None:
        chunk_shape = block(spec, _cells_per_chunk(spec, longest))
    ramp = None if spec.ramp_axis is None else AXES.index(spec.ramp_axis)
    return Plan(tuple(grid), chunk_shape, spec.directions, ramp)


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
