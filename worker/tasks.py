"""Tasks: computes a chunk of a sweep, stores it, and returns a report. Tasks are idempotent.

A chunk that takes longer than a time slice pauses: its progress is kept in a checkpoint, from which the next
task of the same chunk continues. So no chunk, however long its cells are, keeps a worker from others for
longer than a slice.
"""

import importlib
import itertools
import logging
import math
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.interface import dimension
from kernel.line import LineRun
from kernel.params import Cell, Line, Outcome, Start
from kernel.stopping import check
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

    slice_seconds: float = math.inf  # core-seconds after which it pauses
    begins: bool = False  # the chunk's first task: no checkpoint to look for


USUAL: Final = ChunkOptions()

#: For the chunk that this thread computes.
OPTIONS: Final[ContextVar[ChunkOptions]] = ContextVar("options", default=USUAL)

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
_DONE: Final = "done"
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

    seconds = 0.0  # that the slice took


class PredecessorMissing(TaskError):
    """The chunk before this one on its ramp is not in the store."""


@dataclass(frozen=True, slots=True)
class ChunkReport:
    """What a task reports of its chunk."""

    index: int
    cells: int
    seconds: float  # wall time, storing included
    kernel_seconds: float  # the part spent in the kernel
    outcomes: tuple[int, ...]  # number of cells by kernel.params.Outcome
    computed: int | None = None  # adaptive maps: cells not filled in from their block
    paused_seconds: float = 0.0  # the part of `seconds` in earlier slices


#: Position of a line among the lines of its chunk.
_LineIndex = tuple[int, int]
_Arrays = dict[str, NDArray[Any]]


def report_of(
    chunk: Any, record: Mapping[str, NDArray[Any]], seconds: tuple[float, float], computed: int | None = None
) -> ChunkReport:  # fmt: skip
    """The report of a stored chunk. `seconds`: in all, and in the kernel."""
    outcomes = tuple(np.bincount(record["outcome"].ravel(), minlength=len(Outcome)).tolist())
    return ChunkReport(chunk.index, chunk.cells, *seconds, outcomes, computed)


