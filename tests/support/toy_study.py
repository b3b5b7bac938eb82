"""A toy kind of study with all parts of a new one. It counts the divisors of whole numbers.

Its package (this module): a specification, a plan, a task, its variables and its cost. Beside it only a row
of `worker.studies.STUDIES` is needed for it to run as a job; queries and routes of its own would come on top.
"""

import time
from typing import ClassVar, Literal

import numpy as np

from kernel.params import Outcome
from worker import store
from worker.spec.axes import Strict
from worker.spec.specification import Specification
from worker.study import Array, Chunk, ChunkReport, Cost, Layout, Plan, Study


class Divisors(Strict):
    """The protocol, whose kind chooses the study."""

    kind: Literal["divisors"]
    step: int = 1


class ToySpec(Specification):
    """Whole numbers from 1 to `last`."""

    AXES: ClassVar = ()

    protocol: Divisors
    last: int


def plan(spec: ToySpec, chunk_shape: tuple[int, ...] | None = None, longest: float = 30.0) -> Plan:
    return Plan((spec.last,), chunk_shape or (7,))


def variables(spec: ToySpec, chunk_shape: tuple[int, ...]) -> Layout:
    return Layout(
        chunk_sizes={"number": chunk_shape[0]},
        coordinates={"number": np.arange(1.0, spec.last + 1)},
        extra_sizes={"smallest": 2},
        arrays=(
            Array("count", ("number",), "<i4", 0, {"long_name": "number of divisors"}),
            Array("divisor", ("number", "smallest"), "<i4", 0, {"long_name": "the smallest two"}),
            Array("outcome", ("number",), "|u1", 0, {"long_name": "whether it is computed"}),
        ),
        attributes={"title": spec.name, "spec": spec.as_submitted()},
        identity={"job": spec.job_id("toy"), "chunk_shape": list(chunk_shape)},
    )


def estimate(spec: ToySpec, plan: Plan) -> Cost:
    return Cost(cells=plan.cells, chunks=len(plan), bytes=13 * plan.cells, core_seconds=1e-6 * plan.cells)


def run_chunk(spec: ToySpec, chunk: Chunk, store_url: str) -> ChunkReport:
    began = time.perf_counter()
    ((first, last),) = chunk.spans
    divisors = [
        [d for d in range(1, n + 1, spec.protocol.step) if n % d == 0] for n in range(first + 1, last + 1)
    ]
    record = {
        "count": np.array([len(found) for found in divisors], np.int32),
        "divisor": np.array([[*found, 0][:2] for found in divisors], np.int32),
        "outcome": np.full(chunk.cells, Outcome.PERIODIC, np.uint8),
    }
    store.write_chunk(store_url, chunk, record)
    took = time.perf_counter() - began
    outcomes = (0, chunk.cells, 0, 0, 0, 0)
    return ChunkReport(chunk.index, chunk.cells, took, took, outcomes)


TOY = Study(ToySpec.parse, plan, variables, estimate, "toy_study")
