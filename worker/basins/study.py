"""The study `basin`: which attractor each start of a plane reaches, in every cell of a grid (docs/basins.md).

A task computes whole cells, since attractors are told apart among all starts of a cell.
"""

import math
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.interface import prepare, rest
from kernel.line import LineRun
from kernel.params import KERNEL_VERSION, STATE_FIELDS, Line, Outcome
from worker import store
from worker.basins.attractors import Found, Request, Rules, find
from worker.basins.spec import BasinSpec
from worker.cost import Cost, cell_seconds, period_seconds
from worker.grid_plan import Block, GridPlan
from worker.plan import MAX_CHUNK_BYTES, TARGET_SECONDS
from worker.schema import COORDINATES, OUTCOME, OUTCOME_FLAGS, Array, Layout
from worker.spec import AXES, SweepSpec
from worker.tasks import SLICE_SECONDS, ChunkReport, Work, plate_of

#: Attractors of a cell that are stored, the largest basins first. Starts of others count as undecided.
MAX_ATTRACTORS: Final = 32

#: Starts along a side of the boxes of which the entropies are means.
BOX: Final = 8

_NAN: Final = float("nan")
_CELLS: Final = "cells_done"
_RECORD: Final = "record/"
_ANSWER: Final = "answer/"

_Arrays = dict[str, NDArray[Any]]


def _array(
    name: str, extra: tuple[str, ...], dtype: str, long_name: str, units: str = "1", **attrs: Any
) -> Array:
    fill = _NAN if dtype == "<f8" else 0
    return Array(name, (*AXES, *extra), dtype, fill, {"long_name": long_name, "units": units, **attrs})


def _arrays(spec: BasinSpec) -> tuple[Array, ...]:
    """The stored arrays in the order they are written."""
    exponents = [
        _array("lyapunov", ("id", "exponent"), "<f8", "Lyapunov exponents, the largest first",
               comment="per plate period, natural logarithm"),
    ]  # fmt: skip
    return (
        _array("attractor", ("row", "column"), "|u1", "attractor that a start reaches",
               comment="0: undecided, or of an attractor beyond the dimension id"),
        _array("fraction", ("id",), "<f8", "share of the starts that reach the attractor"),
        _array("attractor_outcome", ("id",), "|u1", "what the attractor does", **OUTCOME_FLAGS),
        _array("bounces", ("id",), "<i4", "bounces in one cycle, 0 without a cycle"),
        _array("periods", ("id",), "<i4", "plate periods in one cycle, 0 without a cycle"),
        _array("longest_flight", ("id",), "<f8", "longest flight", "rad"),
        _array("lifetime", ("id",), "<f8", "plate periods until aperiodic motion ends; inf: none ended"),
        _array("flight_time", ("id", "flight"), "<f8", "last flights of a window in order", "rad"),
        _array("takeoff_phase", ("id", "flight"), "<f8", "plate phase at take-off, modulo 2 pi", "rad"),
        _array("attractor_state", ("id", "state"), "<f8", "a state on the attractor, in the cell's own units",
               fields=" ".join(STATE_FIELDS)),
        *(exponents if spec.exponents else ()),
        _array("attractor_count", (), "<i4", "attractors of the cell, also those beyond the dimension id"),
        _array("undecided", (), "<f8", "share of the starts without an attractor"),
        _array("basin_entropy", (), "<f8", f"basin entropy, of boxes of {BOX} by {BOX} starts",
               comment="natural logarithm; NaN: fewer starts than a box has"),
        _array("boundary_entropy", (), "<f8", f"boundary basin entropy, of boxes of {BOX} by {BOX} starts",
               comment="mean over the boxes with more than one attractor; 0 without such boxes"),
        OUTCOME._replace(dims=AXES, attrs={
            "long_name": "whether the cell is computed", "units": "1",
            "flag_values": [Outcome.MISSING.value, Outcome.PERIODIC.value, Outcome.UNRESOLVED.value],
            "flag_meanings": "missing computed undecided",
        }),
    )  # fmt: skip


