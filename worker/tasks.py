"""Tasks: computes a chunk of a sweep, stores it, and returns a report. Tasks are idempotent.

A chunk that takes longer than a time slice pauses: its progress is kept in a checkpoint, from which the next
task of the same chunk continues. So no chunk, however long its cells are, keeps a worker from others for
longer than a slice.

TaskError               why a chunk was not computed
├── ChunkCancelled      the cancel flag of the store is set
├── ChunkPaused         its time slice is over; the next task continues
└── PredecessorMissing  the previous chunk of the ramp is not stored
"""

import importlib
import itertools
import logging
import math
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.interface import dimension
from kernel.line import LineRun
from kernel.params import Cell, Line, Outcome, Start
from kernel.trajectory import sample
from worker import schema, store
from worker.cost import cells_at_once
from worker.plan import Chunk
from worker.refinement import Beyond, Refinement, surroundings
from worker.spec import AXES, SweepSpec
from worker.spec.contact_models import CONTACT_MODELS, Contact
from worker.spec.protocols import Ramp
from worker.spec.refine import Refine
from worker.spec.sweep import start_of

log = logging.getLogger(__name__)

#: Core-seconds that a task computes before it pauses: the longest wait of another job's chunk for a worker
#: with its own core. Twice the target of a chunk, so that few chunks harder than estimated pause. Measured in
#: core time: on a busy machine, pauses would otherwise use up the worker's share.
SLICE_SECONDS: Final = 1.5

#: A task computes at least a second per this many bytes of its record, which a pause has to write.
KEPT_BYTES: Final = 16 * 2**20


@dataclass(frozen=True)
class ChunkOptions:
    """How a chunk is computed; changes no result."""

    slice_seconds: float = SLICE_SECONDS
    begins: bool = False  # the chunk's first task: no checkpoint to look for


_USUAL: Final = ChunkOptions()

#: For the chunk that this thread computes.
OPTIONS: Final[ContextVar[ChunkOptions]] = ContextVar("options", default=_USUAL)

#: Set in a worker process that was told to leave: its chunks pause at once, so that nothing is lost.
LEAVING: Final = threading.Event()

#: Seconds between two checks of the cancel flag, which may be in a distant bucket.
CANCEL_SECONDS: Final = 0.25

#: Contacts and flights between two looks at the clock, at first, and the seconds that they should take: the
#: number is doubled or halved accordingly. A cell takes about two for each plate period.
FIRST_STEPS: Final = 4096
MOST_STEPS: Final = 2**40
LOOK_SECONDS: Final = (0.02, 0.1)

#: Errors of writing a checkpoint, which do not fail the chunk.
_UNWRITABLE: Final[tuple[type[Exception], ...]] = (OSError, *store.UNREACHABLE)

#: Names of a checkpoint's arrays; then the prefixes of the line under way and of the record.
_DONE: Final = "lines_done"
_SECONDS: Final = "seconds"
_LINE: Final = "line/"
_RECORD: Final = "record/"


@contextmanager
def with_options(options: ChunkOptions) -> Iterator[None]:
    """Options for the tasks of this thread within the block."""
    token = OPTIONS.set(options)
    try:
        yield
    finally:
        OPTIONS.reset(token)


class TaskError(Exception):
    """Why a chunk was not computed."""


class ChunkCancelled(TaskError):
    """The cancel flag of the store is set; nothing of the chunk was written."""


class ChunkPaused(TaskError):
    """The chunk's time slice is over; the next task continues from its checkpoint."""


class PredecessorMissing(TaskError):
    """The chunk before this one on its ramp is not in the store."""


@dataclass(frozen=True, slots=True)
class ChunkReport:
    """What a task reports of its chunk."""

    index: int
    cells: int
    seconds: float  # wall time, storing included
    kernel_seconds: float  # the part spent in the kernel
    checksum: str  # of the stored bytes; see store.find_corrupt
    outcomes: tuple[int, ...]  # number of cells by kernel.params.Outcome
    computed: int | None = None  # adaptive maps: cells not filled in from their block
    bytes: int | None = None  # stored, of all arrays; None if unknown


def report_of(
    chunk: Chunk, record: Mapping[str, NDArray[Any]], stored: store.Stored,
    seconds: tuple[float, float], computed: int | None = None,
) -> ChunkReport:  # fmt: skip
    """The report of a stored chunk. `seconds`: in all, and in the kernel."""
    outcomes = np.bincount(record["outcome"].ravel(), minlength=len(Outcome))
    return ChunkReport(
        chunk.index, chunk.cells, *seconds, stored.checksum, tuple(outcomes.tolist()), computed, stored.bytes
    )


#: Position of a line among the lines of its chunk.
_LineIndex = tuple[int, int]
_Arrays = dict[str, NDArray[Any]]


