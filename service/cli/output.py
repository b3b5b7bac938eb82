"""How the command line writes jobs."""

import json
from collections.abc import Sequence
from math import ceil, isfinite, log10
from typing import TYPE_CHECKING, Any

from service.client.display import duration

if TYPE_CHECKING:
    import xarray

    from service.client import Estimate, Job


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


def estimate(found: "Estimate") -> str:
    """What a sweep would cost, in a line."""
    by = "by the speed measured here" if found.basis == "measured" else "by the table of costs"
    return (
        f"{found.cells:,} cells in {found.chunks:,} chunks, {found.bytes / 1e6:,.3g} MB before compression, "
        f"{found.core_seconds:,.3g} core-seconds {by}"
    )


def thresholds_view(found: "xarray.Dataset") -> dict[str, Any]:
    """Thresholds as plain values, null where there is none."""
    columns = {
        name: found[name].values.tolist() for name in ("omega", "analytic", "up", "down") if name in found
    }
    plain = {name: [v if isfinite(v) else None for v in values] for name, values in columns.items()}
    return {"xi": float(found.xi), **plain, "tolerance": found.attrs.get("tolerance"),
            "complete": bool(found.attrs["complete"])}  # fmt: skip


def thresholds(found: "xarray.Dataset") -> str:
    """Thresholds, one Ω a line."""
    tolerance = found.attrs.get("tolerance")
    digits = 6 if tolerance is None else min(max(6, 2 + ceil(-log10(tolerance))), 12)
    width = digits + 6
    lines = [f"xi = {float(found.xi):g}" + (f", to {tolerance:g} in gamma" if tolerance else ", to the grid")]
    lines.append("".join(f"{name:>{width}}" for name in ("OMEGA", "EQ. 25", "UP", "DOWN")))
    columns = [found[name].values.tolist() for name in ("omega", "analytic", "up", "down")]
    for row in zip(*columns, strict=True):
        lines.append("".join(f"{f'{v:.{digits}f}' if isfinite(v) else '-':>{width}}" for v in row))
    return "\n".join(lines + ([] if found.attrs["complete"] else ["the job is not done: this is incomplete"]))


def table(jobs: Sequence["Job"]) -> str:
    """Jobs, one a line, under a heading that is there even when they are not."""
    rows = [("ID", "STATE", "DONE", "CELLS", "NAME")]
    for job in jobs:
        done = job.progress
        rows.append((job.id, job.state, f"{done.whole_percent}%", f"{done.cells_total:,}", job.name))
    return "\n".join(f"{a:<32}  {b:<9}  {c:>4}  {d:>13}  {e}".rstrip() for a, b, c, d, e in rows)
