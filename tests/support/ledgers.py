"""Records of jobs, jobs accepted by a ledger, and reports of their chunks."""

import json
from typing import Any

from kernel.params import KERNEL_VERSION
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, JobState, NewJob
from worker.study import ChunkReport
from worker.sweep import SweepSpec
from worker.sweep.plan import make_plan


def record(study: SweepSpec, **changes: Any) -> JobRecord:
    """The record of a queued job, with these fields changed."""
    plan = make_plan(study)
    fields: dict[str, Any] = {
        "id": study.job_id(KERNEL_VERSION), "name": study.name, "spec": json.dumps(study.as_submitted()),
        "kernel_version": KERNEL_VERSION, "chunk_shape": plan.chunk_shape, "chunks_total": len(plan),
        "cells_total": plan.cells, "seq": 1, "store": "1.zarr", "state": JobState.QUEUED,
        "cancel_requested": False, "error": None, "created": 0.0, "started": None, "finished": None,
        "chunks_done": 0, "cells_done": 0, "cells_settling": 0, "cells_computed": 0,
        "choice": None, "replaced_by": None,
    }  # fmt: skip
    return JobRecord(**fields | changes)


def accept(ledger: Ledger, job_id: str = "a" * 32, chunks: int = 4) -> JobRecord:
    job = NewJob(job_id, "a name", '{"gamma": 1.0}', "1", (1, 2, 3), chunks, 10 * chunks)
    with ledger.writing() as writing:
        writing.insert(job, now=100.0)
    return current(ledger, job_id)


def current(ledger: Ledger, job_id: str = "a" * 32) -> JobRecord:
    job = ledger.find(job_id)
    assert job is not None
    return job


def reports(*chunks: int) -> list[ChunkReport]:
    return [ChunkReport(chunk, 10, 0.5, 0.4, (0, 10, 0, 0, 0, 0, 0)) for chunk in chunks]