def run_chunk(spec: SweepSpec, chunk: Chunk, store_url: str, slice_seconds: float = math.inf) -> ChunkReport:
    """Compute every cell of `chunk` and store it; the store must exist.

    Continues from the chunk's checkpoint, if there is one. Raises `ChunkCancelled`, `ChunkPaused` after
    `slice_seconds` core-seconds, `PredecessorMissing`, or a `store.StoreError`. In each case the
    chunk's cells stay missing and the chunk can be run again.
    """
    began = time.perf_counter()
    # Fail before computing, which can take minutes.
    store.check_chunk(store_url, chunk, schema.arrays(spec))
    record = schema.empty_record(_surrounded(spec, chunk).shape, schema.arrays(spec), schema.sizes(spec))
    slice_seconds = max(slice_seconds, sum(array.nbytes for array in record.values()) / KEPT_BYTES)
    work = _SweepWork(store_url, chunk.index, record, began, slice_seconds)
    if spec.refine is None:
        _compute_lines(spec, chunk, record, work, _starts(spec, chunk, store_url))
    else:
        record = _refine_tile(spec, spec.refine, chunk, record, work)
    computed = None if spec.refine is None else int(record[schema.COMPUTED.name].sum())
    return work.write(chunk, record, computed)


def _compute_lines(
    spec: SweepSpec,
    chunk: Chunk,
    record: _Arrays,
    work: "_SweepWork",
    starts: Mapping[_LineIndex, Start | None],
) -> None:
    """Compute every cell of a chunk, line by line or many lines side by side."""
    lines = {name: _in_visiting_order(spec, chunk, array) for name, array in record.items()}
    cells = {name: _in_visiting_order(spec, chunk, array) for name, array in _cells(spec, chunk).items()}
    groups = _groups(spec, list(np.ndindex(lines["outcome"].shape[:2])))
    for group in groups[work.lines_done :]:
        gamma, omega, xi = (
            np.concatenate([cells[axis][index] for index in group]) for axis in ("gamma", "omega", "xi")
        )
        with _noting_cells(gamma=gamma, omega=omega, xi=xi):
            done = work.compute(_line_run(spec, gamma, omega, xi, [starts.get(index) for index in group]))
        for name, array in lines.items():
            for index, part in zip(group, np.split(getattr(done, name), len(group)), strict=True):
                array[index] = part
        work.finish_line(last=group is groups[-1])


def _groups(spec: SweepSpec, indices: list[_LineIndex]) -> list[list[_LineIndex]]:
    """The lines of a chunk in groups computed side by side; a group is a line of the checkpoint."""
    return [indices] if cells_at_once(spec) > 1 else [[index] for index in indices]


def _refine_tile(
    spec: SweepSpec, refine: Refine, chunk: Chunk, record: _Arrays, work: "_SweepWork"
) -> _Arrays:
    """Compute the cells that a tile needs, each round of the refinement as one line, and fill in the others.

    record: of the tile and its surroundings; returns the tile's alone. Rounds that an earlier task computed
    are in the record; the refinement repeats them from there.
    """
    around = _surrounded(spec, chunk)
    flat = {name: array.reshape(around.cells, *array.shape[3:]) for name, array in record.items()}
    cells = {name: array.ravel() for name, array in _cells(spec, around).items()}
    computed = flat[schema.COMPUTED.name]
    tile = Refinement((chunk.shape[1], chunk.shape[2]), refine, _beyond(spec, chunk))
    finished = work.lines_done
    for number in itertools.count():
        if not tile.cells.size:
            break
        if number >= finished:
            gamma, omega, xi = (cells[axis][tile.cells] for axis in ("gamma", "omega", "xi"))
            with _noting_cells(gamma=gamma, omega=omega, xi=xi):
                done = work.compute(_line_run(spec, gamma, omega, xi, []))
            for name, array in flat.items():
                array[tile.cells] = 1 if array is computed else getattr(done, name)
            work.finish_line()
        tile.split(*(record[name][0] for name in schema.MODE_ARRAYS))
    result = {name: array[:, *tile.inside] for name, array in record.items()}
    source = tile.sources()
    for name in schema.MODE_ARRAYS:
        result[name] = result[name].ravel()[source].reshape(chunk.shape)
    return result


def _beyond(spec: SweepSpec, chunk: Chunk) -> Beyond:
    """The map's cells around a tile: rows above and below, columns left and right."""
    _, (top, bottom), (left, right) = chunk.spans
    return top, spec.shape[2] - bottom, left, spec.shape[3] - right


def _surrounded(spec: SweepSpec, chunk: Chunk) -> Chunk:
    """A chunk of an adaptive map with its surroundings; any other chunk unchanged."""
    if spec.refine is None:
        return chunk
    xi, (top, bottom), (first, last) = chunk.spans
    above, below, left, right = surroundings(spec.refine, _beyond(spec, chunk))
    return replace(chunk, spans=(xi, (top - above, bottom + below), (first - left, last + right)))


