"""The chunks of a study: its division and cost, how a task computes a chunk, and what it reports.

A plan is pure. Chunks form a regular grid. Their numbers are an order in which they can run, with the last
axis fastest. On a ramp the first chunks of all lines precede the second chunks, and "down" follows "up", so
that consecutive numbers rarely depend on each other.
"""

import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal, overload

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from kernel.params import Outcome
from worker.spec.axes import Strict
from worker.spec.errors import Problem, SpecTooLarge
from worker.study.layout import COMPUTED

#: Core-seconds of a chunk: long enough to hide a task's overhead; short enough for progress, for a small loss
#: on failure, and for small jobs to start soon between the chunks of large ones.
TARGET_SECONDS: Final = 0.75
#: Core-seconds of a chunk in a study that would otherwise have very many chunks.
LONGEST_SECONDS: Final = 30.0
#: Bytes of a chunk before compression.
MAX_CHUNK_BYTES: Final = 16 * 2**20
#: Core-seconds that a task computes before it pauses: the longest wait of another job's chunk for a worker
#: with its own core. Twice the target of a chunk, so that few chunks pause that are harder than estimated.
#: Core time, because on a busy machine pauses would otherwise use up the worker's share.
SLICE_SECONDS: Final = 1.5
#: Default limits on one study.
DEFAULT_MAX_CELLS: Final = 20_000_000
DEFAULT_MAX_BYTES: Final = 32 * 2**30
#: Six days of two cores. The largest sweep allowed, at the default window, takes a hundredth of it.
DEFAULT_MAX_CORE_SECONDS: Final = 1e6

Span = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Chunk:
    """A block of cells: half-open index spans along the axes, slowest first."""

    index: int
    spans: tuple[Span, ...]
    direction: int | None = None  # of a sweep: index into the specification's directions
    after: int | None = None  # the chunk that must be done first, a lower number

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along the axes."""
        return tuple(high - low for low, high in self.spans)

    @property
    def cells(self) -> int:
        return math.prod(self.shape)

    @property
    def slices(self) -> tuple[slice, ...]:
        """The chunk's cells along the cell dimensions of a stored array."""
        direction = () if self.direction is None else ((self.direction, self.direction + 1),)
        return tuple(slice(*span) for span in (*direction, *self.spans))


@dataclass(frozen=True)
class Plan(Sequence[Chunk]):
    """The chunks of a study, computed when indexed: there may be a million.

    Raises ValueError for sizes below 1.
    """

    grid: tuple[int, ...]  # cells along the axes, slowest first
    chunk_shape: tuple[int, ...]  # cells of a chunk; the ledger keeps it to repeat the plan
    directions: tuple[str, ...] = ()  # of a sweep
    ramp: int | None = None  # index of the axis along which each chunk continues the one before

    def __post_init__(self) -> None:
        if len(self.chunk_shape) != len(self.grid) or min(self.chunk_shape) < 1:
            rule = f"chunk_shape: must be {len(self.grid)} sizes of at least 1"
            raise ValueError(f"{rule}, not {self.chunk_shape}")
        fitting = tuple(min(size, n) for size, n in zip(self.chunk_shape, self.grid, strict=True))
        object.__setattr__(self, "chunk_shape", fitting)

    @property
    def cells(self) -> int:
        return max(len(self.directions), 1) * math.prod(self.grid)

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Chunks along the axes."""
        return tuple(-(-n // size) for n, size in zip(self.grid, self.chunk_shape, strict=True))

    @cached_property
    def lines(self) -> int:
        """Chunks without a predecessor; each other chunk i depends on chunk i - lines."""
        return math.prod(self._counts_beside_ramp)

    def __len__(self) -> int:
        return max(len(self.directions), 1) * math.prod(self.counts)

    @overload
    def __getitem__(self, index: int) -> Chunk: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Chunk]: ...
    def __getitem__(self, index: int | slice) -> Chunk | Sequence[Chunk]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        index = range(len(self))[index]
        wave, line = divmod(index, self.lines)
        coords = [int(coord) for coord in np.unravel_index(line, self._counts_beside_ramp)]
        direction = 0 if self.directions else None
        if self.ramp is not None:
            direction, visit = divmod(wave, self.counts[self.ramp])
            coords[self.ramp] = self._in_visiting_order(direction, visit)
        spans = (
            (coord * size, min((coord + 1) * size, n))
            for coord, size, n in zip(coords, self.chunk_shape, self.grid, strict=True)
        )
        return Chunk(index, tuple(spans), direction, index - self.lines if wave else None)

    def number(self, *coords: int) -> int:
        """Index of the chunk at `coords` in the store's grid of chunks; in a sweep the direction is first."""
        block, wave = list(coords[1:] if self.directions else coords), 0
        if self.ramp is not None:
            visit = self._in_visiting_order(coords[0], block[self.ramp])
            block[self.ramp], wave = 0, coords[0] * self.counts[self.ramp] + visit
        return wave * self.lines + int(np.ravel_multi_index(block, self._counts_beside_ramp))

    def _in_visiting_order(self, direction: int, coord: int) -> int:
        """Position of a chunk along the ramp in the order of visits, or the reverse."""
        last = self.counts[self.ramp or 0] - 1
        return last - coord if self.directions[direction] == "down" else coord

    @cached_property
    def _counts_beside_ramp(self) -> tuple[int, ...]:
        return tuple(1 if axis == self.ramp else n for axis, n in enumerate(self.counts))