def _sizes(spec: BasinSpec) -> dict[str, int]:
    plane = spec.protocol
    return {
        "row": plane.rows, "column": plane.columns, "id": MAX_ATTRACTORS, "flight": spec.keep,
        "state": len(STATE_FIELDS), "exponent": spec.exponents,
    }  # fmt: skip


def bytes_per_cell(spec: BasinSpec) -> int:
    """Stored bytes per cell before compression."""
    sizes = _sizes(spec)
    return sum(
        np.dtype(array.dtype).itemsize * math.prod(sizes[dim] for dim in array.extra_dims)
        for array in _arrays(spec)
    )


_ROW: Final = {
    "drop": {"long_name": "height of the lower mass above the plate", "units": "plate amplitudes"},
    "contact": {"long_name": "elongation beyond the static one", "units": "plate amplitudes"},
}
_COLUMN: Final = {
    "drop": {"long_name": "plate phase at which the spring is let go", "units": "rad"},
    "contact": {"long_name": "velocity of the elongation times omega", "units": "plate amplitudes"},
}


def layout(spec: BasinSpec, chunk_shape: tuple[int, ...]) -> Layout:
    """Layout of the store with chunks of `chunk_shape` cells along (xi, omega, gamma)."""
    plane = spec.protocol
    attrs: dict[str, Any] = {row.name: row.attrs for row in COORDINATES if row.name in AXES}
    return Layout(
        chunk_sizes=dict(zip(AXES, chunk_shape, strict=True)),
        coordinates={
            **{axis: spec.axis_values(axis).astype("<f8") for axis in AXES},
            "row": plane.row_values,
            "column": plane.column_values,
            "id": np.arange(1, MAX_ATTRACTORS + 1, dtype="<i4"),
        },
        extra_sizes=_sizes(spec),
        arrays=_arrays(spec),
        coordinate_attrs={
            **attrs,
            "row": _ROW[plane.plane],
            "column": _COLUMN[plane.plane],
            "id": {"long_name": "attractor, by the share of the starts that reach it"},
        },
        attributes={
            "Conventions": "CF-1.11",
            "title": spec.name or "bouncing spring: basins of attraction",
            "kernel_version": KERNEL_VERSION,
            "model": spec.model.kind,
            "spec": spec.as_submitted(),
        },
        identity={"job": spec.job_id(KERNEL_VERSION), "chunk_shape": list(chunk_shape)},
    )


def _of_starts(spec: BasinSpec) -> SweepSpec:
    """The sweep whose cells cost what starts do: no exponents are computed of them."""
    return spec.sweep().model_copy(update={"exponents": 0})


def start_seconds(spec: BasinSpec) -> float:
    """Core-seconds per start, on average."""
    return cell_seconds(_of_starts(spec))


