"""Tasks: computes a chunk of a sweep, stores it, and returns a report. Tasks are idempotent.

TaskError               why a chunk was not computed
├── ChunkCancelled      the cancel flag of the store is set
└── PredecessorMissing  the previous chunk of the ramp is not stored
"""

import importlib
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.line import run_line
from kernel.params import Cell, Line, Outcome, Start
from worker import schema, store
from worker.cost import cell_seconds, cells_at_once
from worker.plan import Chunk
from worker.spec import AXES, SweepSpec
from worker.spec.contact_models import CONTACT_MODELS, Contact
from worker.spec.protocols import Ramp
from worker.spec.sweep import start_of

#: Estimated core-seconds between two checks of the cancel flag, or the time of one cell if that is longer; of
#: a full set of lanes where cells are computed side by side. Hard cells can take many times the estimate,
#: so the interval is far below the time in which a user expects a job to stop.
CANCEL_SECONDS: Final = 0.25


class TaskError(Exception):
    """Why a chunk was not computed."""


class ChunkCancelled(TaskError):
    """The cancel flag of the store is set; nothing of the chunk was written."""


class PredecessorMissing(TaskError):
    """The chunk before this one on its ramp is not in the store."""


@dataclass(frozen=True, slots=True)
class ChunkReport:
    """Report of a computed chunk."""

    index: int
    cells: int
    seconds: float  # wall time, storing included
    kernel_seconds: float  # of which in the kernel
    checksum: str  # of the stored bytes, see store.find_corrupt
    outcomes: tuple[int, ...]  # number of cells by kernel.params.Outcome


#: Position of a line among the lines of its chunk.
_LineIndex = tuple[int, int]
_Arrays = dict[str, NDArray[Any]]


