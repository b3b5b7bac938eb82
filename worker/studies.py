"""Kinds of study: what a job computes.

Another kind of study is a package of its own and a row of STUDIES; its queries and routes are in the service
(see docs/architecture.md).
"""

from importlib import import_module
from typing import Any, Final

from worker.basins import plan as basins
from worker.basins.schema import basin_layout, multistability_layout
from worker.basins.specification import BasinSpec, MultistabilitySpec
from worker.maps import plan as maps
from worker.orbits import plan as orbits
from worker.orbits import schema as orbits_schema
from worker.orbits.specification import OrbitsSpec
from worker.spec import parsing
from worker.spec.specification import Specification
from worker.study import Chunk, ChunkReport, Study
from worker.sweep import SweepSpec, plan, schema
from worker.sweep.specification import EarlierSweep, is_earlier

SWEEP: Final = Study(SweepSpec.parse, plan.make_plan, schema.layout, plan.estimate, "worker.sweep.task")

#: An adaptive map: a sweep that computes some cells and fills in the others.
MAP: Final = Study(
    SweepSpec.parse, maps.make_plan, schema.layout, maps.estimate, "worker.maps.task", maps.first_round
)

#: Every kind of study except MAP, by the `kind` of its specification's `protocol`.
STUDIES: Final = {
    "rest": SWEEP,
    "ramp": SWEEP,
    "orbits": Study(
        OrbitsSpec.parse, orbits.make_plan, orbits_schema.layout, orbits.estimate, "worker.orbits.task"
    ),
    "basin": Study(
        BasinSpec.parse, basins.plan_basins, basin_layout, basins.estimate_basins, "worker.basins.task"
    ),
    "multistability": Study(
        MultistabilitySpec.parse, basins.plan_lines, multistability_layout, basins.estimate_lines,
        "worker.basins.multistability",
    ),
}  # fmt: skip


def study_of(spec: Any) -> Study:
    """The kind of study of a specification."""
    return MAP if spec.fills_in else STUDIES[spec.protocol.kind]


def parse(data: object) -> Any:
    """A specification of any kind from plain JSON values. Raises a `SpecError`."""
    return _study_named(data).parse(data)


def _study_named(data: object) -> Study:
    """The kind of study that plain JSON values name; a sweep if they name none."""
    protocol = data.get("protocol") if isinstance(data, dict) else None
    kind = protocol.get("kind") if isinstance(protocol, dict) else None
    return STUDIES.get(kind, SWEEP) if isinstance(kind, str) else SWEEP


def from_json(text: str | bytes) -> Any:
    """A specification of any kind from JSON text. Raises a `SpecError`."""
    return parse(parsing.read_json(text))


def from_stored(text: str | bytes) -> Any:
    """A specification from a ledger or store, also of an earlier release. Raises a `SpecError`."""
    data = parsing.read_json(text)
    if isinstance(data, dict) and _study_named(data) is SWEEP and is_earlier(data):
        return EarlierSweep.parse(data)
    return parse(data)


def renewed(text: str | bytes) -> Any:
    """The specification that computes a stored one anew. Raises a `SpecError`."""
    spec = from_stored(text)
    return spec.today() if isinstance(spec, EarlierSweep) else spec


def pace_of(spec: Specification) -> float | None:
    """The pace of a study of any kind: the function that executors call in workers."""
    pace: float | None = import_module("worker.pace").pace(spec)
    return pace


def run_task(spec: Specification, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute one chunk of a study of any kind: the function that executors run in workers."""
    report: ChunkReport = import_module(study_of(spec).task).run_chunk(spec, chunk, store_url)
    return report
