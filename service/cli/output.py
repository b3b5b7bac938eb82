"""Text, CSV and JSON that the commands print and write."""

import json
from collections.abc import Mapping, Sequence
from math import ceil, isfinite, log10
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from service.client.display import about, rounded, settling_note, size, time_left

if TYPE_CHECKING:
    import xarray
    from rich.console import RenderableType

    from service.client import Estimate, Job


def as_json(content: object) -> str:
    """Indented JSON, not restricted to ASCII."""
    return json.dumps(content, indent=2, ensure_ascii=False)


# Jobs


def job_report(job: "Job") -> str:
    """The status of a job, one property per line."""
    progress = job.progress
    lines = {
        "id": job.id,
        "name": job.name,
        "state": job.state,
        "progress": f"{progress.whole_percent}% ({progress.cells_done:,} of {progress.cells_total:,} cells, "
        f"{progress.chunks_done:,} of {progress.chunks_total:,} chunks){time_left(job)}",
        "settling": settling_note(job),
        **{
            member: job.view.get(member)
            for member in ("owner", "notice", "created", "started", "finished", "error")
        },
    }
    return "\n".join(f"{name:<10}{text}" for name, text in lines.items() if text)


def job_table(jobs: Sequence["Job"]) -> str:
    """A heading, then one line per job."""
    rows = [("ID", "STATE", "DONE", "CELLS", "NAME")]
    for job in jobs:
        progress = job.progress
        rows.append((job.id, job.state, f"{progress.whole_percent}%", f"{progress.cells_total:,}", job.name))
    return "\n".join(f"{a:<32}  {b:<9}  {c:>4}  {d:>13}  {e}".rstrip() for a, b, c, d, e in rows)


def jobs_live(jobs: Sequence["Job"]) -> "RenderableType":
    """Jobs as a table with bars, for a terminal."""
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    if not jobs:
        return Text("no job is queued or running")
    table = Table(box=None, pad_edge=False)
    for heading in ("ID", "STATE", "", "DONE", "CELLS", "LEFT", "NAME"):
        table.add_column(heading, justify="right" if heading in ("DONE", "CELLS") else "left")
    for job in jobs:
        progress = job.progress
        table.add_row(
            job.id[:8], job.state, ProgressBar(total=100.0, completed=progress.percent, width=24),
            f"{progress.whole_percent}%", f"{progress.cells_total:,}",
            time_left(job).removeprefix(", ").removesuffix(" left"), Text(job.name),
        )  # fmt: skip
    return table


def estimate_line(estimate: "Estimate") -> str:
    """The estimated cost of a sweep, in minutes on the workers that there are."""
    at_once = max(min(estimate.workers, estimate.chunks), 1)
    computed, seconds, most = "", about(estimate.core_seconds / at_once), ""
    if estimate.computed_cells is not None:
        low, high = estimate.computed_cells
        computed = f", of which about {low:,} to {high:,} are computed,"
        seconds = f"{about((estimate.least_core_seconds or 0.0) / at_once)} to {seconds}"
        most = "at most "
    longest = ""
    if estimate.longest_core_seconds is not None:
        longest = (
            f"; {about(estimate.longest_core_seconds / at_once)} if every cell settled until settle_until"
        )
    workers = "one core" if not estimate.workers else _plural(estimate.workers, "worker")
    return (
        f"{estimate.cells:,} cells{computed} in {_plural(estimate.chunks, 'chunk')}, "
        f"{most}{size(estimate.bytes)} before compression, about {seconds} on {workers} "
        f"({rounded(estimate.core_seconds)} core-seconds, {_BASES[estimate.basis]}{longest})"
    )


#: What an estimate is from. Where nothing was computed yet, neither is the kernel compiled.
_BASES: Final = {
    "measured": "from recent jobs",
    "table": "from the table of costs; the kernel is compiled first, unless the cache has it",
}


def _plural(number: int, thing: str) -> str:
    return f"{number:,} {thing}{'' if number == 1 else 's'}"


# Thresholds


def threshold_view(thresholds: "xarray.Dataset") -> dict[str, Any]:
    """Thresholds as plain values, null unless the status is `found`."""
    plain = {
        name: [value if isfinite(value) else None for value in thresholds[name].values.tolist()]
        for name in ("omega", "analytic", "up", "down", "predicted_jump", "predicted_down")
    }
    texts = ("up_status", "down_status", "cause", "difference")
    statuses = {name: thresholds[name].values.tolist() for name in texts}
    return {"xi": float(thresholds.xi), **plain, **statuses,
            "prediction": thresholds.attrs["prediction"],
            "tolerance": thresholds.attrs.get("tolerance"),
            "complete": bool(thresholds.attrs["complete"])}  # fmt: skip


