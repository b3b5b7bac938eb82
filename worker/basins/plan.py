"""Division of basins and of multistability into chunks, and their cost."""

from typing import Final

from worker.basins.schema import FOLLOWED_ARRAYS, MAX_FOLLOWED, basin_arrays, basin_sizes, sizes_of_attractors
from worker.basins.specification import BasinSpec, GridSpec, MultistabilitySpec
from worker.spec.errors import Problem, SpecTooLarge
from worker.study.chunks import LONGEST_SECONDS, MAX_CHUNK_BYTES, TARGET_SECONDS, Cost, Plan, even
from worker.study.layout import bytes_of
from worker.sweep import SweepSpec
from worker.sweep.plan import CHUNK_SECONDS, cell_seconds, longest_seconds

#: Starts of an attractor that run on, and the windows for which they do.
REPRESENTATIVES, RUNS_ON = 32, 8

#: Most bytes of a line, which is computed as one: a slice of it lasts four seconds (`worker.work`).
MAX_LINE_BYTES: Final = 64 * 2**20

#: Average runs of a cell of a multistability study: of each drop with its continuation, and of followed
#: attractors.
RUN_ON: Final = 1.9
FOLLOWED: Final = 16


def _of_starts(spec: GridSpec) -> SweepSpec:
    """The sweep whose cells cost as much as starts: without exponents."""
    return spec.sweep().model_copy(update={"exponents": 0})


def start_seconds(spec: GridSpec) -> float:
    """Core-seconds of the window of a start, from the table of contact models."""
    return cell_seconds(_of_starts(spec))


def plan_basins(
    spec: BasinSpec, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
) -> Plan:
    """Chunks of `chunk_shape` cells along (xi, omega, gamma); by default rows of gamma, about a second.

    Raises ValueError for a size below 1.
    """
    if chunk_shape is None:
        starts = spec.protocol.rows * spec.protocol.columns
        seconds = starts * start_seconds(spec)
        size = bytes_of(basin_arrays(spec), basin_sizes(spec))
        cells = max(1, int(min(TARGET_SECONDS / seconds, MAX_CHUNK_BYTES / size)))
        row = even(spec.shape[2], cells)
        chunk_shape = (1, max(1, cells // row), row)
    return Plan(spec.shape, chunk_shape)


def estimate_basins(spec: BasinSpec, plan: Plan) -> Cost:
    """Cost of a study, from the table of contact models."""
    starts = spec.protocol.rows * spec.protocol.columns
    runs = starts + RUNS_ON * min(starts, REPRESENTATIVES)
    size = bytes_of(basin_arrays(spec), basin_sizes(spec))
    return _cost(spec, plan, _of_starts(spec), runs, size)


def plan_lines(
    spec: MultistabilitySpec, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
) -> Plan:
    """Chunks of whole lines along gamma, of `chunk_shape` cells or of about a second.

    Raises SpecTooLarge for lines above MAX_LINE_BYTES, ValueError for sizes below 1 or for parts of lines.
    """
    gammas = spec.shape[2]
    if chunk_shape is None:
        size = _bytes_of_a_cell(spec)
        if gammas * size > MAX_LINE_BYTES:
            rule = f"one line of {gammas:,} cells takes {gammas * size:,} bytes; at most {MAX_LINE_BYTES:,}"
            remedy = f"take at most {MAX_LINE_BYTES // size:,} values, or keep fewer flights"
            raise SpecTooLarge([Problem("gamma", f"{rule} are allowed: {remedy}")])
        seconds = _runs(spec) * cell_seconds(spec.sweep())
        lines = min(TARGET_SECONDS / seconds, MAX_CHUNK_BYTES / size) / gammas
        chunk_shape = (1, max(1, int(lines)), gammas)
    plan = Plan(spec.shape, chunk_shape)
    if plan.chunk_shape[-1] != gammas:
        raise ValueError(f"chunk_shape: must span the {gammas} values of gamma, not {chunk_shape[-1]}")
    return plan


def estimate_lines(spec: MultistabilitySpec, plan: Plan) -> Cost:
    """Cost of a study, from the table of contact models."""
    return _cost(spec, plan, spec.sweep(), _runs(spec), _bytes_of_a_cell(spec))


def _cost(spec: GridSpec, plan: Plan, sweep: SweepSpec, runs: float, size: int) -> Cost:
    """Cost of cells of `size` bytes, each of `runs` runs of a cell of the sweep."""
    runs *= plan.cells
    return Cost(
        cells=plan.cells,
        chunks=len(plan),
        bytes=plan.cells * size,
        core_seconds=runs * cell_seconds(sweep) + CHUNK_SECONDS * len(plan),
        longest_core_seconds=runs * longest_seconds(sweep, spec.until),
    )


def _bytes_of_a_cell(spec: MultistabilitySpec) -> int:
    return bytes_of(FOLLOWED_ARRAYS, sizes_of_attractors(spec, MAX_FOLLOWED))


def _runs(spec: MultistabilitySpec) -> float:
    """Average runs of a cell, each of settle + observe plate periods."""
    return RUN_ON * spec.protocol.rows * spec.protocol.columns + FOLLOWED
