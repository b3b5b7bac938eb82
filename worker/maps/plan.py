"""An adaptive map before it is computed: its tiles, and its cost."""

import math
from collections import Counter
from typing import Final

from worker.maps.refinement import Tile, refine_of
from worker.spec.refine import Refine
from worker.study.chunks import LONGEST_SECONDS, Cost, Plan
from worker.study.layout import bytes_of
from worker.sweep.plan import cell_seconds, longest_cell_seconds
from worker.sweep.schema import arrays, bytes_per_cell
from worker.sweep.specification import SweepSpec

#: Rows and columns of an adaptive map's tiles. Each tile is a chunk, refined by itself. Large enough to fill
#: the lanes in most rounds, small enough that a map of 513 rows and columns has some for every worker.
TILE_SIDE: Final = 128
MAX_TILE_BYTES: Final = 20 * 2**20

#: Least and largest share of an adaptive map's cells that are computed, for REFINED_SIDE rows and columns:
#: measured 0.2% to 0.9% by bouncing and 15% to 26% by mode at three xi (`python -m
#: benchmarks.adaptive`). Windows on their finest parts have more.
REFINED_SHARE: Final = {"bouncing": (0.001, 0.03), "mode": (0.02, 0.26)}
REFINED_SIDE: Final = 1025
#: The share falls with the number of rows as its reciprocal to this power, which follows from the dimension
#: of the boundaries: 1 for bouncing, about 1.3 for modes.
REFINED_POWER: Final = {"bouncing": 1.0, "mode": 0.7}
#: Core-seconds that dividing and storing a tile take, however few of its cells are computed: measured 0.009
#: to 0.02 by bouncing, 0.026 to 0.04 by mode, with 1 to 64 flights.
TILE_SECONDS: Final = {"bouncing": 0.015, "mode": 0.03}


def make_plan(
    spec: SweepSpec, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
) -> Plan:
    """Divide a map into tiles of `chunk_shape` cells along (xi, omega, gamma), or of `tile_shape`.

    A cell's values depend on its tile. Raises ValueError for a size below 1, or for tiles of several xi.
    """
    _, *grid = spec.shape
    shape = tile_shape(spec, refine_of(spec).coarsest) if chunk_shape is None else chunk_shape
    if shape[0] > 1:
        raise ValueError(f"chunk_shape: tiles of an adaptive map have one xi, not {shape[0]}")
    return Plan(tuple(grid), shape, spec.directions)


def tile_shape(spec: SweepSpec, coarsest: int) -> tuple[int, int, int]:
    """Cells of an adaptive map's tiles along (xi, omega, gamma).

    As many blocks of `coarsest` as fit into TILE_SIDE, plus the row and column of the blocks' last corners.
    Depends on the specification alone, not on its cost or the workers.
    """
    most = math.isqrt(MAX_TILE_BYTES // bytes_per_cell(spec))
    side = min(max(TILE_SIDE // coarsest, 1), max((most - 1) // coarsest, 1)) * coarsest + 1
    side = max(min(side, most), 1)
    return 1, side, side


def estimate(spec: SweepSpec, plan: Plan) -> Cost:
    """The most that maps like this usually cost: the cost itself is known only once the map is computed."""
    cells, seconds = plan.cells, cell_seconds(spec)
    refine = refine_of(spec)
    low, high = (math.ceil(share * cells) for share in computed_shares(spec, refine))
    refined = seconds + TILE_SECONDS[refine.by] * len(plan) / high
    filled_in = bytes_of((array for array in arrays(spec) if not array.extra_dims), {})  # without fill values
    return Cost(
        cells=cells,
        chunks=len(plan),
        bytes=high * bytes_per_cell(spec) + (cells - high) * filled_in,
        core_seconds=high * refined,
        longest_core_seconds=high * max(refined, longest_cell_seconds(spec)),
        computed_cells=(low, high),
        least_core_seconds=low * seconds,
    )


def computed_shares(spec: SweepSpec, refine: Refine) -> tuple[float, float]:
    """Least and largest share of an adaptive map's cells that are usually computed."""
    _, _, omegas, gammas = spec.shape
    side = math.sqrt(omegas * gammas)
    finer = (REFINED_SIDE / side) ** REFINED_POWER[refine.by]
    coarsest = 2.0 / refine.coarsest**2  # a corner and a centre for each block
    low, high = (coarsest + share * finer for share in REFINED_SHARE[refine.by])
    return min(low, 1.0), min(high, 1.0)


def first_round(spec: SweepSpec, plan: Plan) -> int:
    """Cells of the first rounds of all tiles, which every map of this plan computes."""
    xis, *grid = plan.grid
    rows, columns = (
        Counter(min(size, n - low) for low in range(0, n, size))
        for n, size in zip(grid, plan.chunk_shape[1:], strict=True)
    )
    return xis * sum(
        times * again * Tile((height, width), refine_of(spec)).cells.size
        for height, times in rows.items()
        for width, again in columns.items()
    )