def run_chunk(spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute every cell of `chunk` and store it; the store must exist.

    Continues from the chunk's checkpoint, if there is one. Raises `ChunkCancelled`, `ChunkPaused` after
    the slice of `OPTIONS`, `PredecessorMissing`, or a `store.StoreError`. In each case the chunk's cells stay
    missing and the chunk can be run again.
    """
    arrays = schema.arrays(spec)
    record = schema.empty_record(_surrounded(spec, chunk).shape, arrays, schema.sizes(spec))
    work = Work(store_url, chunk, arrays, record)
    if spec.refine is None:
        _compute_lines(spec, chunk, work, _starts(spec, chunk, store_url))
        return work.write(record)
    record = _refine_tile(spec, spec.refine, chunk, work)
    return work.write(record, int(record[schema.COMPUTED.name].sum()))


def _compute_lines(
    spec: SweepSpec, chunk: Chunk, work: "Work", starts: Mapping[_LineIndex, Start | None]
) -> None:
    """Compute every cell of a chunk, line by line or all lines side by side."""
    lines, cells = (_in_visiting_order(spec, chunk, arrays) for arrays in (work.record, _cells(spec, chunk)))
    indices = list(np.ndindex(lines["outcome"].shape[:2]))
    groups = [indices] if cells_at_once(spec) > 1 else [[index] for index in indices]
    for group in groups[work.done :]:
        line_cells = {axis: np.concatenate([cells[axis][index] for index in group]) for axis in AXES}
        done = _compute(spec, work, line_cells, [starts.get(index) for index in group])
        for name, array in lines.items():
            for index, part in zip(group, np.split(getattr(done, name), len(group)), strict=True):
                array[index] = part
        work.finish(last=group is groups[-1])


def _refine_tile(spec: SweepSpec, refine: Refine, chunk: Chunk, work: "Work") -> _Arrays:
    """Compute the cells that a tile needs, each round of the refinement as one line, and fill in the others.

    The work's record is of the tile and its surroundings; returns the tile's alone. Rounds that an earlier
    task computed are in the record; the refinement repeats them from there.
    """
    around, record = _surrounded(spec, chunk), work.record
    flat = {name: array.reshape(around.cells, *array.shape[3:]) for name, array in record.items()}
    cells = {name: array.ravel() for name, array in _cells(spec, around).items()}
    computed = flat[schema.COMPUTED.name]
    tile = Refinement((chunk.shape[1], chunk.shape[2]), refine, _beyond(spec, chunk))
    finished = work.done
    for number in itertools.count():
        if not tile.cells.size:
            break
        if number >= finished:
            done = _compute(spec, work, {axis: cells[axis][tile.cells] for axis in AXES}, [])
            for name, array in flat.items():
                array[tile.cells] = 1 if array is computed else getattr(done, name)
            work.finish()
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


def _compute(spec: SweepSpec, work: "Work", cells: _Arrays, starts: list[Start | None]) -> Line:
    """Compute a line to its end; any error notes its cells."""
    try:
        return work.compute(_line_run(spec, cells["gamma"], cells["omega"], cells["xi"], starts))
    except Exception as error:
        spans = [f"{name} {cells[name][0]:g} to {cells[name][-1]:g}" for name in ("gamma", "omega", "xi")]
        error.add_note(f"in the cells {', '.join(spans)}")
        raise


class Work:
    """Computes a chunk's lines and looks at the clock and the cancel flag between parts of a line.

    The parts do not affect the results. `record`: the chunk's arrays, with its `done` first lines. Raises the
    StoreError of storing it now: computing can take minutes.
    """

    def __init__(self, store_url: str, chunk: Chunk, arrays: Iterable[schema.Array], record: _Arrays) -> None:
        self._began, self._slice_began = time.perf_counter(), time.thread_time()
        store.check_chunk(store_url, chunk, arrays)
        self._url, self._chunk, self.record = store_url, chunk, record
        kept_seconds = sum(array.nbytes for array in record.values()) / KEPT_BYTES
        self._slice_seconds = max(OPTIONS.get().slice_seconds, kept_seconds)
        self._next_check = -math.inf  # next check of the cancel flag
        self._steps, self.kernel_seconds = FIRST_STEPS, 0.0
        self.done = 0
        self._before = np.zeros(2)  # `seconds` of earlier slices
        self._under_way: _Arrays = {}  # the line at which the chunk paused
        saved = None if OPTIONS.get().begins else store.read_checkpoint(store_url, chunk.index)
        self._has_checkpoint = saved is not None
        if saved is not None:
            with self._discarding_checkpoint():
                self._restore(saved)

    def _save(self) -> _Arrays:
        """The arrays of a checkpoint, but for the line under way."""
        record = self.record if self.done else {}
        return {
            _SECONDS: np.array(self.seconds),
            _DONE: np.array(self.done),
            **{_RECORD + name: array for name, array in record.items()},
        }

    def _restore(self, saved: _Arrays) -> None:
        """Take back the arrays of a checkpoint. Raises KeyError or ValueError for any others."""
        self._before, self.done = saved[_SECONDS].reshape(2), int(saved[_DONE])
        for name, array in self.record.items() if self.done else ():
            array[...] = saved[_RECORD + name]
        self._under_way = {name.removeprefix(_LINE): saved[name] for name in saved if name.startswith(_LINE)}

    def finish(self, *, last: bool = False) -> None:
        """Note that a line is in the record. Raises ChunkPaused, unless it was the last."""
        self.done += 1
        if not last:
            self.pause_if_due({})

    @property
    def seconds(self) -> tuple[float, float]:
        """Seconds since the chunk began, without pauses, and the part in the kernel."""
        return time.perf_counter() - self._began + self._before[0], self.kernel_seconds + self._before[1]

    def compute(self, run: LineRun) -> Line:
        """Compute a line to its end. Raises ChunkCancelled, ChunkPaused."""
        if self._under_way:
            with self._discarding_checkpoint():
                run.restore(self._under_way)
            self._under_way = {}
        while not self._advance(run):
            self.pause_if_due(run.save())
        return run.line

    def write(self, record: _Arrays, computed: int | None = None) -> ChunkReport:
        """Store the chunk's arrays and remove its checkpoint."""
        chunk = self._chunk
        store.write_chunk(self._url, chunk, record)
        if self._has_checkpoint:
            store.remove_checkpoint(self._url, chunk.index)
        report = report_of(chunk, record, self.seconds, computed)
        return replace(report, paused_seconds=float(self._before[0]))

    def check_cancelled(self) -> None:
        """Raise ChunkCancelled if the cancel flag is set; looks every CANCEL_SECONDS."""
        if time.perf_counter() > self._next_check:
            if store.is_cancelled(self._url):
                raise ChunkCancelled(f"cancelled: {self._url}")
            self._next_check = time.perf_counter() + CANCEL_SECONDS

    def _advance(self, run: LineRun) -> bool:
        """Compute a part of a line; whether the line is done."""
        self.check_cancelled()
        before = time.perf_counter()
        done = run.advance(self._steps)
        took = time.perf_counter() - before
        self.kernel_seconds += took
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
        arrays = self._save() | {_LINE + name: array for name, array in under_way.items()}
        try:
            store.write_checkpoint(self._url, self._chunk.index, arrays)
        except _UNWRITABLE as error:
            index = self._chunk.index
            log.warning("chunk %d cannot pause, its checkpoint cannot be written: %s", index, error)
            self._slice_seconds = math.inf
            return
        paused = ChunkPaused(f"paused after {self._slice_seconds:g} s: {self._url}")
        paused.seconds = self.seconds[0] - float(self._before[0])
        raise paused

    @contextmanager
    def _discarding_checkpoint(self) -> Iterator[None]:
        """Restart the chunk if its checkpoint is from another release, with other arrays."""
        try:
            yield
        except (KeyError, ValueError) as error:
            store.remove_checkpoint(self._url, self._chunk.index)
            raise ChunkPaused(f"begins anew, its checkpoint is not of this release: {error}") from error


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
    while not run.advance(FIRST_STEPS):
        check()
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


def _starts(spec: SweepSpec, chunk: Chunk, store_url: str) -> dict[_LineIndex, Start | None]:
    """The start of each line of a ramp's chunk; empty if all lines start from rest."""
    layer = _layer_before(spec, chunk)
    if layer is None:
        return _starts_on_cycles(spec, chunk)
    stored = store.read_chunk(store_url, layer, ("end_state", "outcome"))
    previous = _in_visiting_order(spec, layer, stored | _cells(spec, layer))
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
    cells = _in_visiting_order(spec, chunk, _cells(spec, chunk))
    indices = np.ndindex(cells["gamma"].shape[:2])
    return {index: start_of(_cell(cells, (*index, 0)), on.periods) for index in indices}


def _start_at(arrays: _Arrays, index: tuple[int, ...]) -> Start | None:
    """The start of the next cell on a ramp; None after a diverged cell, to start from rest."""
    if arrays["outcome"][index] == Outcome.DIVERGED:
        return None
    return Start(np.ascontiguousarray(arrays["end_state"][index]), _cell(arrays, index))


def _cell(arrays: _Arrays, index: tuple[int, ...]) -> Cell:
    return Cell(*(float(arrays[name][index]) for name in Cell._fields))


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


def _in_visiting_order(spec: SweepSpec, chunk: Chunk, arrays: _Arrays) -> _Arrays:
    """Views of a chunk's arrays with the cells of a line, in the order of the ramp, along their third axis.

    From rest all cells form one line; on a ramp there is one line for each pair of the other two parameters.
    """
    if spec.ramp_axis is None:
        return {name: array.reshape(1, 1, chunk.cells, *array.shape[3:]) for name, array in arrays.items()}
    axis, step = AXES.index(spec.ramp_axis), -1 if spec.directions[chunk.direction or 0] == "down" else 1
    return {name: np.moveaxis(array, axis, 2)[:, :, ::step] for name, array in arrays.items()}


def compile_kernels() -> None:
    """Compile or load the kernels of all jobs and answers: models, exponents, trajectories."""
    axis = np.ones(1)
    for kind, model in CONTACT_MODELS.items():
        contact: Any = model.fields(kind=kind)
        plate = plate_of(contact, axis, axis, axis)
        for exponents in {0, dimension(plate)}:
            _run_briefly(axis, axis, axis, plate=plate, carry=False, exponents=exponents)
        sample(Cell(1.0, 1.0, 1.0), plate, None, periods=1, samples=1)


def compile_for(spec: Any) -> None:
    """Compile or load the kernels of a study, if it has a contact model.

    Once compiled, this takes a fraction of a millisecond: one plate period of the first cell.
    """
    if hasattr(spec, "model"):
        cell = [spec.axis_values(axis)[:1] for axis in ("gamma", "omega", "xi")]
        carry = getattr(spec, "ramp_axis", None) is not None
        plate = plate_of(spec.model, *cell)
        _run_briefly(*cell, plate=plate, carry=carry, exponents=getattr(spec, "exponents", 0))


def _run_briefly(*cell: NDArray[np.float64], **options: Any) -> None:
    LineRun(*cell, settle=0, observe=1, keep=1, **options).advance()
