"""A data folder as a release with kernel version 1 leaves it: two jobs are done, one was interrupted."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from studies import spec_of

from service.jobs.stores.opening import open_ledger
from service.ledger.model import JobState, NewJob
from service.settings import Settings
from worker import store
from worker.orbits.specification import OrbitsSpec
from worker.studies import run_task, study_of
from worker.sweep.specification import EarlierSweep

VERSION = "1"
SPECS: dict[str, dict[str, Any]] = {
    "done": spec_of((1.0, 3.0, 9), [0.5, 1.0], 0.26, window=(40, 20, 8), name="from rest", exponents=1),
    "interrupted": spec_of(
        (0.4, 1.2, 41), [0.56, 0.6, 0.64], [0.05, 0.1], "both", (40, 20, 8),
        name="up and down", settle_until=640,
    ),
    "cycles": {"omega": 0.6, "xi": 0.05, "protocol": {"kind": "orbits"}, "modes": ["1-1", "1-2"]},
}  # fmt: skip
#: Variables that this kernel version did not store.
ADDED_SINCE = ("lyapunov_error", "flight_error", "multiplier", "multiplier_angle")
#: Arrays that have another name since.
RENAMED = {"violations": "admissible", "event_violations": "event_admissible"}
CHUNKS = {"done": (1, 2, 41), "interrupted": (1, 1, 41), "cycles": (1, 1)}
#: Chunks that are done, of 1, of 12 and of 1.
DONE_CHUNKS = {"done": 1, "interrupted": 3, "cycles": 1}


def spec_of_then(name: str) -> Any:
    return OrbitsSpec(**SPECS[name]) if name == "cycles" else EarlierSweep(**SPECS[name])


IDS = {name: spec_of_then(name).job_id(VERSION) for name in SPECS}


def earlier_folder(parent: Path) -> Path:
    """The data folder, in `parent`."""
    settings = Settings(data=parent / "bounce-data")
    with open_ledger(settings) as ledger:
        for name, id in IDS.items():
            spec = spec_of_then(name)
            plan = study_of(spec).plan(spec, CHUNKS[name])
            today = study_of(spec).variables(spec, plan.chunk_shape)
            then = replace(
                today,
                arrays=tuple(
                    array._replace(name=RENAMED.get(array.name, array.name))
                    for array in today.arrays
                    if array.name not in ADDED_SINCE
                ),
                identity={**today.identity, "job": id},
                attributes={**today.attributes, "kernel_version": VERSION},
            )
            url, computed = settings.store_of(f"{id}.zarr"), str(parent / f"{name}.zarr")
            store.create(url, then)
            store.create(computed, today)
            reports = []
            for chunk in plan[: DONE_CHUNKS[name]]:
                reports.append(run_task(spec, chunk, computed))
                record = store.read_chunk(computed, chunk, today.names)
                record = {RENAMED.get(name, name): values for name, values in record.items()}
                store.write_chunk(url, chunk, {name: record[name] for name in then.names})
            new = NewJob(
                id,
                spec.name,
                json.dumps(spec.as_submitted()),
                VERSION,
                plan.chunk_shape,
                len(plan),
                plan.cells,
            )
            with ledger.writing() as writing:
                writing.insert(new, 1.0, f"{id}.zarr")
                job = writing.find(id)
                assert job is not None
                writing.run(job, 2.0)
                writing.mark_done(job, reports)
                if len(reports) == len(plan):
                    running = writing.find(id)
                    assert running is not None
                    writing.finish(running, JobState.DONE, 3.0)
    return settings.data
