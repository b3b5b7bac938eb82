"""What a file with a job's results says of the job: the same attributes in every format.

Those of the store depend on the specification alone. A file adds what computed it: software, libraries,
processor, times, and core-seconds. The service's versions are those of all workers, which it admits only if
they have the same.
"""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from service.jobs.model import JobRecord
from service.jobs.prepare import PreparedJob
from worker.schema import flat_attributes


def attributes_of(job: JobRecord, prepared: PreparedJob) -> dict[str, str | int | float]:
    """The attributes of a file with all results of a job: texts and numbers, values with parts as JSON."""
    layout = prepared.layout
    attributes = {**layout.attributes, **prepared.attributes, **layout.identity}
    attributes |= {"job": job.id, "kernel_version": job.kernel_version, "history": _history(job)}
    runs = json.loads(job.runs)
    if runs:
        last = runs[-1]
        attributes |= {
            "software": _software(last, job),
            "libraries": {"python": last["python"], **last["libraries"]},
            "processor": last["processor"],
        }
    if job.core_seconds:  # of adopted results it is not known
        attributes["core_seconds"] = round(job.core_seconds, 3)
    return flat_attributes(attributes)


def _history(job: JobRecord) -> str:
    """Lines of time and event."""
    lines = [f"{_time(job.created)} accepted"]
    lines += [f"{_time(run['began'])} computing with {_software(run, job)}" for run in json.loads(job.runs)]
    if job.finished is not None and not job.repairing:
        lines.append(f"{_time(job.finished)} {job.state}")
    return "\n".join(lines)


def _software(run: Mapping[str, Any], job: JobRecord) -> str:
    return f"bouncing-spring {run['release']}, kernel version {job.kernel_version}"


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
