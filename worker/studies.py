"""Kinds of study: what a service accepts as a job, and what workers compute of it.

A study says how its specification is parsed, how it is cut into chunks, what a worker does with one chunk,
what is stored, and what all of it costs. Everything between (the ledger, the queue, executors, the store,
progress, cancelling, repairs) works on these five answers alone and knows no kind of study.

A sweep is the first kind. Another one brings a package of its own and a row of STUDIES; what it needs of
queries and routes it adds in the service (see docs/architecture.md).
"""

from collections.abc import Iterator
from typing import Any, Final, Protocol

from worker import schema, tasks
from worker.cost import Cost, estimate
from worker.plan import Chunk as SweepChunk
from worker.plan import Plan as SweepPlan
from worker.plan import make_plan
from worker.schema import Layout
from worker.spec import SweepSpec, parsing
from worker.tasks import ChunkReport


class Spec(Protocol):
    """The specification of a study: a frozen value that can be pickled."""

    @property
    def name(self) -> str:
        """A label for people; no part of the study's identity."""

    @property
    def protocol(self) -> Any:
        """An object whose `kind` is the study's key in STUDIES."""

    def as_submitted(self) -> dict[str, Any]:
        """Plain JSON values, which `parse` takes again."""

    def job_id(self, kernel_version: str) -> str:
        """32 hex digits: the same specification and kernel version, the same job."""


class Chunk(Protocol):
    """A block of cells that one task computes and writes."""

    @property
    def index(self) -> int:
        """Its number in the plan; a chunk never waits for a later one."""

    @property
    def after(self) -> int | None:
        """The chunk to wait for."""

    @property
    def cells(self) -> int: ...

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape in which its task records these cells."""

    @property
    def slices(self) -> tuple[slice, ...]:
        """The cells it spans along each cell dimension of the layout."""


class Plan(Protocol):
    """The chunks of a study, each worked out when it is asked for: a plan may hold a million."""

    @property
    def chunk_shape(self) -> tuple[int, ...]:
        """How the study is cut: kept in the ledger, to make the same plan again."""

    @property
    def cells(self) -> int: ...

    @property
    def lines(self) -> int:
        """Chunk i waits for chunk i - lines, if there is one: as many chunks begin without waiting."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Chunk: ...

    def __iter__(self) -> Iterator[Chunk]: ...

    def number(self, *coords: int) -> int:
        """The index of the chunk at these coordinates in the store's grid of chunks."""


class Study(Protocol):
    """A kind of study. All methods are pure, but for `task`."""

    def parse(self, data: object) -> Any:
        """The specification from plain JSON values. Raises a `SpecError` that names every broken rule."""

    def plan(self, spec: Any, chunk_shape: tuple[int, ...] | None = None) -> Any:
        """The chunks, cut as `chunk_shape` says, or as this study sees fit."""

    def variables(self, spec: Any, chunk_shape: tuple[int, ...]) -> Layout:
        """What is stored."""

    def estimate(self, spec: Any, plan: Any) -> Cost:
        """What it will take; computes and allocates nothing."""

    def task(self, spec: Any, chunk: Any, store_url: str) -> ChunkReport:
        """Compute one chunk and store it, in a worker process. Repeated, it writes the same bytes."""


class SweepStudy:
    """Parameter sweeps from rest or along a ramp."""

    def parse(self, data: object) -> SweepSpec:
        return SweepSpec.parse(data)

    def plan(self, spec: SweepSpec, chunk_shape: tuple[int, ...] | None = None) -> SweepPlan:
        return make_plan(spec, chunk_shape=chunk_shape)

    def variables(self, spec: SweepSpec, chunk_shape: tuple[int, ...]) -> Layout:
        return schema.layout(spec, chunk_shape)

    def estimate(self, spec: SweepSpec, plan: SweepPlan) -> Cost:
        return estimate(spec, len(plan))

    def task(self, spec: SweepSpec, chunk: SweepChunk, store_url: str) -> ChunkReport:
        return tasks.run_chunk(spec, chunk, store_url)


SWEEP: Final = SweepStudy()

#: The kind of study by the `kind` of its specification's `protocol`.
STUDIES: Final[dict[str, Study]] = {"rest": SWEEP, "ramp": SWEEP}


def study_of(spec: Spec) -> Study:
    """The kind of study that a specification is of."""
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
    """Compute one chunk of a study of any kind; what executors have workers do."""
    return study_of(spec).task(spec, chunk, store_url)
