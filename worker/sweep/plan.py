"""Division of a sweep into chunks, and its cost.

From rest a sweep has about the same number of chunks along every axis. On a ramp a chunk has the lines that
are computed side by side, and spans the whole ramp axis if it fits.
"""

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Final

from kernel.params import LANES, periods_followed
from worker.spec.contact_models import CONTACT_MODELS
from worker.study.chunks import LONGEST_SECONDS, MAX_CHUNK_BYTES, TARGET_SECONDS, Cost, Plan, even
from worker.study.layout import WHOLE_BYTES
from worker.sweep.schema import bytes_per_cell
from worker.sweep.specification import AXES, SweepSpec

#: A sweep that costs less than MANY_WORKERS chunks of TARGET_SECONDS is still divided into MANY_WORKERS
#: chunks, but into none shorter than SHORT_SECONDS: beside the kernel a chunk costs about 0.05 s. A small one
#: is divided into FEW_WORKERS chunks, but into none shorter than SMALLEST_SECONDS.
MANY_WORKERS, SHORT_SECONDS = 16, 0.5
FEW_WORKERS, SMALLEST_SECONDS = 8, 0.0125
#: A sweep that would have more chunks has longer ones, of up to LONGEST_SECONDS: 15,000 chunks of nine arrays
#: are 135,000 files. Like any long chunk, they pause in between.
MANY_CHUNKS: Final = 15_000
#: From this number of lines on, chunks of a ramp fill all lanes. With fewer lines, twice the chunks with half
#: the lanes keep more workers busy.
LINES_TO_FILL: Final = 4 * LANES
#: MAX_CHUNK_BYTES for sweeps with many chunks.
MAX_SHARD_BYTES: Final = 96 * 2**20

#: Core-seconds that storing a chunk takes.
CHUNK_SECONDS: Final = 0.007

#: Share of the cells that still settle at the end of their window, and the share of these that still settle
#: after each doubling of the periods. Of 24,000 random cells 5.3% settle after 300 periods, 1.9% after 600,
#: 0.7% after 1,200, 0.2% after 2,400 (`python -m benchmarks.settling`).
SETTLING_SHARE: Final = 0.053
STILL_SETTLING_SHARE: Final = 0.35

#: With certificates: plate periods that certified cells cost, as a mean of all, and the share of the others,
#: by the times of 2,000 random cells with windows of 230, 300 and 1,200 periods.
CERTIFIED_PERIODS: Final = 150.0
UNCERTIFIED: Final = 0.5

#: With certificates: the share of cells that settle at the end of their window, 1.1 % of 4,000 random ones,
#: and the share that would take as long if each took all of `until`: 0.6 % take a quarter of it on average.
GOING_ON_SHARES: Final = (0.011, 0.0015)

#: The largest share of settling cells in a sweep: 11 % after 300 plate periods where settling is slow.
MOST_SETTLING: Final = 0.11

#: Share of the cells that are followed beyond their window because it shows no mode, of 24,000 random cells.
FOLLOWED_SHARE: Final = 0.25
#: Busier cells, in multiples of the usual evaluations, use up their budget in the window and are not
#: followed.
BUSIEST_FOLLOWED: Final = 100.0

#: Cost of a spring's certified cell on a ramp, which begins near its cycle, relative to one from rest.
CERTIFIED_ON_RAMPS: Final = 0.6


def make_plan(
    spec: SweepSpec, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
) -> Plan:
    """Divide a sweep into chunks of `chunk_shape` cells (xi, omega, gamma).

    By default a chunk costs about TARGET_SECONDS, or up to `longest` in a sweep of many chunks. The division
    does not affect the stored numbers. Raises ValueError for a size below 1.
    """
    if chunk_shape is None:
        chunk_shape = block(spec, _cells_per_chunk(spec, longest))
    ramp = None if spec.ramp_axis is None else AXES.index(spec.ramp_axis)
    return Plan(spec.shape[1:], chunk_shape, spec.directions, ramp)


