"""Code that the tasks of all studies share: time slices, checkpoints, kernels.

A chunk that takes longer than a time slice pauses: it writes its progress to a checkpoint, from which the
next task of the same chunk continues. So no chunk occupies a worker for longer than a slice.
"""

import importlib
import logging
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.interface import dimension
from kernel.line import LineRun
from kernel.params import Cell, Line
from kernel.trajectory import sample
from worker import store
from worker.spec.contact_models import CONTACT_MODELS, Contact
from worker.study.chunks import LEAVING, OPTIONS, Chunk, ChunkCancelled, ChunkPaused, ChunkReport, report_of
from worker.study.layout import Array, empty_record

log = logging.getLogger(__name__)

#: A task computes at least a second per this many bytes of its record, which a pause has to write.
KEPT_BYTES: Final = 16 * 2**20

#: Seconds between two checks of the cancel flag, which may be in a distant bucket.
CANCEL_SECONDS: Final = 0.25

#: Contacts and flights between two looks at the clock: the first number, and the largest. It is doubled or
#: halved until they take LOOK_SECONDS. A cell has about two for each plate period.
FIRST_STEPS: Final = 4096
MOST_STEPS: Final = 2**40
LOOK_SECONDS: Final = (0.02, 0.1)

#: Names of a checkpoint's arrays; then the prefixes of the line under way and of the record.
_DONE: Final = "done"
_SECONDS: Final = "seconds"
_LINE: Final = "line/"
_RECORD: Final = "record/"

_Arrays = dict[str, NDArray[Any]]


class Work:
    """Computes a chunk's lines and looks at the clock and the cancel flag between parts of a line.

    The parts do not affect the results. `record`: the chunk's arrays, of which the first `done` lines are
    computed. `sizes`: lengths of their own dimensions. `beside`: further arrays that checkpoints keep. Raises
    StoreError if the chunk could not be stored, before it is computed for minutes.
    """

    def __init__(
        self, store_url: str, chunk: Chunk, arrays: Sequence[Array], sizes: Mapping[str, int],
        beside: _Arrays | None = None,
    ) -> None:  # fmt: skip
        self._began, self._slice_began = time.perf_counter(), time.thread_time()
        store.check_chunk(store_url, chunk, arrays)
        self._url, self._chunk = store_url, chunk
        self.record = empty_record(chunk.shape, arrays, sizes)
        self._kept = self.record | (beside or {})
        kept_seconds = sum(array.nbytes for array in self._kept.values()) / KEPT_BYTES
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
        """The arrays of a checkpoint, without those of the line under way."""
        kept = self._kept if self.done else {}
        return {
            _SECONDS: np.array(self.seconds),
            _DONE: np.array(self.done),
            **{_RECORD + name: array for name, array in kept.items()},
        }

    def _restore(self, saved: _Arrays) -> None:
        """Continue from the arrays of a checkpoint. Raises KeyError or ValueError for other arrays."""
        self._before, self.done = saved[_SECONDS].reshape(2), int(saved[_DONE])
        for name, array in self._kept.items() if self.done else ():
            array[...] = saved[_RECORD + name]
        self._under_way = {name.removeprefix(_LINE): saved[name] for name in saved if name.startswith(_LINE)}

    def finish(self, *, last: bool = False) -> None:
        """Note that a line is in the record. May raise ChunkPaused, except after the last line."""
        self.done += 1
        if not last:
            self.pause_if_due({})

    @property
    def seconds(self) -> tuple[float, float]:
        """Seconds since the chunk began, and those in the kernel; both without pauses."""
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

    def write(self) -> ChunkReport:
        """Store the chunk's arrays and remove its checkpoint."""
        chunk = self._chunk
        store.write_chunk(self._url, chunk, self.record)
        if self._has_checkpoint:
            store.remove_checkpoint(self._url, chunk.index)
        report = report_of(chunk, self.record, self.seconds)
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

        `under_way`: the arrays of the line under way, if any. The chunk continues if its checkpoint cannot be
        written, e.g. on a full disk.
        """
        if not LEAVING.is_set() and time.thread_time() - self._slice_began <= self._slice_seconds:
            return
        arrays = self._save() | {_LINE + name: array for name, array in under_way.items()}
        try:
            store.write_checkpoint(self._url, self._chunk.index, arrays)
        except (OSError, store.Unreachable) as error:
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


def plate_of(model: Contact, *cells: NDArray[np.float64]) -> Any:
    """The kernel's plate for cells of these gamma, omega and xi, (n,) each."""
    kernel = importlib.import_module(CONTACT_MODELS[model.kind].kernel)
    return kernel.plate(**model.plate_arguments(*cells))


def plate_at(model: Contact, gamma: float, omega: float, xi: float) -> Any:
    """The kernel's plate for one cell."""
    return plate_of(model, *(np.full(1, value) for value in (gamma, omega, xi)))


def compile_kernels() -> None:
    """Compile or load the kernels of all jobs and answers: models, exponents, trajectories, cycles."""
    from kernel.cycles.contact_thresholds import thresholds_of  # noqa: PLC0415 - jobs do without cycles

    axis = np.ones(1)
    for kind, model in CONTACT_MODELS.items():
        contact: Any = model.fields(kind=kind)
        plate = plate_of(contact, axis, axis, axis)
        for exponents in {0, dimension(plate)}:
            _brief_run(axis, axis, axis, plate=plate, carry=False, exponents=exponents).advance()
        sample(Cell(1.0, 1.0, 1.0), plate, None, periods=1, samples=1)
        if kind in ("rigid", "soft"):
            thresholds_of(plate, 0.6, 0.05)


def compile_for(spec: Any) -> None:
    """Compile or load the kernels of a study, if it has a contact model.

    Computes one plate period of the first cell, which takes a fraction of a millisecond with compiled
    kernels.
    """
    if hasattr(spec, "model"):
        _first_cell(spec).advance()


def is_compiled(spec: Any) -> bool:
    """Whether `compile_for` compiles nothing."""
    return not hasattr(spec, "model") or _first_cell(spec).is_compiled()


def _first_cell(spec: Any) -> LineRun:
    cell = [spec.axis_values(axis)[:1] for axis in ("gamma", "omega", "xi")]
    carry = getattr(spec, "ramp_axis", None) is not None
    return _brief_run(
        *cell, plate=plate_of(spec.model, *cell), carry=carry, exponents=getattr(spec, "exponents", 0)
    )


def _brief_run(*cell: NDArray[np.float64], **options: Any) -> LineRun:
    return LineRun(*cell, settle=0, observe=1, keep=1, **options)