class Work:
    """Computes a chunk's lines and looks at the clock and the cancel flag between parts of a line.

    The parts do not affect the results. A kind of study returns its finished arrays from `_save` and takes
    them back in `_restore`.
    """

    def __init__(self, store_url: str, chunk: int, began: float, slice_seconds: float) -> None:
        self._url, self._chunk = store_url, chunk
        self._began, self._slice_seconds = began, slice_seconds
        self._slice_began = time.thread_time()
        self._next_check = -math.inf  # next check of the cancel flag
        self._steps, self._kernel_seconds = FIRST_STEPS, 0.0
        self._before = np.zeros(2)  # `seconds` of earlier slices
        self._under_way: _Arrays = {}  # the line at which the chunk paused
        saved = None if OPTIONS.get().begins else store.read_checkpoint(store_url, chunk)
        self._has_checkpoint = saved is not None
        if saved is not None:
            with self._discarding_checkpoint():
                self._before = saved[_SECONDS].reshape(2)
                self._restore(saved)
            self._under_way = {
                name.removeprefix(_LINE): saved[name] for name in saved if name.startswith(_LINE)
            }

    def _save(self) -> _Arrays:
        """The finished arrays of the chunk; their names do not begin with `line/`."""
        raise NotImplementedError

    def _restore(self, saved: _Arrays) -> None:
        """Take back the arrays of `_save`. Raises KeyError or ValueError for any others."""
        raise NotImplementedError

    @property
    def seconds(self) -> tuple[float, float]:
        """Seconds since the chunk began, without pauses, and the part in the kernel."""
        return time.perf_counter() - self._began + self._before[0], self._kernel_seconds + self._before[1]

    def compute(self, run: LineRun) -> Line:
        """Compute a line to its end. Raises ChunkCancelled, ChunkPaused."""
        if self._under_way:
            with self._discarding_checkpoint():
                run.restore(self._under_way)
            self._under_way = {}
        while not self._advance(run):
            self.pause_if_due(run.save())
        return run.line

    def write(self, chunk: Chunk, record: _Arrays, computed: int | None = None) -> ChunkReport:
        """Store the chunk's arrays and remove its checkpoint."""
        stored = store.write_chunk(self._url, chunk, record)
        self.remove_checkpoint()
        return report_of(chunk, record, stored, self.seconds, computed)

    def remove_checkpoint(self) -> None:
        """Remove the chunk's checkpoint, once its results are stored."""
        if self._has_checkpoint:
            store.remove_checkpoint(self._url, self._chunk)

    def _advance(self, run: LineRun) -> bool:
        """Compute a part of a line; whether the line is done."""
        if time.perf_counter() > self._next_check:
            if store.is_cancelled(self._url):
                raise ChunkCancelled(f"cancelled: {self._url}")
            self._next_check = time.perf_counter() + CANCEL_SECONDS
        before = time.perf_counter()
        done = run.advance(self._steps)
        took = time.perf_counter() - before
        self._kernel_seconds += took
        low, high = LOOK_SECONDS
        steps = self._steps * (2 if took < low else 1) // (2 if took > high else 1)
        self._steps = min(max(steps, 1), MOST_STEPS)
        return done

    def pause_if_due(self, under_way: _Arrays) -> None:
        """Write a checkpoint and raise ChunkPaused if the slice is over, or the worker is leaving.

        `under_way`: the arrays of a line, or empty.
        Where a checkpoint cannot be written, e.g. on a full disk, the chunk continues.
        """
        if not LEAVING.is_set() and time.thread_time() - self._slice_began <= self._slice_seconds:
            return
        arrays = {_SECONDS: np.array(self.seconds)} | self._save()
        arrays |= {_LINE + name: array for name, array in under_way.items()}
        try:
            store.write_checkpoint(self._url, self._chunk, arrays)
        except _UNWRITABLE as error:
            log.warning("chunk %d cannot pause, its checkpoint cannot be written: %s", self._chunk, error)
            self._slice_seconds = math.inf
            return
        raise ChunkPaused(f"paused after {self._slice_seconds:g} s: {self._url}")

    @contextmanager
    def _discarding_checkpoint(self) -> Iterator[None]:
        """Restart the chunk if its checkpoint is from another release, with other arrays."""
        try:
            yield
        except (KeyError, ValueError) as error:
            self.remove_checkpoint()
            raise ChunkPaused(f"begins anew, its checkpoint is not of this release: {error}") from error