def run_chunk(spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute every cell of `chunk` and store it; the store must exist.

    Raises `ChunkCancelled`, `PredecessorMissing`, or a `store.StoreError`. In each case the chunk's cells
    stay missing and the chunk can be run again.
    """
    began = time.perf_counter()
    store.check_chunk(store_url, chunk)  # fail before computing, which can take minutes
    record = _empty_record(spec, chunk)
    lines = {name: _in_visiting_order(spec, chunk, array) for name, array in record.items()}
    cells = {name: _in_visiting_order(spec, chunk, array) for name, array in _cells(spec, chunk).items()}
    starts = _starts(spec, chunk, store_url)
    kernel_seconds = 0.0
    for index in np.ndindex(lines["outcome"].shape[:2]):
        for piece, done, seconds in _run_line(spec, cells, index, starts.get(index), store_url):
            kernel_seconds += seconds
            for name, array in lines.items():
                array[(*index, piece)] = getattr(done, name)
    checksum = store.write_chunk(store_url, chunk, record)
    outcomes = np.bincount(record["outcome"].ravel(), minlength=len(Outcome))
    took = time.perf_counter() - began
    return ChunkReport(chunk.index, chunk.cells, took, kernel_seconds, checksum, tuple(outcomes.tolist()))


def _run_line(
    spec: SweepSpec, cells: _Arrays, index: _LineIndex, start: Start | None, store_url: str
) -> Iterator[tuple[slice, Line, float]]:
    """Compute one line in pieces; yields each piece's slice, results and kernel seconds.

    The pieces depend on the specification alone and not on the clock, for reproducible results. Raises
    ChunkCancelled.
    """
    gamma, omega, xi = (cells[axis][index] for axis in ("gamma", "omega", "xi"))
    at_once = cells_at_once(spec)
    step = max(1, int(CANCEL_SECONDS / cell_seconds(spec) / at_once)) * at_once
    for low in range(0, len(gamma), step):
        if store.is_cancelled(store_url):
            raise ChunkCancelled(f"cancelled: {store_url}")
        piece = slice(low, low + step)
        began = time.perf_counter()
        with _noting_cells(gamma=gamma[piece], omega=omega[piece], xi=xi[piece]):
            done = run_cells(spec, gamma[piece], omega[piece], xi[piece], start)
        yield piece, done, time.perf_counter() - began
        last = low + len(done.outcome) - 1
        start = _start(done.end_state[-1], done.outcome[-1], Cell(gamma[last], omega[last], xi[last]))


@contextmanager
def _noting_cells(**axes: NDArray[np.float64]) -> Iterator[None]:
    """Add a note with the cells to any error."""
    try:
        yield
    except Exception as error:
        spans = [f"{name} {values[0]:g} to {values[-1]:g}" for name, values in axes.items()]
        error.add_note(f"in the cells {', '.join(spans)}")
        raise


def run_cells(
    spec: SweepSpec,
    gamma: NDArray[np.float64],
    omega: NDArray[np.float64],
    xi: NDArray[np.float64],
    start: Start | None,
) -> Line:
    """Compute a line of cells as a sweep does.

    gamma, omega, xi: (n,), in the order of the ramp. start: on a ramp, the state before the first cell;
    None starts from rest. Raises KernelInputError for values that the kernel does not accept.
    """
    carry = spec.ramp_axis is not None
    return run_line(
        np.ascontiguousarray(gamma),
        np.ascontiguousarray(omega),
        np.ascontiguousarray(xi),
        plate=plate_of(spec.model, gamma, omega, xi),
        carry=carry,
        settle=spec.settle,
        observe=spec.observe,
        keep=spec.keep,
        micro_flight=spec.micro_flight,
        settle_tolerance=spec.settle_tolerance,
        settle_until=spec.settle_until,
        exponents=spec.exponents,
        start=start if carry else None,
    )


def plate_of(
    model: Contact, gamma: NDArray[np.float64], omega: NDArray[np.float64], xi: NDArray[np.float64]
) -> Any:
    """The kernel's plate for cells of these parameters, (n,) each."""
    kernel = importlib.import_module(CONTACT_MODELS[model.kind].kernel)
    return kernel.plate(**model.plate_arguments(gamma, omega, xi))


def _start(state: NDArray[np.float64], outcome: int, cell: Cell) -> Start | None:
    """The start of the next cell on a ramp; None after a diverged cell: the next one starts from rest."""
    return None if outcome == Outcome.DIVERGED else Start(np.ascontiguousarray(state), cell)


def _starts(spec: SweepSpec, chunk: Chunk, store_url: str) -> dict[_LineIndex, Start | None]:
    """The start of each line of a ramp's chunk; empty if all lines start from rest."""
    layer = _layer_before(spec, chunk)
    if layer is None:
        return _starts_on_cycles(spec, chunk)
    stored = store.read_chunk(store_url, layer, ("end_state", "outcome"))
    previous = {
        name: _in_visiting_order(spec, layer, array) for name, array in (stored | _cells(spec, layer)).items()
    }
    if np.any(previous["outcome"] == Outcome.MISSING):
        raise PredecessorMissing(
            f"chunk {chunk.index} continues chunk {chunk.after} of the ramp, which is not stored"
        )
    return {index: _start_at(previous, (*index, 0)) for index in np.ndindex(previous["outcome"].shape[:2])}


def _starts_on_cycles(spec: SweepSpec, chunk: Chunk) -> dict[_LineIndex, Start | None]:
    """The start of each line of the first chunk of a ramp, on a cycle if the specification asks for it."""
    on = spec.protocol.start if isinstance(spec.protocol, Ramp) else None
    if on is None:
        return {}
    cells = {name: _in_visiting_order(spec, chunk, array) for name, array in _cells(spec, chunk).items()}
    return {
        index: start_of(Cell(*(float(cells[name][(*index, 0)]) for name in Cell._fields)), on.periods)
        for index in np.ndindex(cells["gamma"].shape[:2])
    }


def _start_at(arrays: _Arrays, index: tuple[int, ...]) -> Start | None:
    cell = Cell(*(float(arrays[name][index]) for name in Cell._fields))
    return _start(arrays["end_state"][index], arrays["outcome"][index], cell)


def _layer_before(spec: SweepSpec, chunk: Chunk) -> Chunk | None:
    """The cells, one per line, that precede the chunk's first cells on the ramp."""
    axis = spec.ramp_axis
    if axis is None or chunk.after is None:
        return None
    low, high = getattr(chunk, axis)
    direction, position = chunk.direction, low - 1
    if spec.directions[direction] == "down":
        is_last = high == len(spec.axis_values(axis))
        # A "down" ramp starts from the end of "up", whose last cell has the same parameters.
        direction, position = (direction - 1, high - 1) if is_last else (direction, high)
    spans = {name: getattr(chunk, name) for name in AXES} | {axis: (position, position + 1)}
    return Chunk(chunk.index, direction, **spans)


def _empty_record(spec: SweepSpec, chunk: Chunk) -> _Arrays:
    length = schema.sizes(spec)
    return {
        array.name: np.full(
            (*chunk.shape, *(length[dim] for dim in array.extra_dims)), array.fill, dtype=array.dtype
        )
        for array in schema.arrays(spec)
    }


def _cells(spec: SweepSpec, chunk: Chunk) -> _Arrays:
    """The parameters of every cell, each array of shape chunk.shape."""
    values = [spec.axis_values(axis)[slice(*getattr(chunk, axis))] for axis in AXES]
    return dict(zip(AXES, np.meshgrid(*values, indexing="ij"), strict=True))


def _in_visiting_order(spec: SweepSpec, chunk: Chunk, array: NDArray[Any]) -> NDArray[Any]:
    """A view of a chunk's array with the cells of a line, in the order of the ramp, along its third axis.

    From rest all cells form one line; on a ramp there is one line for each pair of the other two parameters.
    """
    if spec.ramp_axis is None:
        return array.reshape(1, 1, chunk.cells, *array.shape[3:])
    along = np.moveaxis(array, AXES.index(spec.ramp_axis), 2)
    return along[:, :, ::-1] if spec.directions[chunk.direction] == "down" else along


def compile_kernels() -> None:
    """Compile the kernels of all contact models, by computing one cell with each."""
    axis = np.ones(1)
    for kind, model in CONTACT_MODELS.items():
        contact: Any = model.fields(kind=kind)
        run_line(
            axis, axis, axis, plate=plate_of(contact, axis, axis, axis),
            carry=False, settle=0, observe=1, keep=1,
        )  # fmt: skip


def compile_for(spec: SweepSpec) -> None:
    """Compile what `compile_kernels` leaves out, if the sweep needs it: ramps of `rigid`, and exponents.

    Once compiled, it takes a fraction of a millisecond: one plate period of the first cell.
    """
    if not spec.exponents and not (spec.model.kind == "rigid" and spec.ramp_axis is not None):
        return
    gamma, omega, xi = (spec.axis_values(axis)[:1] for axis in ("gamma", "omega", "xi"))
    run_line(
        gamma, omega, xi, plate=plate_of(spec.model, gamma, omega, xi),
        carry=True, settle=0, observe=1, keep=1, exponents=spec.exponents,
    )  # fmt: skip
