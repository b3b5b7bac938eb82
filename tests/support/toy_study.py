"""A kind of study that nobody needs: what a new one has to bring. It counts the divisors of whole numbers.

Its package (this module): a specification, a plan, a task, its variables and its cost. Beside it only a row
of `worker.studies.STUDIES` is needed for it to run as a job; queries and routes of its own would come on top.
"""

import hashlib
import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from kernel.params import Outcome
from worker import store
from worker.cost import Cost
from worker.schema import Array, Layout
from worker.spec.axes import Strict
from worker.tasks import ChunkReport, Study


class Divisors(Strict):
    """The protocol, whose kind chooses the study."""

    kind: Literal["divisors"]
    step: int = 1


class ToySpec(Strict):
    """Whole numbers from 1 to `last`."""

    name: str = ""
    protocol: Divisors
    last: int

    def as_submitted(self) -> dict[str, Any]:
        return self.model_dump(mode="json")

    def job_id(self, kernel_version: str) -> str:
        text = json.dumps(self.model_dump(exclude={"name"}), sort_keys=True)
        return hashlib.sha256(f"{kernel_version} {text}".encode()).hexdigest()[:32]


@dataclass(frozen=True)
class ToyChunk:
    """Some of the numbers in a row."""

    index: int
    first: int
    last: int
    after: None = None

    @property
    def cells(self) -> int:
        return self.last - self.first

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.cells,)

    @property
    def slices(self) -> tuple[slice, ...]:
        return (slice(self.first, self.last),)


@dataclass(frozen=True)
class ToyPlan(Sequence[ToyChunk]):
    """Chunks of `chunk_shape` numbers, none of which waits for another."""

    cells: int
    chunk_shape: tuple[int]

    @property
    def lines(self) -> int:
        return len(self)

    def __len__(self) -> int:
        return math.ceil(self.cells / self.chunk_shape[0])

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        i = range(len(self))[index]
        return ToyChunk(i, i * self.chunk_shape[0], min((i + 1) * self.chunk_shape[0], self.cells))

    def number(self, *coords: int) -> int:
        return coords[0]


def plan(spec: ToySpec, chunk_shape: tuple[int, ...] | None = None, longest: float = 30.0) -> ToyPlan:
    return ToyPlan(spec.last, (chunk_shape or (7,))[:1])


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


def estimate(spec: ToySpec, plan: ToyPlan) -> Cost:
    return Cost(cells=plan.cells, chunks=len(plan), bytes=13 * plan.cells, core_seconds=1e-6 * plan.cells)


def task(spec: ToySpec, chunk: ToyChunk, store_url: str) -> ChunkReport:
    began = time.perf_counter()
    numbers = range(chunk.first + 1, chunk.last + 1)
    divisors = [[d for d in range(1, n + 1, spec.protocol.step) if n % d == 0] for n in numbers]
    record = {
        "count": np.array([len(found) for found in divisors], np.int32),
        "divisor": np.array([[*found, 0][:2] for found in divisors], np.int32),
        "outcome": np.full(chunk.cells, Outcome.PERIODIC, np.uint8),
    }
    stored = store.write_chunk(store_url, chunk, record)
    took = time.perf_counter() - began
    return ChunkReport(
        chunk.index,
        chunk.cells,
        took,
        took,
        stored.checksum,
        (0, chunk.cells, 0, 0, 0, 0),
        bytes=stored.bytes,
    )


TOY = Study(ToySpec.model_validate, plan, variables, estimate, task)