class _SweepWork(Work):
    """The work of a sweep's chunk. `record`: the chunk's arrays, with the lines that are done."""

    def __init__(
        self, store_url: str, chunk: int, record: _Arrays, began: float, slice_seconds: float
    ) -> None:
        self._record, self.lines_done = record, 0
        super().__init__(store_url, chunk, began, slice_seconds)

    def finish_line(self, *, last: bool = False) -> None:
        """Note that the line is in the record. Raises ChunkPaused, unless it was the last."""
        self.lines_done += 1
        if not last:
            self.pause_if_due({})

    def _save(self) -> _Arrays:
        arrays: _Arrays = {_DONE: np.array(self.lines_done)}
        if self.lines_done:
            arrays |= {_RECORD + name: array for name, array in self._record.items()}
        return arrays

    def _restore(self, saved: _Arrays) -> None:
        self.lines_done = int(saved[_DONE])
        if self.lines_done:
            for name, array in self._record.items():
                array[...] = saved[_RECORD + name]


@contextmanager
def _noting_cells(**axes: NDArray[np.float64]) -> Iterator[None]:
    """Add the cells to any error as a note."""
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
    run = _line_run(spec, gamma, omega, xi, [start])
    run.advance()
    return run.line


def _line_run(
    spec: SweepSpec,
    gamma: NDArray[np.float64],
    omega: NDArray[np.float64],
    xi: NDArray[np.float64],
    starts: list[Start | None],
) -> LineRun:
    """Lines of cells as a sweep computes them, at their beginning; of ramps, one for each start."""
    carry = spec.ramp_axis is not None
    return LineRun(
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
        settle_early=spec.ends_early,
        exponents=spec.exponents,
        start=starts if carry else None,
    )


def plate_of(
    model: Contact, gamma: NDArray[np.float64], omega: NDArray[np.float64], xi: NDArray[np.float64]
) -> Any:
    """The kernel's plate for cells of these parameters, (n,) each."""
    kernel = importlib.import_module(CONTACT_MODELS[model.kind].kernel)
    return kernel.plate(**model.plate_arguments(gamma, omega, xi))


def _start(state: NDArray[np.float64], outcome: int, cell: Cell) -> Start | None:
    """The start of the next cell on a ramp; None after a diverged cell, to start from rest."""
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
    """The start of each line in the first chunk of a ramp, on a cycle if the specification says so."""
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
    spans = dict(zip(AXES, chunk.spans, strict=True))
    low, high = spans[axis]
    direction, position = chunk.direction or 0, low - 1
    if spec.directions[direction] == "down":
        is_last = high == len(spec.axis_values(axis))
        # A "down" ramp starts from the end of "up", whose last cell has the same parameters.
        direction, position = (direction - 1, high - 1) if is_last else (direction, high)
    spans[axis] = position, position + 1
    return Chunk(chunk.index, tuple(spans.values()), direction)


def _cells(spec: SweepSpec, chunk: Chunk) -> _Arrays:
    """The parameters of every cell, each array of shape chunk.shape."""
    values = [spec.axis_values(axis)[slice(*span)] for axis, span in zip(AXES, chunk.spans, strict=True)]
    return dict(zip(AXES, np.meshgrid(*values, indexing="ij"), strict=True))


def _in_visiting_order(spec: SweepSpec, chunk: Chunk, array: NDArray[Any]) -> NDArray[Any]:
    """A view of a chunk's array with the cells of a line, in the order of the ramp, along its third axis.

    From rest all cells form one line; on a ramp there is one line for each pair of the other two parameters.
    """
    if spec.ramp_axis is None:
        return array.reshape(1, 1, chunk.cells, *array.shape[3:])
    along = np.moveaxis(array, AXES.index(spec.ramp_axis), 2)
    return along[:, :, ::-1] if spec.directions[chunk.direction or 0] == "down" else along


def compile_kernels() -> None:
    """Compile or load the kernels of all jobs and answers: models, exponents, trajectories."""
    axis = np.ones(1)
    for kind, model in CONTACT_MODELS.items():
        contact: Any = model.fields(kind=kind)
        plate = plate_of(contact, axis, axis, axis)
        for exponents in {0, dimension(plate)}:
            LineRun(
                axis, axis, axis, plate=plate, carry=False, settle=0, observe=1, keep=1, exponents=exponents
            ).advance()
        sample(Cell(1.0, 1.0, 1.0), plate, None, periods=1, samples=1)


def compile_for(spec: SweepSpec) -> None:
    """Compile or load the kernels of the sweep.

    Once compiled, this takes a fraction of a millisecond: one plate period of the first cell.
    """
    gamma, omega, xi = (spec.axis_values(axis)[:1] for axis in ("gamma", "omega", "xi"))
    LineRun(
        gamma, omega, xi, plate=plate_of(spec.model, gamma, omega, xi),
        carry=spec.ramp_axis is not None, settle=0, observe=1, keep=1, exponents=spec.exponents,
    ).advance()  # fmt: skip
