"""The study `basin`: which attractor each start of a plane reaches, in every cell of a grid (docs/basins.md).

A task computes whole cells, since attractors are distinguished among all starts of a cell.
"""

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Line, Outcome
from worker.basins.attractors import REPRESENTATIVES, Found, Request, find
from worker.basins.schema import COUNT, LIFETIME, OF_ATTRACTORS, OUTCOME, sizes_of_attractors
from worker.basins.spec import BasinSpec
from worker.basins.starts import Steps, line_run, starts_of
from worker.cost import Cost, cell_seconds, longest_period_seconds
from worker.plan import LONGEST_SECONDS, MAX_CHUNK_BYTES, TARGET_SECONDS, Chunk, Plan, even
from worker.schema import Array, Layout, array, bytes_of, empty_record, grid_layout
from worker.spec import AXES, SweepSpec
from worker.tasks import ChunkReport

#: Stored attractors of a cell, the largest basins first. Starts of others count as undecided.
MAX_ATTRACTORS: Final = 32

#: Side of the boxes for the entropies, in starts.
BOX: Final = 8

_Arrays = dict[str, NDArray[Any]]


def arrays(spec: BasinSpec) -> tuple[Array, ...]:
    """The stored arrays in the order they are written."""
    exponents = [
        array("lyapunov", (*AXES, "id", "exponent"), "<f8", "Lyapunov exponents, the largest first",
              comment="per plate period, natural logarithm"),
    ]  # fmt: skip
    return (
        array("attractor", (*AXES, "row", "column"), "|u1", "attractor that a start reaches",
              comment="0: undecided, or of an attractor beyond the dimension id"),
        *OF_ATTRACTORS[:5],
        LIFETIME,
        *OF_ATTRACTORS[5:],
        *(exponents if spec.exponents else ()),
        COUNT,
        array("undecided", AXES, "<f8", "share of the starts without an attractor"),
        array("basin_entropy", AXES, "<f8", f"basin entropy, of boxes of {BOX} by {BOX} starts",
              comment="natural logarithm; NaN: fewer starts than a box has"),
        array("boundary_entropy", AXES, "<f8", f"boundary basin entropy, of boxes of {BOX} by {BOX} starts",
              comment="mean over the boxes with more than one attractor; 0 without such boxes"),
        OUTCOME,
    )  # fmt: skip


def sizes(spec: BasinSpec) -> dict[str, int]:
    plane = spec.protocol
    return {"row": plane.rows, "column": plane.columns, "exponent": spec.exponents,
            **sizes_of_attractors(spec, MAX_ATTRACTORS)}  # fmt: skip


#: Attributes of the rows and columns of each plane.
_SIDES: Final = {
    "drop": (
        {"long_name": "height of the lower mass above the plate, in plate amplitudes", "units": "1"},
        {"long_name": "plate phase at which the spring is let go", "units": "rad"},
    ),
    "contact": (
        {"long_name": "elongation beyond the static one, in plate amplitudes", "units": "1"},
        {"long_name": "velocity of the elongation times omega, in plate amplitudes", "units": "1"},
    ),
}


def layout(spec: BasinSpec, chunk_shape: tuple[int, ...]) -> Layout:
    """Layout of the store with chunks of `chunk_shape` cells along (xi, omega, gamma)."""
    plane = spec.protocol
    row, column = _SIDES[plane.plane]
    coordinates = {
        "row": (plane.row_values, row),
        "column": (plane.column_values, column),
        "id": (np.arange(1, MAX_ATTRACTORS + 1, dtype="<i4"),
               {"long_name": "attractor, by the share of the starts that reach it"}),
    }  # fmt: skip
    title = "bouncing spring: basins of attraction"
    return grid_layout(spec, chunk_shape, arrays(spec), sizes(spec), coordinates, title, spec.model.kind)


def _of_starts(spec: BasinSpec) -> SweepSpec:
    """The sweep whose cells cost as much as starts: without exponents."""
    return spec.sweep().model_copy(update={"exponents": 0})


