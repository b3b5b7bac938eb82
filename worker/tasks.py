"""Room: computing one chunk of a sweep; the only thing that workers of a cluster run.

A task takes values, writes its chunk to the store, and returns a report, never data. Run
again, it writes the same bytes. Imports the kernel and worker; nothing of the service.

    TaskError               why a chunk was not computed
    ├── ChunkCancelled      somebody set the store's cancel mark
    └── PredecessorMissing  a ramp's chunk has nothing to carry on from
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
from worker.cost import cell_seconds
from worker.plan import Chunk
from worker.spec import AXES, SweepSpec
from worker.spec.contact_models import CONTACT_MODELS, Contact

#: How much computing, by the cost table, goes between two looks at the cancel mark. The
#: table can be wrong by a lot for hard cells, hence well below what a user would wait for.
CANCEL_SECONDS: Final = 0.25


class TaskError(Exception):
    """Why a chunk was not computed."""


class ChunkCancelled(TaskError):
    """The store's cancel mark was set; nothing of the chunk was written."""


class PredecessorMissing(TaskError):
    """The chunk before this one on its ramp is not in the store."""


@dataclass(frozen=True, slots=True)
class ChunkReport:
    """What became of a chunk. `outcomes` counts its cells by `kernel.params.Outcome`."""

    index: int
    cells: int
    seconds: float  # wall, from start to stored
    kernel_seconds: float  # of which in the kernel
    checksum: str  # of the stored bytes, see store.verify
    outcomes: tuple[int, ...]


#: A line's place among the lines of its chunk.
_Place = tuple[int, int]
_Arrays = dict[str, NDArray[Any]]


