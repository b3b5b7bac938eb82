"""Text, CSV and JSON that the commands print and write."""

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from service.cli.options import plural
from service.client.display import duration, settling_note, time_left

if TYPE_CHECKING:
    from service.client import Estimate, Job


def as_json(content: object) -> str:
    """Indented JSON, not restricted to ASCII."""
    return json.dumps(content, indent=2, ensure_ascii=False)


def job_report(job: "Job") -> str:
    """The status of a job, one property per line."""
    progress = job.progress
    lines = {
        "id": job.id,
        "name": job.name,
        "state": job.state,
        "progress": f"{progress.whole_percent}% "
        f"({progress.cells_done:,} of {plural(progress.cells_total, 'cell')}, "
        f"{progress.chunks_done:,} of {plural(progress.chunks_total, 'chunk')}){time_left(job)}",
        "settling": settling_note(job),
        "model": (job.view.get("choice") or {}).get("reason"),
        **{x: job.view.get(x) for x in ("owner", "notice", "created", "started", "finished", "error")},
    }
    return "\n".join(f"{name:<10}{text}" for name, text in lines.items() if text)


def job_table(jobs: Sequence["Job"]) -> str:
    """A heading, then one line per job."""
    rows = [("ID", "STATE", "DONE", "CELLS", "NAME")]
    for job in jobs:
        progress = job.progress
        name = f"{job.name}{time_left(job)}".removeprefix(", ")
        rows.append((job.id, job.state, f"{progress.whole_percent}%", f"{progress.cells_total:,}", name))
    return "\n".join(f"{a:<32}  {b:<9}  {c:>4}  {d:>13}  {e}".rstrip() for a, b, c, d, e in rows)


def estimate_line(estimate: "Estimate") -> str:
    """The estimated cost of a sweep, in time on the present workers."""
    from rich.filesize import decimal

    def time(core_seconds: float | None) -> str:
        return duration(max((core_seconds or 0.0) / at_once, 1.0))

    at_once = max(min(estimate.workers, estimate.chunks), 1)
    computed, seconds, most, longest = "", time(estimate.core_seconds), "", ""
    if estimate.computed_cells is not None:
        low, high = estimate.computed_cells
        computed = f", of which about {_range(f'{low:,}', f'{high:,}')} are computed,"
        seconds, most = _range(time(estimate.least_core_seconds), seconds), "at most "
    if estimate.longest_core_seconds is not None:
        longest = f"; up to {time(estimate.longest_core_seconds)} if every cell were a slow one"
    workers = "one core" if not estimate.workers else plural(estimate.workers, "worker")
    return (
        f"{plural(estimate.cells, 'cell')}{computed} in {plural(estimate.chunks, 'chunk')}, "
        f"{most}{decimal(estimate.bytes)} before compression, about {seconds} on {workers} "
        f"({estimate.core_seconds:,.1f} core-seconds, {_BASES[estimate.basis]}{longest})"
    )


#: The sources of an estimate. Where nothing was computed yet, the kernel may not be compiled either.
_BASES: Final = {
    "measured": "from a sample of the study",
    "table": "from the table of costs; the kernel is compiled first, unless the cache has it",
}


def _range(low: str, high: str) -> str:
    return high if low == high else f"{low} to {high}"
