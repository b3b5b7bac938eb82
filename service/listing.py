"""How the command line writes jobs."""

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

from service.client.display import duration

if TYPE_CHECKING:
    from service.client import Job


def as_json(content: object) -> str:
    """Indented JSON, letters of every language as they are."""
    return json.dumps(content, indent=2, ensure_ascii=False)


def report(job: "Job") -> str:
    """A job in a few lines."""
    view, done = job.view, job.progress
    left = "" if job.finished or done.eta_seconds is None else f", {duration(done.eta_seconds)} left"
    lines = {
        "id": job.id,
        "name": job.name,
        "state": job.state,
        "progress": f"{done.whole_percent}% ({done.cells_done:,} of {done.cells_total:,} cells, "
        f"{done.chunks_done:,} of {done.chunks_total:,} chunks){left}",
        **{event: view.get(event) for event in ("created", "started", "finished", "error")},
    }
    return "\n".join(f"{name:<10}{text}" for name, text in lines.items() if text)


def table(jobs: Sequence["Job"]) -> str:
    """Jobs, one a line, under a heading that is there even when they are not."""
    rows = [("ID", "STATE", "DONE", "CELLS", "NAME")]
    for job in jobs:
        done = job.progress
        rows.append((job.id, job.state, f"{done.whole_percent}%", f"{done.cells_total:,}", job.name))
    return "\n".join(f"{a:<32}  {b:<9}  {c:>4}  {d:>13}  {e}".rstrip() for a, b, c, d, e in rows)
