"""Kinds of study: what a job computes.

A study parses its specification, plans its chunks, declares its stored variables, estimates its cost, and
computes one chunk. Ledger, queue, executors, store, progress, cancelling and repair use only these five
functions (`tasks.Study`).

Another kind of study is a package of its own and a row of STUDIES; its queries and routes are in the service
(see docs/architecture.md).
"""

from collections.abc import Iterator
from typing import Any, Final, Protocol

from worker import schema, tasks
from worker.basins.multistability import MULTISTABILITY
from worker.basins.study import BASINS
from worker.cost import estimate
from worker.orbits import ORBITS
from worker.plan import LONGEST_SECONDS, make_plan
from worker.plan import Plan as SweepPlan
from worker.spec import SweepSpec, parsing
from worker.store import HasSlices
from worker.tasks import ChunkReport, Study


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


def _plan_sweep(
    spec: SweepSpec, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
) -> SweepPlan:
    return make_plan(spec, chunk_shape=chunk_shape, longest=longest)


SWEEP: Final = Study(
    parse=SweepSpec.parse,
    plan=_plan_sweep,
    variables=schema.layout,
    estimate=lambda spec, plan: estimate(spec, len(plan)),
    task=tasks.run_chunk,
)

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