def run_chunk(spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute every cell of `chunk` and store it; the store must have been created.

    Raises `ChunkCancelled`, `PredecessorMissing`, or a `store.StoreError`; then nothing, or
    nothing that counts, has been written, and the chunk can simply be run again.
    """
    began = time.perf_counter()
    store.check_chunk(store_url, chunk)  # before minutes are spent on what cannot be stored
    record = _empty_record(spec, chunk)
    lines = {name: _in_visiting_order(spec, chunk, array) for name, array in record.items()}
    cells = {name: _in_visiting_order(spec, chunk, array) for name, array in _cells(spec, chunk).items()}
    starts = _starts(spec, chunk, store_url)
    kernel_seconds = 0.0
    for place in np.ndindex(lines["outcome"].shape[:2]):
        for piece, done, seconds in _run_line(spec, cells, place, starts.get(place), store_url):
            kernel_seconds += seconds
            for name, array in lines.items():
                array[(*place, piece)] = getattr(done, name)
    checksum = store.write_chunk(store_url, chunk, record)
    outcomes = np.bincount(record["outcome"].ravel(), minlength=len(Outcome))
    took = time.perf_counter() - began
    return ChunkReport(chunk.index, chunk.cells, took, kernel_seconds, checksum, tuple(outcomes.tolist()))


def _run_line(
    spec: SweepSpec, cells: _Arrays, place: _Place, start: Start | None, store_url: str
) -> Iterator[tuple[slice, Line, float]]:
    """Run one line piece by piece; yields where, what, and the kernel's seconds.

    The pieces depend on the specification alone, not on the clock, so that they cannot make
    two runs differ.
    """
    gamma, omega, xi = (cells[axis][place] for axis in ("gamma", "omega", "xi"))
    step = max(1, int(CANCEL_SECONDS / cell_seconds(spec)))
    for low in range(0, len(gamma), step):
        if store.is_cancelled(store_url):
            raise ChunkCancelled(f"cancelled: {store_url}")
        piece = slice(low, low + step)
        began = time.perf_counter()
        with _naming(gamma=gamma[piece], omega=omega[piece], xi=xi[piece]):
            done = run_cells(spec, gamma[piece], omega[piece], xi[piece], start)
        yield piece, done, time.perf_counter() - began
        last = low + len(done.outcome) - 1
        start = _start(done.end_state[-1], done.outcome[-1], Cell(gamma[last], omega[last], xi[last]))


@contextmanager
def _naming(**axes: NDArray[np.float64]) -> Iterator[None]:
    """Have an error say in which cells it happened."""
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
    """Cells (n,) one after the other as a sweep computes them; on a ramp from `start`, or from rest."""
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
        start=start if carry else None,
    )


def plate_of(
    model: Contact, gamma: NDArray[np.float64], omega: NDArray[np.float64], xi: NDArray[np.float64]
) -> Any:
    """The kernel's plate under these cells, (n,) each."""
    kernel = importlib.import_module(CONTACT_MODELS[model.kind].kernel)
    return kernel.plate(**model.plate_arguments(gamma, omega, xi))


def _start(state: NDArray[np.float64], outcome: int, cell: Cell) -> Start | None:
    """The state to carry on from; a diverged cell leaves none: the next starts from rest."""
    return None if outcome == Outcome.DIVERGED else Start(np.ascontiguousarray(state), cell)


def _starts(spec: SweepSpec, chunk: Chunk, store_url: str) -> dict[_Place, Start | None]:
    """For each line of a ramp's chunk, the end of the cell before; empty where all start from rest."""
    layer = _layer_before(spec, chunk)
    if layer is None:
        return {}
    stored = store.read_chunk(store_url, layer, ("end_state", "outcome"))
    found = {
        name: _in_visiting_order(spec, layer, array) for name, array in (stored | _cells(spec, layer)).items()
    }
    if np.any(found["outcome"] == Outcome.MISSING):
        raise PredecessorMissing(
            f"chunk {chunk.index} carries on from chunk {chunk.after}, which is not stored"
        )
    return {place: _start_at(found, (*place, 0)) for place in np.ndindex(found["outcome"].shape[:2])}


def _start_at(found: _Arrays, place: tuple[int, ...]) -> Start | None:
    cell = Cell(*(float(found[name][place]) for name in Cell._fields))
    return _start(found["end_state"][place], found["outcome"][place], cell)


def _layer_before(spec: SweepSpec, chunk: Chunk) -> Chunk | None:
    """The cells, one on each line, that a ramp visits just before the chunk's first."""
    axis = spec.ramp_axis
    if axis is None or chunk.after is None:
        return None
    low, high = getattr(chunk, axis)
    direction, place = chunk.direction, low - 1
    if spec.directions[direction] == "down":
        at_the_top = high == len(spec.axis_values(axis))
        direction, place = (direction - 1, high - 1) if at_the_top else (direction, high)
    spans = {name: getattr(chunk, name) for name in AXES} | {axis: (place, place + 1)}
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
    """The three parameters of every cell, each of the chunk's shape."""
    values = [spec.axis_values(axis)[slice(*getattr(chunk, axis))] for axis in AXES]
    return dict(zip(AXES, np.meshgrid(*values, indexing="ij"), strict=True))


def _in_visiting_order(spec: SweepSpec, chunk: Chunk, array: NDArray[Any]) -> NDArray[Any]:
    """A view of a chunk's array with a line's cells, in the order visited, along its third axis.

    From rest all cells make one line; on a ramp there is a line along it for each pair of the
    other two parameters.
    """
    if spec.ramp_axis is None:
        return array.reshape(1, 1, chunk.cells, *array.shape[3:])
    along = np.moveaxis(array, AXES.index(spec.ramp_axis), 2)
    return along[:, :, ::-1] if spec.directions[chunk.direction] == "down" else along


def compile_kernels() -> None:
    """Compile every kernel a worker may be asked for."""
    one = np.ones(1)
    for kind, model in CONTACT_MODELS.items():
        contact: Any = model.fields(kind=kind)
        run_line(
            one, one, one, plate=plate_of(contact, one, one, one), carry=False, settle=0, observe=1, keep=1
        )