class Cost(Strict):
    """The estimated cost of a study."""

    cells: int
    chunks: int
    bytes: int = Field(description="of stored arrays before compression; an upper limit for an adaptive map")
    core_seconds: float = Field(description="an upper limit for an adaptive map")
    computed_cells: tuple[int, int] | None = Field(
        None, description="adaptive maps: range of the cells usually computed"
    )
    least_core_seconds: float | None = Field(None, description="adaptive maps: lower limit; null for others")
    longest_core_seconds: float | None = Field(
        None,
        description="upper limit: all cells bounce as often as those that bounce most, and as many settle as "
        "where most do; null for a study of orbits",
    )
    basis: Literal["measured", "table"] = Field(
        "table", description="measured: the table of costs, scaled by what a sample of the study took"
    )
    workers: int = Field(0, description="tasks that the service's workers can run at once now")

    @property
    def upper_core_seconds(self) -> float:
        """The upper end of the estimate; limits and the order of jobs use it."""
        return max(self.core_seconds, self.longest_core_seconds or 0.0)

    def seconds_on(self, workers: int) -> float:
        """The time that this number of workers takes, or one core."""
        return self.core_seconds / max(min(workers, self.chunks), 1)

    def at(self, pace: float | None) -> "Cost":
        """The cost at a pace of `worker.pace`; as the table says without one."""
        if pace is None:
            return self
        seconds = {"core_seconds": pace * self.core_seconds}
        if self.longest_core_seconds is not None:
            seconds["longest_core_seconds"] = pace * self.longest_core_seconds
        if self.least_core_seconds is not None:  # of an adaptive map, of which the sample tells all
            seconds["least_core_seconds"] = seconds["core_seconds"]
        return self.model_copy(update={**seconds, "basis": "measured"})


def check_size(
    cost: Cost,
    *,
    max_cells: int = DEFAULT_MAX_CELLS,
    max_bytes: int = DEFAULT_MAX_BYTES,
    max_core_seconds: float = DEFAULT_MAX_CORE_SECONDS,
) -> None:
    """Raise `SpecTooLarge` for more cells, stored bytes before compression, or core-seconds than these.

    An adaptive map counts with its computed cells, a range with its upper end.
    """
    cells, computed = cost.cells, ""
    if cost.computed_cells is not None:
        cells, computed = cost.computed_cells[1], "computed "
    if cells > max_cells:
        rule = f"asks for {cells:,} {computed}cells; at most {max_cells:,} are allowed"
        raise SpecTooLarge([Problem("", f"{rule}: take fewer values on the axes")])
    if cost.bytes > max_bytes:
        per_cell = cost.bytes // cost.cells
        rule = f"asks for {cost.bytes:,} bytes, {per_cell:,} per cell; at most {max_bytes:,} are allowed"
        raise SpecTooLarge([Problem("keep", f"{rule}: keep fewer flights or take fewer values")])
    if cost.upper_core_seconds > max_core_seconds:
        rule = (
            f"asks for up to {cost.upper_core_seconds:,.0f} core-seconds; at most {max_core_seconds:,.0f} "
            "are allowed (max_core_seconds)"
        )
        raise SpecTooLarge([Problem("", f"{rule}: take fewer values, or fewer periods (settle, observe)")])


def even(n: int, max_size: int) -> int:
    """Size of the parts if n is divided into the fewest parts of at most `max_size`, nearly equal."""
    parts = -(-n // max_size)
    return -(-n // parts)


@dataclass(frozen=True)
class ChunkOptions:
    """How a chunk is computed; the options change no result."""

    slice_seconds: float = math.inf  # core-seconds after which it pauses
    begins: bool = False  # the chunk's first task: it has no checkpoint
    seconds: float = math.inf  # limit on the task's wall time, not counting the wait for a worker
    priority: float = 0.0  # waiting chunks of higher priority start first


USUAL: Final = ChunkOptions()

#: The options of the chunk that this thread computes.
OPTIONS: Final[ContextVar[ChunkOptions]] = ContextVar("options", default=USUAL)

#: Set in a worker process that must leave: its chunks pause at once, so that nothing is lost.
LEAVING: Final = threading.Event()


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
    """The report of a task on its chunk."""

    index: int
    cells: int
    seconds: float  # wall time, storing included
    kernel_seconds: float  # the part spent in the kernel
    outcomes: tuple[int, ...]  # number of cells by kernel.params.Outcome
    computed: int | None = None  # cells that were not filled in; None without the array COMPUTED
    paused_seconds: float = 0.0  # the part of `seconds` in earlier slices


def report_of(chunk: Any, record: Mapping[str, NDArray[Any]], seconds: tuple[float, float]) -> ChunkReport:
    """The report of a stored chunk. `seconds`: in all, and in the kernel."""
    outcomes = tuple(np.bincount(record["outcome"].ravel(), minlength=len(Outcome)).tolist())
    computed = int(record[COMPUTED].sum()) if COMPUTED in record else None
    return ChunkReport(chunk.index, chunk.cells, *seconds, outcomes, computed)
