"""Kinds of study: what a job computes.

Another kind of study is a package of its own and a row of STUDIES; its queries and routes are in the service
(see docs/architecture.md).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from worker import cost, orbits, plan, schema, tasks
from worker.basins import multistability, study
from worker.basins.spec import BasinSpec, MultistabilitySpec
from worker.cost import Cost
from worker.plan import Chunk, Plan
from worker.schema import Layout
from worker.spec import SweepSpec, parsing
from worker.spec.specification import Specification as Spec

__all__ = ["STUDIES", "SWEEP", "Chunk", "Plan", "Spec", "Study", "from_json", "parse", "run_task", "study_of"]


@dataclass(frozen=True)
class Study:
    """A kind of study: five functions, all pure except `task`.

    Ledger, queue, executors, store, progress, cancelling and repair use only these.
    """

    #: The specification from plain JSON values. Raises a `SpecError` that names every broken rule.
    parse: Callable[[object], Any]
    #: (spec, chunk_shape=None, longest=LONGEST_SECONDS): the chunks, of `chunk_shape` or of a shape that the
    #: study chooses. Many chunks may be longer, up to about `longest` core-seconds each.
    plan: Callable[..., Plan]
    #: (spec, chunk_shape): the layout of the store.
    variables: Callable[[Any, tuple[int, ...]], Layout]
    #: (spec, plan): the cost; computes and allocates nothing.
    estimate: Callable[[Any, Plan], Cost]
    #: (spec, chunk, store_url): compute one chunk and store it, in a worker process; repeated, it writes the
    #: same bytes. Raises a `tasks.TaskError` or a `store.StoreError`. A task that takes longer than the slice
    #: of `tasks.OPTIONS` should store its progress and raise `tasks.ChunkPaused`: it is called again.
    task: Callable[[Any, Chunk, str], tasks.ChunkReport]


SWEEP: Final = Study(
    SweepSpec.parse, plan.make_plan, schema.layout, lambda spec, plan: cost.estimate(spec, len(plan)),
    tasks.run_chunk,
)  # fmt: skip

#: Every kind of study by the `kind` of its specification's `protocol`.
STUDIES: Final = {
    "rest": SWEEP,
    "ramp": SWEEP,
    "orbits": Study(
        orbits.OrbitsSpec.parse, orbits.make_plan, orbits.layout, orbits.estimate, orbits.run_chunk
    ),
    "basin": Study(BasinSpec.parse, study.make_plan, study.layout, study.estimate, study.run_chunk),
    "multistability": Study(
        MultistabilitySpec.parse, multistability.make_plan, multistability.layout, multistability.estimate,
        multistability.run_chunk,
    ),
}  # fmt: skip


def study_of(spec: Any) -> Study:
    """The kind of study of a specification."""
    return STUDIES[spec.protocol.kind]


def parse(data: object) -> Any:
    """A specification of any kind from plain JSON values. Raises a `SpecError`."""
    protocol = data.get("protocol") if isinstance(data, dict) else None
    kind = protocol.get("kind") if isinstance(protocol, dict) else None
    return (STUDIES.get(kind, SWEEP) if isinstance(kind, str) else SWEEP).parse(data)


def from_json(text: str | bytes) -> Any:
    """A specification of any kind from JSON text. Raises a `SpecError`."""
    return parse(parsing.read_json(text))


def run_task(spec: Spec, chunk: Chunk, store_url: str) -> tasks.ChunkReport:
    """Compute one chunk of a study of any kind: the function that executors run in workers."""
    return study_of(spec).task(spec, chunk, store_url)
