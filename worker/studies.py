"""Kinds of study: the protocol of what a job computes, and its implementation for sweeps.

A study parses its specification, plans its chunks, declares its stored variables, estimates its cost, and
computes one chunk. Ledger, queue, executors, store, progress, cancelling and repair use only these five
methods.

Another kind of study is a package of its own and a row of STUDIES; its queries and routes are in the service
(see docs/architecture.md).
"""

from collections.abc import Iterator
from typing import Any, Final, Protocol

from worker import schema, tasks
from worker.basins.multistability import MULTISTABILITY
from worker.basins.study import BASINS
from worker.cost import Cost, estimate
from worker.orbits import ORBITS
from worker.plan import LONGEST_SECONDS, make_plan
from worker.plan import Chunk as SweepChunk
from worker.plan import Plan as SweepPlan
from worker.schema import Layout
from worker.spec import SweepSpec, parsing
from worker.store import HasSlices
from worker.tasks import ChunkReport


class Spec(Protocol):
    """The specification of a study: a frozen value that can be pickled."""

    @property
    def name(self) -> str:
        """A label; not part of the study's identity."""

    @property
    def protocol(self) -> Any:
        """An object whose `kind` is the study's key in STUDIES."""

    def as_submitted(self) -> dict[str, Any]:
        """Plain JSON values, which `Study.parse` accepts."""

    def job_id(self, kernel_version: str) -> str:
        """32 hex digits that depend on the specification and the kernel version alone."""


class Chunk(HasSlices, Protocol):
    """A block of cells that one task computes and writes."""

    @property
    def index(self) -> int:
        """Its index in the plan."""

    @property
    def after(self) -> int | None:
        """Index of the chunk that must be done first, which is lower; None without one."""

    @property
    def cells(self) -> int: ...


class Plan(Protocol):
    """The chunks of a study, each computed when it is indexed: there may be a million."""

    @property
    def chunk_shape(self) -> tuple[int, ...]:
        """Cells of a chunk along each dimension; the ledger keeps it to repeat the plan."""

    @property
    def cells(self) -> int: ...

    @property
    def lines(self) -> int:
        """Chunks without a predecessor; each other chunk i depends on chunk i - lines."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Chunk: ...

    def __iter__(self) -> Iterator[Chunk]: ...

    def number(self, *coords: int) -> int:
        """Index of the chunk at these coordinates in the store's grid of chunks."""


class Study(Protocol):
    """A kind of study. All methods except `task` are pure."""

    def parse(self, data: object) -> Any:
        """The specification from plain JSON values. Raises a `SpecError` that names every broken rule."""

    def plan(
        self, spec: Any, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
    ) -> Any:
        """The chunks, of `chunk_shape` or of a shape that the study chooses.

        Many chunks may be longer, up to about `longest` core-seconds each.
        """

    def variables(self, spec: Any, chunk_shape: tuple[int, ...]) -> Layout:
        """The layout of the store."""

    def estimate(self, spec: Any, plan: Any) -> Cost:
        """The cost; computes and allocates nothing."""

    def task(self, spec: Any, chunk: Any, store_url: str) -> ChunkReport:
        """Compute one chunk and store it, in a worker process; repeated, it writes the same bytes.

        Raises a `tasks.TaskError` or a `store.StoreError`. A task that takes longer than the slice of
        `tasks.OPTIONS` should store its progress and raise `tasks.ChunkPaused`: it is called again.
        """


class SweepStudy:
    """Parameter sweeps from rest or along a ramp."""

    def parse(self, data: object) -> SweepSpec:
        return SweepSpec.parse(data)

    def plan(
        self, spec: SweepSpec, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
    ) -> SweepPlan:
        return make_plan(spec, chunk_shape=chunk_shape, longest=longest)

    def variables(self, spec: SweepSpec, chunk_shape: tuple[int, ...]) -> Layout:
        return schema.layout(spec, chunk_shape)

    def estimate(self, spec: SweepSpec, plan: SweepPlan) -> Cost:
        return estimate(spec, len(plan))

    def task(self, spec: SweepSpec, chunk: SweepChunk, store_url: str) -> ChunkReport:
        return tasks.run_chunk(spec, chunk, store_url, tasks.OPTIONS.get().slice_seconds)


SWEEP: Final = SweepStudy()

#: Every kind of study by the `kind` of its specification's `protocol`.
STUDIES: Final[dict[str, Study]] = {
    "rest": SWEEP,
    "ramp": SWEEP,
    "orbits": ORBITS,
    "basin": BASINS,
    "multistability": MULTISTABILITY,
}


def study_of(spec: Spec) -> Study:
    """The kind of study of a specification."""
    return STUDIES[spec.protocol.kind]


def parse(data: object) -> Any:
    """A specification of any kind from plain JSON values. Raises a `SpecError`."""
    protocol = data.get("protocol") if isinstance(data, dict) else None
    kind = protocol.get("kind") if isinstance(protocol, dict) else None
    study = STUDIES.get(kind, SWEEP) if isinstance(kind, str) else SWEEP
    return study.parse(data)


def from_json(text: str | bytes) -> Any:
    """A specification of any kind from JSON text. Raises a `SpecError`."""
    return parse(parsing.read_json(text))


def run_task(spec: Spec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute one chunk of a study of any kind: the function that executors run in workers."""
    return study_of(spec).task(spec, chunk, store_url)
