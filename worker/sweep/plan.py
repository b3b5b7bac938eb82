"""Division of a sweep into chunks, and its cost.

From rest a sweep has about as many chunks along every axis. On a ramp a chunk has as many lines as are
computed side by side, and spans the whole ramp axis if that fits.
"""

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Final

from kernel.params import FEW, LANES, periods_followed
from worker.spec.contact_models import CONTACT_MODELS
from worker.study.chunks import LONGEST_SECONDS, MAX_CHUNK_BYTES, TARGET_SECONDS, Cost, Plan, even
from worker.study.layout import WHOLE_BYTES
from worker.sweep.schema import bytes_per_cell
from worker.sweep.specification import AXES, SweepSpec

#: A sweep that costs less than MANY_WORKERS chunks of TARGET_SECONDS has as many, so that each of many
#: workers has some, or fewer of SHORT_SECONDS, of which a task's overhead is a tenth; a small one has
#: FEW_WORKERS chunks, or fewer of SMALLEST_SECONDS.
MANY_WORKERS, SHORT_SECONDS = 64, 0.15
FEW_WORKERS, SMALLEST_SECONDS = 8, 0.0125
#: A sweep that would have more chunks has longer ones instead, of LONGEST_SECONDS at most: 15,000 chunks of
#: nine arrays are 135,000 files. Like any long chunk, they pause in between.
MANY_CHUNKS: Final = 15_000
#: From this many lines of a ramp on, chunks fill all lanes. With fewer, twice as many chunks of half the
#: lanes keep more workers busy.
LINES_TO_FILL: Final = 4 * LANES
#: MAX_CHUNK_BYTES of sweeps with many chunks.
MAX_SHARD_BYTES: Final = 96 * 2**20

#: Share of the cells that still settle at the end of their window, and the share of those that still do after
#: each doubling of the periods: of 24,000 random cells 5.3% after 300 periods, 1.9% after 600, 0.7%
#: after 1,200, 0.2% after 2,400 (`python -m benchmarks.settling`).
SETTLING_SHARE: Final = 0.053
STILL_SETTLING_SHARE: Final = 0.35

#: Where cells are certified: the share of the cells that settle at the end of their window, 1.1 % of 4,000
#: random ones; and of those that take all of `until`, as 0.6 % do that settle on average for a quarter of it.
GOING_ON_SHARES: Final = (0.011, 0.0015)

#: The largest share of a sweep's cells that settle: where it is slow 11 % do after 300 plate periods.
MOST_SETTLING: Final = 0.11

#: Share of the cells whose window shows no mode and which are followed beyond it, of 24,000 random cells.
FOLLOWED_SHARE: Final = 0.25
#: Cells are followed beyond their window if they take less than this many times the usual evaluations: most
#: busier ones use up their budget in it.
BUSIEST_FOLLOWED: Final = 100.0

