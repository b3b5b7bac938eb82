"""A data folder as a release with kernel version 1 leaves it: one job is done, one was interrupted."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

from studies import spec_of

from service.jobs.stores.opening import open_ledger
from service.ledger.model import JobState, NewJob
from service.settings import Settings
from worker import store
from worker.studies import run_task
from worker.study import Array
from worker.sweep import SweepSpec, schema
from worker.sweep.plan import make_plan
from worker.sweep.schema import layout
from worker.sweep.specification import EarlierSweep

VERSION = "1"
SPECS: dict[str, dict[str, Any]] = {
    "done": spec_of((1.0, 3.0, 9), [0.5, 1.0], 0.26, window=(40, 20, 8), name="from rest", exponents=1),
    "interrupted": spec_of(
        (0.4, 1.2, 41), [0.56, 0.6, 0.64], [0.05, 0.1], "both", (40, 20, 8),
        name="up and down", settle_until=640,
    ),
}  # fmt: skip
#: Variables that this kernel version did not store.
ADDED_SINCE = ("lyapunov_error", "flight_error", "multiplier", "multiplier_angle")
#: Chunks that are done, of 1 and of 12.
DONE_CHUNKS = {"done": 1, "interrupted": 3}
IDS = {name: EarlierSweep(**spec).job_id(VERSION) for name, spec in SPECS.items()}


def arrays_of_then(spec: SweepSpec, today: Any = schema.arrays) -> Iterator[Array]:
    yield from (array for array in today(spec) if array.name not in ADDED_SINCE)


def earlier_folder(parent: Path) -> Path:
    """The data folder, in `parent`."""
    settings = Settings(data=parent / "bounce-data")
    with patch.object(schema, "arrays", arrays_of_then), open_ledger(settings) as ledger:
        for name, fields in SPECS.items():
            spec = EarlierSweep(**fields)
            plan = make_plan(spec, chunk_shape=(1, 2 if name == "done" else 1, 41))
            now = layout(spec, plan.chunk_shape)
            then = replace(
                now,
                identity={**now.identity, "job": IDS[name]},
                attributes={**now.attributes, "kernel_version": VERSION},
            )
            url = settings.store_of(f"{IDS[name]}.zarr")
            store.create(url, then)
            reports = [run_task(spec, chunk, url) for chunk in plan[: DONE_CHUNKS[name]]]
            new = NewJob(
                IDS[name], spec.name, json.dumps(spec.as_submitted()), VERSION, plan.chunk_shape, len(plan),
                plan.cells,
            )  # fmt: skip
            with ledger.writing() as writing:
                writing.insert(new, 1.0, f"{IDS[name]}.zarr")
                job = writing.find(new.id)
                assert job is not None
                writing.run(job, 2.0)
                writing.mark_done(job, reports)
                if len(reports) == len(plan):
                    running = writing.find(new.id)
                    assert running is not None
                    writing.finish(running, JobState.DONE, 3.0)
    return settings.data
