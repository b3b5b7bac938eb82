"""What a file with a job's results says of the job: the same attributes in every format.

Those of the store depend on the specification alone. A file adds what computed it: software, libraries,
processor, times, and core-seconds. The service's versions are those of all workers, which it admits only if
they have the same.
"""

import json
from datetime import UTC, datetime

from service.jobs.model import JobRecord
from service.jobs.prepare import PreparedJob
from worker.schema import flat_attributes


def attributes_of(job: JobRecord, prepared: PreparedJob) -> dict[str, str | int | float]:
    """The attributes of a file with all results of a job: texts and numbers, values with parts as JSON."""
    layout, runs = prepared.layout, json.loads(job.runs)
    software = [f"bouncing-spring {run['release']}, kernel version {job.kernel_version}" for run in runs]
    events = [(job.created, "accepted")]
    events += [(run["began"], f"computing with {text}") for run, text in zip(runs, software, strict=True)]
    if job.finished is not None and not job.repairing:
        events.append((job.finished, str(job.state)))
    times = [f"{datetime.fromtimestamp(at, UTC):%Y-%m-%dT%H:%M:%SZ} {what}" for at, what in events]
    attributes = {**layout.attributes, **prepared.attributes, **layout.identity}
    attributes |= {"job": job.id, "kernel_version": job.kernel_version, "history": "\n".join(times)}
    if runs:
        libraries = {"python": runs[-1]["python"], **runs[-1]["libraries"]}
        attributes |= {
            "software": software[-1], "libraries": libraries, "processor": runs[-1]["processor"],
        }  # fmt: skip
    if job.core_seconds:  # of adopted results it is not known
        attributes["core_seconds"] = round(job.core_seconds, 3)
    return flat_attributes(attributes)