def _cells_per_chunk(spec: SweepSpec, longest: float) -> int:
    cost, cells = cell_seconds(spec), math.prod(spec.shape)
    whole = cells * cost
    few = max(min(whole / FEW_WORKERS, SHORT_SECONDS), SMALLEST_SECONDS)
    seconds = max(min(max(whole / MANY_WORKERS, few), TARGET_SECONDS), min(whole / MANY_CHUNKS, longest))
    size = bytes_per_cell(spec)
    most_bytes = min(max(MAX_CHUNK_BYTES, cells * size // MANY_CHUNKS), MAX_SHARD_BYTES)
    return max(min(math.ceil(seconds / cost), most_bytes // size), cells_at_once(spec))


def _up(size: int, n: int, halved: bool) -> int:
    """The least chunk size, from `size` on, along an axis of n cells; if `halved` one that can be halved."""
    unit = next(unit for unit in (8, 4, 2, 1) if size >= unit**2) if halved else 1
    return min(size + -size % unit, n)


def block(spec: SweepSpec, cells: int) -> tuple[int, ...]:
    """Chunk shape of at most `cells` cells: as long as possible along the ramp, then balanced.

    Shards may be a fifth longer along an axis, so that they can be halved.
    """
    grid = dict(zip(AXES, spec.shape[1:], strict=True))
    halved = cells * bytes_per_cell(spec) > WHOLE_BYTES
    size, at_once = dict[str, int](), 1
    if spec.ramp_axis:
        # all lanes, or one vector if there are few lines
        at_once = cells_at_once(spec)
        at_once = at_once if spec.lines >= LINES_TO_FILL else min(at_once, LANES // 2)
        n = grid.pop(spec.ramp_axis)
        length = _up(even(n, max(1, cells // at_once)), n, halved)
        size, cells = {spec.ramp_axis: length}, cells // length
        cells -= cells % at_once if cells > at_once else 0  # keep lines that fill the lanes
    size |= _filling(grid, cells, halved) if 1 < cells <= at_once else _balanced(grid, max(1, cells), halved)
    return tuple(size[axis] for axis in AXES)


def _balanced(grid: Mapping[str, int], cells: int, halved: bool) -> dict[str, int]:
    """Chunk sizes of at most `cells` cells that divide every axis into about the same number of parts."""

    def cut(parts: int) -> dict[str, int]:
        return {axis: _up(-(-n // min(n, parts)), n, halved) for axis, n in grid.items()}

    every = range(1, max(grid.values()) + 1)
    fits = bisect_left(every, True, key=lambda parts: math.prod(cut(parts).values()) <= cells)
    size = cut(every[fits])
    for axis in ("gamma", "omega", "xi"):  # spare cells extend the axis of most diagrams first
        if axis in size:
            most = max(size[axis], cells * size[axis] // math.prod(size.values()))
            size[axis] = _up(even(grid[axis], most), grid[axis], halved)
    return size


def _filling(grid: Mapping[str, int], most: int, halved: bool) -> dict[str, int]:
    """Chunk sizes of at most `most` lines of a ramp that leave the fewest lanes idle."""
    (slow, height), (fast, width) = grid.items()

    def vectors(size: Mapping[str, int]) -> int:
        """Vectors of lanes, half of all lanes each, that the lines of all chunks take."""
        rows, columns = ([(part, grid[axis] // part), (grid[axis] % part, 1)] for axis, part in size.items())
        return sum(n * m * math.ceil(2 * a * b / LANES) for (a, n), (b, m) in product(rows, columns))

    sizes = [
        {slow: even(height, n), fast: min(_up(even(width, most // n), width, halved), most // n)}
        for n in range(1, min(height, most) + 1)
    ]
    return min(sizes, key=vectors)


def estimate(spec: SweepSpec, plan: Plan) -> Cost:
    """Cost of a sweep, from the table of contact models."""
    cells, seconds = math.prod(spec.shape), cell_seconds(spec)
    return Cost(
        cells=cells,
        chunks=len(plan),
        bytes=cells * bytes_per_cell(spec),
        core_seconds=cells * seconds + CHUNK_SECONDS * len(plan),
        longest_core_seconds=cells * max(seconds, longest_cell_seconds(spec)),
    )


def cell_seconds(spec: SweepSpec, *, alone: bool = False) -> float:
    """Mean core-seconds per cell of a sweep, from the table of contact models; alone: as `period_seconds`."""
    share = CONTACT_MODELS[spec.model.kind].certified if spec.certifies else 1.0
    if spec.certifies and spec.ramp_axis is not None and spec.model.in_lanes:
        share *= CERTIFIED_ON_RAMPS
    return share * period_seconds(spec, alone=alone) * mean_periods(spec)


def mean_periods(spec: SweepSpec) -> float:
    """Mean plate periods of the cells of a sweep; certified ones cost as many whatever its window is."""
    if spec.certifies:
        parts = zip((UNCERTIFIED, *GOING_ON_SHARES), [sum(spec.window), *_extensions(spec)], strict=False)
        return CERTIFIED_PERIODS + sum(part * periods for part, periods in parts)
    followed = periods_followed(spec.observe)
    periods, share = sum(spec.window) + FOLLOWED_SHARE * followed, SETTLING_SHARE
    for added in _extensions(spec):
        periods, share = periods + share * (added + followed), share * STILL_SETTLING_SHARE
    return periods


def longest_cell_seconds(spec: SweepSpec) -> float:
    """Core-seconds of the busiest cells of the sweep, if MOST_SETTLING of them take all of `until`."""
    followed = 0 if spec.certifies else periods_followed(spec.observe)
    extended = MOST_SETTLING * sum(added + followed for added in _extensions(spec))
    return longest_seconds(spec, sum(spec.window) + followed + extended)


def longest_seconds(spec: SweepSpec, until: float) -> float:
    """Core-seconds of the busiest cells of the sweep, followed for `until` plate periods."""
    window = sum(spec.window)
    busiest = spec.model.busiest(*map(spec.axis_values, ("gamma", "omega", "xi")))
    return period_seconds(spec) * (busiest * window + min(busiest, BUSIEST_FOLLOWED) * (until - window))


def period_seconds(spec: SweepSpec, *, alone: bool = False) -> float:
    """Core-seconds per cell and computed plate period of a sweep, from the table of contact models.

    alone: for cells computed one by one, as in a refinement.
    """
    model = CONTACT_MODELS[spec.model.kind]
    at_once = 1 if alone else cells_at_once(spec)
    axes = map(spec.axis_values, ("gamma", "omega", "xi"))
    period_us = spec.model.cost_us(model.cost_us, *axes, at_once=at_once)
    if spec.ramp_axis is not None and at_once > 1:
        period_us *= model.ramp
    return period_us * 1e-6


def cells_at_once(spec: SweepSpec) -> int:
    """Number of cells, or lines of a ramp, that the kernel computes side by side; fewer leave lanes idle."""
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