#: Of a ramp's cells, which begin near their cycle, relative to those from rest.
CERTIFIED_ON_RAMPS: Final = 0.6


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
    whole = cells * cost
    few = max(min(whole / FEW_WORKERS, SHORT_SECONDS), SMALLEST_SECONDS)
    seconds = max(min(max(whole / MANY_WORKERS, few), TARGET_SECONDS), min(whole / MANY_CHUNKS, longest))
    size = bytes_per_cell(spec)
    most_bytes = min(max(MAX_CHUNK_BYTES, cells * size // MANY_CHUNKS), MAX_SHARD_BYTES)
    return max(min(math.ceil(seconds / cost), most_bytes // size), cells_at_once(spec))


def _up(size: int, n: int, halved: bool) -> int:
    """The least chunk size from `size` on along an axis of n cells; a shard's can be `halved` a few times."""
    unit = next(unit for unit in (8, 4, 2, 1) if size >= unit**2) if halved else 1
    return min(size + -size % unit, n)


def block(spec: SweepSpec, cells: int) -> tuple[int, ...]:
    """Chunk shape of at most `cells` cells: as long as possible along the ramp, then balanced.

    Shards are up to a fifth longer along an axis, so that they can be halved.
    """
    grid = dict(zip(AXES, spec.shape[1:], strict=True))
    halved = cells * bytes_per_cell(spec) > WHOLE_BYTES
    size, at_once = dict[str, int](), 1
    if spec.ramp_axis:
        # all lanes, or one vector of them if there are few lines
        at_once = cells_at_once(spec)
        at_once = at_once if spec.lines >= LINES_TO_FILL else min(at_once, LANES // 2)
        n = grid.pop(spec.ramp_axis)
        length = _up(even(n, max(1, cells // at_once)), n, halved)
        size, cells = {spec.ramp_axis: length}, cells // length
        cells -= cells % at_once if cells > at_once else 0  # lines that fill the lanes
    size |= _filling(grid, cells, halved) if 1 < cells <= at_once else _balanced(grid, max(1, cells), halved)
    return tuple(size[axis] for axis in AXES)


def _balanced(grid: Mapping[str, int], cells: int, halved: bool) -> dict[str, int]:
    """Chunk sizes of at most `cells` cells that divide every axis of `grid` into about as many parts."""

    def cut(parts: int) -> dict[str, int]:
        return {axis: _up(-(-n // min(n, parts)), n, halved) for axis, n in grid.items()}

    every = range(1, max(grid.values()) + 1)
    fits = bisect_left(every, True, key=lambda parts: math.prod(cut(parts).values()) <= cells)
    size = cut(every[fits])
    for axis in ("gamma", "omega", "xi"):  # remaining cells extend the axis of most diagrams first
        if axis in size:
            most = max(size[axis], cells * size[axis] // math.prod(size.values()))
            size[axis] = _up(even(grid[axis], most), grid[axis], halved)
    return size


def _filling(grid: Mapping[str, int], most: int, halved: bool) -> dict[str, int]:
    """Chunk sizes of at most `most` lines of a ramp that leave the fewest lanes idle."""
    (slow, height), (fast, width) = grid.items()

    def lanes(size: Mapping[str, int]) -> float:
        rows, columns = ([(each, grid[axis] // each), (grid[axis] % each, 1)] for axis, each in size.items())
        return sum(n * m * _lanes(a * b) for (a, n), (b, m) in product(rows, columns))

    sizes = [
        {slow: even(height, n), fast: min(_up(even(width, most // n), width, halved), most // n)}
        for n in range(1, min(height, most) + 1)
    ]
    return min(sizes, key=lanes)


def _lanes(lines: int) -> float:
    """Lanes that take as long as a chunk of `lines`; FEW of them, one by one, take the time of a vector."""
    vector = LANES // 2
    return lines * vector / FEW if lines <= FEW else vector * -(-lines // vector)


def estimate(spec: SweepSpec, plan: Plan) -> Cost:
    """Cost of a sweep, from the table of contact models."""
    cells, seconds = math.prod(spec.shape), cell_seconds(spec)
    return Cost(
        cells=cells,
        chunks=len(plan),
        bytes=cells * bytes_per_cell(spec),
        core_seconds=cells * seconds,
        longest_core_seconds=cells * max(seconds, longest_cell_seconds(spec)),
    )


def cell_seconds(spec: SweepSpec, *, alone: bool = False) -> float:
    """Mean core-seconds per cell of a sweep, from the table of contact models.

    alone: as in `period_seconds`.
    """
    share = CONTACT_MODELS[spec.model.kind].certified if spec.certifies else 1.0
    if spec.certifies and spec.ramp_axis is not None:
        share *= CERTIFIED_ON_RAMPS
    return share * period_seconds(spec, alone=alone) * mean_periods(spec)


def mean_periods(spec: SweepSpec) -> float:
    """Mean plate periods of the cells of a sweep, of certified ones as if they were computed to the end."""
    if spec.certifies:
        parts = zip((1.0, *GOING_ON_SHARES), [sum(spec.window), *_extensions(spec)], strict=False)
        return sum(part * periods for part, periods in parts)
    followed = periods_followed(spec.observe)
    periods, share = sum(spec.window) + FOLLOWED_SHARE * followed, SETTLING_SHARE
    for added in _extensions(spec):
        periods, share = periods + share * (added + followed), share * STILL_SETTLING_SHARE
    return periods


def longest_cell_seconds(spec: SweepSpec) -> float:
    """Core-seconds of a cell among the busiest of the sweep, of which MOST_SETTLING take all of `until`."""
    followed = 0 if spec.certifies else periods_followed(spec.observe)
    extended = MOST_SETTLING * sum(added + followed for added in _extensions(spec))
    return longest_seconds(spec, sum(spec.window) + followed + extended)


def longest_seconds(spec: SweepSpec, until: float) -> float:
    """Core-seconds of a cell followed for `until` plate periods, among the busiest of the sweep."""
    window = sum(spec.window)
    busiest = spec.model.busiest(*map(spec.axis_values, ("gamma", "omega", "xi")))
    return period_seconds(spec) * (busiest * window + min(busiest, BUSIEST_FOLLOWED) * (until - window))


def period_seconds(spec: SweepSpec, *, alone: bool = False) -> float:
    """Core-seconds per cell and computed plate period of a sweep, from the table of contact models.

    alone: for a cell computed by itself, as in a refinement.
    """
    gamma, omega = spec.axis_values("gamma"), spec.axis_values("omega")
    model = CONTACT_MODELS[spec.model.kind]
    at_once = 1 if alone else cells_at_once(spec)
    period_us = spec.model.cost_us(model.cost_us, gamma, omega, at_once=at_once)
    if spec.ramp_axis is not None and (at_once > 1 or not spec.model.in_lanes):
        period_us *= model.ramp
    return period_us * 1e-6


def cells_at_once(spec: SweepSpec) -> int:
    """Cells, or lines of a ramp, that the kernel computes side by side: fewer leave lanes idle."""
    if not spec.model.in_lanes or spec.exponents:
        return 1
    return LANES if spec.ramp_axis is None else min(LANES, spec.lines)


def _extensions(spec: SweepSpec) -> Iterator[int]:
    """Plate periods of each extension of a cell that is still settling, as in `kernel.cell`."""
    taken = sum(spec.window)
    if spec.certifies:
        ends = taken + periods_followed(spec.observe), spec.settles_until or 0
        for end in ends:
            if end - taken >= spec.observe:
                yield end - taken
                taken = end
        return
    while (added := min(taken, (spec.settles_until or 0) - taken)) >= spec.observe:
        yield added
        taken += added