class _Note(NamedTuple):
    """How a threshold that has no number is written, and what a line below the table says of it.

    `{low}` and `{high}` are the lowest and highest Γ of the sweep, `{direction}` is up or down, `{grid}` the
    lowest Γ of the grid that bounces.
    """

    entry: str
    text: str


#: By status; "never bounces" by direction.
_NOTES: Final = {
    "below the grid": _Note("≤ {low}", "bounces already at the lowest Γ, {low}: start lower"),
    "above the grid": _Note("> {high}", "at rest up to the highest Γ, {high}: end higher"),
    "never bounces up": _Note("never", "at rest at every Γ of the sweep, and by Eq. 25 at every other"),
    "never bounces down": _Note(
        "never", "no cell of the ramp down bounces, so no bouncing ends: start it higher"
    ),
    "not ramped": _Note("-", "the sweep is not ramped {direction}"),
    "not refined": _Note("≤ {grid}*", "not refined; the lowest Γ of the grid that bounces"),
    "missing": _Note("?", "the cell that decides is not computed yet"),
    "unresolved": _Note("unresolved", "the cell that decides ran out of events before its window ended"),
    "diverged": _Note("diverged", "a number of the cell that decides is not finite"),
    "settling": _Note(
        "settling", "the cell that decides was still settling: give it more time, settle_until"
    ),
}


def threshold_table(thresholds: "xarray.Dataset", on_grid: "xarray.Dataset", spec: Mapping[str, Any]) -> str:
    """Thresholds, one Ω per line; below them, why an entry is not a number.

    `on_grid` contains the thresholds without refinement, the lowest Γ of the grid that bounces; `spec` is the
    specification of the sweep.
    """
    from worker.spec import SweepSpec

    gamma = SweepSpec.parse(dict(spec)).axis_values("gamma").tolist()
    tolerance = thresholds.attrs.get("tolerance")
    digits = 6 if tolerance is None else min(max(6, 2 + ceil(-log10(tolerance))), 12)
    width = digits + 6
    notes: dict[str, None] = {}  # in the order of their first use

    def text(value: float, status: str, direction: str, grid: float) -> str:
        if status == "found":
            return f"{value:.{digits}f}"
        note = _NOTES.get(status) or _NOTES[f"{status} {direction}"]
        numbers = {"low": gamma[0], "high": gamma[-1], "grid": grid}
        fields = {name: str(float(f"{number:.{digits}g}")) for name, number in numbers.items()}
        fields["direction"] = direction
        entry = note.entry.format(**fields)
        notes[f"{entry}: {note.text.format(**fields)}"] = None
        return entry

    def column(name: str) -> list[str]:
        rows = zip(
            thresholds[name].values.tolist(),
            thresholds[f"{name}_status"].values.tolist(),
            on_grid[name].values.tolist(),
            strict=True,
        )
        return [text(value, status, name, grid) for value, status, grid in rows]

    predicted = [
        f"{value:.{digits}f}" if isfinite(value) else _undecided(cause)
        for value, cause in zip(
            thresholds.predicted_down.values.tolist(), thresholds.cause.values.tolist(), strict=True
        )
    ]
    columns = [
        [f"{value:.{digits}f}" for value in thresholds.omega.values],
        [
            f"{value:.{digits}f}" if isfinite(value) else "inf"
            for value in thresholds.analytic.values.tolist()
        ],
        column("up"),
        column("down"),
        predicted,
    ]
    precision = f"to {tolerance:g} in gamma" if tolerance else "on the grid of gamma"
    lines = [f"xi = {float(thresholds.xi):g}, {precision}"]
    last = max(width, 2 + max(map(len, predicted)))
    lines += [
        "".join(f"{text:>{width}}" for text in row) + f"{end:>{last}}"
        for *row, end in (("OMEGA", "EQ. 25", "UP", "DOWN", "PREDICTED"), *zip(*columns, strict=True))
    ]
    incomplete = [] if thresholds.attrs["complete"] else ["the job is not done: thresholds may be missing"]
    return "\n".join([*lines, *notes, *_differences(thresholds), *incomplete])


def _undecided(cause: str) -> str:
    """The status of a prediction that there is not, without its reason."""
    return next((s for s in ("unresolved", "not searched", "not predicted") if cause.startswith(s)), cause)


def _differences(thresholds: "xarray.Dataset") -> list[str]:
    """What PREDICTED is of, and where DOWN differs from it."""
    texts = zip(thresholds.omega.values.tolist(), thresholds.difference.values.tolist(), strict=True)
    differing = [f"omega {omega:g}: {text}" for omega, text in texts if text]
    return [
        f"PREDICTED: the lowest that bounces by the closed form, {thresholds.attrs['prediction']}",
        *differing,
    ]
