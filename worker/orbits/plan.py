"""Division of a study of orbits into chunks, and its cost."""

import math
from typing import Final

from worker.orbits.schema import ARRAYS, sizes
from worker.orbits.specification import OrbitsSpec, grid_points
from worker.study.chunks import LONGEST_SECONDS, MAX_CHUNK_BYTES, TARGET_SECONDS, Cost, Plan, even
from worker.study.layout import bytes_of

#: Core-seconds of a branch over the square of its flight times (`python -m benchmarks.branches`).
SECONDS: Final = 7e-8


def make_plan(
    spec: OrbitsSpec, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
) -> Plan:
    """Chunks of `chunk_shape` cells along (xi, omega); by default rows of omega, about a second of work.

    Raises ValueError for a size below 1.
    """
    if chunk_shape is None:
        all_cells = math.prod(spec.shape)
        seconds, size = _seconds(spec) / all_cells, bytes_of(ARRAYS, sizes(spec))
        cells = max(1, int(min(TARGET_SECONDS / seconds, MAX_CHUNK_BYTES / size, math.ceil(all_cells / 8))))
        row = even(spec.shape[1], cells)
        chunk_shape = (max(1, cells // row), row)
    return Plan(spec.shape, chunk_shape)


def estimate(spec: OrbitsSpec, plan: Plan) -> Cost:
    """Cost of a study."""
    size = plan.cells * bytes_of(ARRAYS, sizes(spec))
    return Cost(cells=plan.cells, chunks=len(plan), bytes=size, core_seconds=_seconds(spec))


def _seconds(spec: OrbitsSpec) -> float:
    """Core-seconds of the whole grid."""
    omega = spec.axis_values("omega")
    squares = sum(float((grid_points(omega, k) ** 2).sum()) for k in spec.periods)
    return SECONDS * squares * spec.shape[0]