def make_plan(spec: BasinSpec, chunk_shape: tuple[int, ...] | None = None) -> GridPlan:
    """Chunks of `chunk_shape` cells along (xi, omega, gamma), or of about a second: rows of gamma.

    Raises ValueError for a size below 1.
    """
    if chunk_shape is None:
        starts = spec.protocol.rows * spec.protocol.columns
        seconds, size = starts * start_seconds(spec), bytes_per_cell(spec)
        cells = max(1, int(min(TARGET_SECONDS / seconds, MAX_CHUNK_BYTES / size)))
        gammas = spec.shape[2]
        row = -(-gammas // -(-gammas // min(cells, gammas)))
        chunk_shape = (1, max(1, min(spec.shape[1], cells // row)), row)
    return GridPlan(spec.shape, chunk_shape)


def run_chunk(spec: BasinSpec, chunk: Block, store_url: str, slice_seconds: float = math.inf) -> ChunkReport:
    """Compute every cell of `chunk` and store it; the store must exist.

    Goes on from the chunk's checkpoint, if there is one. Raises `ChunkCancelled`, `ChunkPaused` once
    `slice_seconds` core-seconds are over, or a `store.StoreError`.
    """
    began = time.perf_counter()
    store.check_chunk(store_url, chunk)
    record = _empty_record(spec, chunk)
    values = [spec.axis_values(axis)[span] for axis, span in zip(AXES, chunk.slices, strict=True)]
    work = _Work(store_url, chunk.index, record, began, slice_seconds)
    for number, index in enumerate(np.ndindex(chunk.shape)):
        if number < work.cells_done:
            continue
        xi, omega, gamma = (float(axis[i]) for axis, i in zip(values, index, strict=True))
        found = find(starts_of(spec, gamma, omega, xi), _rules(spec), _runner(spec, gamma, omega, xi, work))
        _fill_in(
            spec, found, {name: array[index] for name, array in record.items() if array.ndim > len(index)}
        )
        _fill_in_numbers(spec, found, record, index)
        work.finish_cell()
    checksum = store.write_chunk(store_url, chunk, record)
    work.remove_checkpoint()
    outcomes = np.bincount(record["outcome"].ravel(), minlength=len(Outcome))
    took, kernel_seconds = work.seconds
    return ChunkReport(chunk.index, chunk.cells, took, kernel_seconds, checksum, tuple(outcomes.tolist()))


def _rules(spec: BasinSpec) -> Rules:
    return Rules(spec.settle, spec.observe, spec.until, spec.keep, spec.micro_flight, spec.exponents)


def _plate(spec: BasinSpec, n: int, *cell: float) -> tuple[Any, tuple[NDArray[np.float64], ...]]:
    """The plate under n starts of a cell (gamma, omega, xi), and the cell's parameters n times."""
    values = tuple(np.full(n, value) for value in cell)
    return plate_of(spec.model, *values), values


def starts_of(spec: BasinSpec, gamma: float, omega: float, xi: float) -> NDArray[np.float64]:
    """The states (rows * columns, 6) of a cell's plane of starts, row by row (see params.STATE_FIELDS)."""
    plane = spec.protocol
    row, column = np.meshgrid(plane.row_values, plane.column_values, indexing="ij")
    states = np.zeros((*row.shape, len(STATE_FIELDS)))
    if plane.plane == "drop":
        states[..., 0], states[..., 1], states[..., 2] = column, 1.0, row
        states[..., 3] = np.sin(column)  # relative to the plate, which moves as cos(phase)
    else:
        plate, _ = _plate(spec, 1, gamma, omega, xi)
        states[..., 2:] = rest(prepare(plate, 0, gamma, omega, xi))
        states[..., 4] += row
        states[..., 5] += column / omega
    return states.reshape(-1, len(STATE_FIELDS))


def _runner(
    spec: BasinSpec, gamma: float, omega: float, xi: float, work: "_Work"
) -> Callable[[Request, Callable[[Line], _Arrays]], _Arrays]:
    """Answers the requests of a search, at first from what is kept of an earlier slice."""
    answered = 0

    def run(request: Request, reduce: Callable[[Line], _Arrays]) -> _Arrays:
        nonlocal answered
        if answered == len(work.answers):
            plate, cells = _plate(spec, len(request.states), gamma, omega, xi)
            line = LineRun(
                *cells, plate=plate, carry=False, settle=request.settle, observe=request.observe,
                keep=request.keep, micro_flight=spec.micro_flight, exponents=request.exponents,
                states=request.states,
            )  # fmt: skip
            work.keep_answer(reduce(work.compute(line)))
        answered += 1
        return work.answers[answered - 1]

    return run


class _Work(Work):
    """Of basins: the cells that are done, and the answers that the search in the next one has had."""

    def __init__(
        self, store_url: str, chunk: int, record: _Arrays, began: float, slice_seconds: float
    ) -> None:
        self._record, self.cells_done = record, 0
        self.answers: list[_Arrays] = []
        super().__init__(store_url, chunk, began, slice_seconds)

    def keep_answer(self, answer: _Arrays) -> None:
        """Keep an answer. Raises ChunkPaused."""
        self.answers.append(answer)
        self.pause_if_due({})

    def finish_cell(self) -> None:
        """The cell is in the record now."""
        self.cells_done += 1
        self.answers = []

    def _kept(self) -> _Arrays:
        arrays: _Arrays = {_CELLS: np.array(self.cells_done)}
        arrays |= {_RECORD + name: array for name, array in self._record.items()}
        for number, answer in enumerate(self.answers):
            arrays |= {f"{_ANSWER}{number}/{name}": array for name, array in answer.items()}
        return arrays

    def _restore(self, saved: _Arrays) -> None:
        self.cells_done = int(saved[_CELLS])
        for name, array in self._record.items():
            array[...] = saved[_RECORD + name]
        answers: dict[int, _Arrays] = {}
        for name, array in saved.items():
            if name.startswith(_ANSWER):
                number, field = name.removeprefix(_ANSWER).split("/")
                answers.setdefault(int(number), {})[field] = array
        self.answers = [answers[number] for number in range(len(answers))]


def _empty_record(spec: BasinSpec, chunk: Block) -> _Arrays:
    sizes = _sizes(spec)
    return {
        array.name: np.full(
            (*chunk.shape, *(sizes[dim] for dim in array.extra_dims)), array.fill, array.dtype
        )
        for array in _arrays(spec)
    }


def _fill_in(spec: BasinSpec, found: Found, cell: _Arrays) -> None:
    """Fill in the arrays of one cell that have further dimensions."""
    ids = np.where(found.ids <= MAX_ATTRACTORS, found.ids, 0).astype(np.uint8)
    cell["attractor"][...] = ids.reshape(spec.protocol.rows, spec.protocol.columns)
    for i, attractor in enumerate(found.attractors[:MAX_ATTRACTORS]):
        cell["attractor_outcome"][i] = attractor.outcome
        for name in ("fraction", "bounces", "periods", "longest_flight", "lifetime",
                     "flight_time", "takeoff_phase"):  # fmt: skip
            cell[name][i] = getattr(attractor, name)
        cell["attractor_state"][i] = attractor.state
        if spec.exponents:
            cell["lyapunov"][i] = attractor.lyapunov


def _fill_in_numbers(spec: BasinSpec, found: Found, record: _Arrays, index: tuple[int, ...]) -> None:
    """Fill in the numbers of one cell."""
    ids = record["attractor"][index]
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
        return _NAN, _NAN
    sides = ids[: rows * BOX, : columns * BOX].reshape(rows, BOX, columns, BOX)
    boxes = sides.swapaxes(1, 2).reshape(rows * columns, BOX * BOX)
    counts = np.stack([(boxes == i).sum(axis=1) for i in range(1, max(int(ids.max()), 1) + 1)])
    share = counts / np.maximum(counts.sum(axis=0), 1)
    entropy = -np.where(share > 0.0, share * np.log(np.where(share > 0.0, share, 1.0)), 0.0).sum(axis=0)
    mixed = (counts > 0).sum(axis=0) > 1
    return float(entropy.mean()), float(entropy[mixed].mean()) if mixed.any() else 0.0


class BasinStudy:
    """Basins of attraction."""

    def parse(self, data: object) -> BasinSpec:
        return BasinSpec.parse(data)

    def plan(self, spec: BasinSpec, chunk_shape: tuple[int, ...] | None = None) -> GridPlan:
        return make_plan(spec, chunk_shape)

    def variables(self, spec: BasinSpec, chunk_shape: tuple[int, ...]) -> Layout:
        return layout(spec, chunk_shape)

    def estimate(self, spec: BasinSpec, plan: GridPlan) -> Cost:
        starts = plan.cells * spec.protocol.rows * spec.protocol.columns
        return Cost(
            cells=plan.cells,
            chunks=len(plan),
            bytes=plan.cells * bytes_per_cell(spec),
            core_seconds=starts * start_seconds(spec),
            longest_core_seconds=starts * period_seconds(_of_starts(spec)) * spec.until,
        )

    def task(self, spec: BasinSpec, chunk: Block, store_url: str) -> ChunkReport:
        return run_chunk(spec, chunk, store_url, SLICE_SECONDS)


BASINS: Final = BasinStudy()