def make_plan(
    spec: BasinSpec, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
) -> Plan:
    """Chunks of `chunk_shape` cells along (xi, omega, gamma); by default rows of gamma, about a second.

    Raises ValueError for a size below 1.
    """
    if chunk_shape is None:
        starts = spec.protocol.rows * spec.protocol.columns
        seconds, size = starts * cell_seconds(_of_starts(spec)), bytes_of(arrays(spec), sizes(spec))
        cells = max(1, int(min(TARGET_SECONDS / seconds, MAX_CHUNK_BYTES / size)))
        row = even(spec.shape[2], cells)
        chunk_shape = (1, max(1, cells // row), row)
    return Plan(spec.shape, chunk_shape)


def estimate(spec: BasinSpec, plan: Plan) -> Cost:
    """Cost of a study, from the table of contact models."""
    starts, sweep = spec.protocol.rows * spec.protocol.columns, _of_starts(spec)
    longest = (starts + REPRESENTATIVES) * longest_period_seconds(sweep) * spec.until
    return Cost(
        cells=plan.cells,
        chunks=len(plan),
        bytes=plan.cells * bytes_of(arrays(spec), sizes(spec)),
        core_seconds=plan.cells * starts * cell_seconds(sweep),
        longest_core_seconds=plan.cells * longest,
    )


def run_chunk(spec: BasinSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute every cell of `chunk` and store it; the store must exist.

    Continues from the chunk's checkpoint, if there is one. Raises `ChunkCancelled`, `ChunkPaused` after
    the slice of `tasks.OPTIONS`, or a `store.StoreError`.
    """
    record = empty_record(chunk.shape, arrays(spec), sizes(spec))
    values = [spec.axis_values(axis)[span] for axis, span in zip(AXES, chunk.slices, strict=True)]
    work = Steps(store_url, chunk, arrays(spec), record)
    for index in list(np.ndindex(chunk.shape))[work.done :]:
        xi, omega, gamma = (float(axis[i]) for axis, i in zip(values, index, strict=True))
        found = find(starts_of(spec, gamma, omega, xi), spec, _runner(spec, gamma, omega, xi, work))
        _fill_in(spec, found, record, index)
        work.finish_step()
    return work.write(record)


def _runner(
    spec: BasinSpec, gamma: float, omega: float, xi: float, work: Steps
) -> Callable[[Request, Callable[[Line], _Arrays]], _Arrays]:
    """Answers the requests of a search, first from the answers of earlier slices."""

    def run(request: Request, reduce: Callable[[Line], _Arrays]) -> _Arrays:
        gammas, omegas, xis = (np.full(len(request.states), value) for value in (gamma, omega, xi))
        return work.answer(lambda: line_run(spec, (gammas, omegas, xis), **request._asdict()), reduce)

    return run


def _fill_in(spec: BasinSpec, found: Found, record: _Arrays, index: tuple[int, ...]) -> None:
    """Fill in one cell."""
    ids = np.where(found.ids <= MAX_ATTRACTORS, found.ids, 0).astype(np.uint8)
    ids = ids.reshape(spec.protocol.rows, spec.protocol.columns)
    record["attractor"][index] = ids
    for i, attractor in enumerate(found.attractors[:MAX_ATTRACTORS]):
        for name in (row.name for row in (*OF_ATTRACTORS, LIFETIME)):
            record[name][*index, i] = getattr(attractor, name.removeprefix("attractor_"))
        if spec.exponents:
            record["lyapunov"][*index, i] = attractor.lyapunov
    record["attractor_count"][index] = len(found.attractors)
    record["undecided"][index] = np.mean(ids == 0)
    record["basin_entropy"][index], record["boundary_entropy"][index] = entropies(ids)
    record["outcome"][index] = Outcome.PERIODIC if found.attractors else Outcome.UNRESOLVED


def entropies(ids: NDArray[np.uint8]) -> tuple[float, float]:
    """Basin entropy and boundary basin entropy of a map (rows, columns) of attractors.

    Means of the entropy -sum p ln p of the attractors' shares in boxes of BOX by BOX starts: over all boxes,
    and over those with more than one attractor (Daza et al., Scientific Reports 6, 31416, 2016). Rows and
    columns beyond whole boxes do not count, nor do undecided starts. NaN without a whole box.
    """
    rows, columns = (n // BOX for n in ids.shape)
    if not rows * columns:
        return math.nan, math.nan
    sides = ids[: rows * BOX, : columns * BOX].reshape(rows, BOX, columns, BOX)
    boxes = sides.swapaxes(1, 2).reshape(rows * columns, BOX * BOX)
    counts = np.stack([(boxes == i).sum(axis=1) for i in range(1, max(int(ids.max()), 1) + 1)])
    share = counts / np.maximum(counts.sum(axis=0), 1)
    entropy = -np.where(share > 0.0, share * np.log(np.where(share > 0.0, share, 1.0)), 0.0).sum(axis=0)
    mixed = (counts > 0).sum(axis=0) > 1
    return float(entropy.mean()), float(entropy[mixed].mean()) if mixed.any() else 0.0
