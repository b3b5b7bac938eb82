"""Text, CSV and JSON that the commands print and write."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from io import StringIO
from math import ceil, isclose, isfinite, isnan, log10
from typing import TYPE_CHECKING, Any, Final

from service.client.display import time_left

if TYPE_CHECKING:
    import xarray

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
        **{member: job.view.get(member) for member in ("notice", "created", "started", "finished", "error")},
    }
    return "\n".join(f"{name:<10}{text}" for name, text in lines.items() if text)


def job_table(jobs: Sequence["Job"]) -> str:
    """A heading, then one line per job."""
    rows = [("ID", "STATE", "DONE", "CELLS", "NAME")]
    for job in jobs:
        progress = job.progress
        rows.append((job.id, job.state, f"{progress.whole_percent}%", f"{progress.cells_total:,}", job.name))
    return "\n".join(f"{a:<32}  {b:<9}  {c:>4}  {d:>13}  {e}".rstrip() for a, b, c, d, e in rows)


def estimate_line(estimate: "Estimate") -> str:
    """The estimated cost of a sweep."""
    basis = "from recent jobs" if estimate.basis == "measured" else "from the table of costs"
    return (
        f"{estimate.cells:,} cells in {estimate.chunks:,} chunks, {estimate.bytes / 1e6:,.3g} MB before "
        f"compression, {estimate.core_seconds:,.3g} core-seconds ({basis})"
    )


# Thresholds


def threshold_view(thresholds: "xarray.Dataset") -> dict[str, Any]:
    """Thresholds as plain values, null where there is none."""
    columns = {
        name: thresholds[name].values.tolist()
        for name in ("omega", "analytic", "up", "down")
        if name in thresholds
    }
    plain = {name: [v if isfinite(v) else None for v in values] for name, values in columns.items()}
    return {"xi": float(thresholds.xi), **plain, "tolerance": thresholds.attrs.get("tolerance"),
            "complete": bool(thresholds.attrs["complete"])}  # fmt: skip


def threshold_table(thresholds: "xarray.Dataset", on_grid: "xarray.Dataset", spec: Mapping[str, Any]) -> str:
    """Thresholds, one Ω per line; below them, why an entry is a bound or missing.

    `on_grid` contains the thresholds without refinement, the lowest Γ of the grid that bounces; `spec` is the
    specification of the sweep.
    """
    from worker.spec import SweepSpec

    sweep = SweepSpec.parse(dict(spec))
    tolerance = thresholds.attrs.get("tolerance")
    digits = 6 if tolerance is None else min(max(6, 2 + ceil(-log10(tolerance))), 12)
    width = digits + 6
    notes: dict[str, None] = {}  # in the order of their first use

    def column(name: str) -> list[str]:
        if name not in ["down" if direction == "down" else "up" for direction in sweep.directions]:
            notes[f"-: the sweep is not ramped {name}"] = None
            return ["-"] * thresholds.sizes["omega"]
        entries = _Entries(sweep.axis_values("gamma").tolist(), bool(on_grid.attrs["complete"]), digits)
        pairs = zip(thresholds[name].values.tolist(), on_grid[name].values.tolist(), strict=True)
        texts = [entries.text(*pair) for pair in pairs]
        notes.update(dict.fromkeys(entries.notes))
        return texts

    columns = [
        [f"{value:.{digits}f}" for value in thresholds.omega.values],
        [
            f"{value:.{digits}f}" if isfinite(value) else "inf"
            for value in thresholds.analytic.values.tolist()
        ],
        column("up"),
        column("down"),
    ]
    precision = f"to {tolerance:g} in gamma" if tolerance else "on the grid of gamma"
    lines = [f"xi = {float(thresholds.xi):g}, {precision}"]
    lines += [
        "".join(f"{text:>{width}}" for text in row)
        for row in (("OMEGA", "EQ. 25", "UP", "DOWN"), *zip(*columns, strict=True))
    ]
    incomplete = [] if thresholds.attrs["complete"] else ["the job is not done: thresholds may be missing"]
    return "\n".join([*lines, *notes, *incomplete])


class _Entries:
    """Writes thresholds as text and collects the notes that explain bounds."""

    def __init__(self, gamma: Sequence[float], complete: bool, digits: int) -> None:
        self._lowest, self._highest = gamma[0], gamma[-1]
        self._complete, self._digits = complete, digits
        self.notes: list[str] = []

    def text(self, threshold: float, on_grid: float) -> str:
        """A threshold, or the bound that the grid gives; NaN stands for none."""
        if isfinite(on_grid) and isclose(on_grid, self._lowest, rel_tol=1e-12):
            bound = f"≤ {self._lowest:.{self._digits}g}"
            return self._noted(bound, f"{bound}: the lowest Γ of the grid bounces already")
        if isfinite(threshold):
            return f"{threshold:.{self._digits}f}"
        if isfinite(on_grid):
            bound = f"≤ {on_grid:.{self._digits}g}*"
            return self._noted(bound, "*: not refined; the lowest Γ of the grid that bounces")
        if self._complete:
            bound = f"> {self._highest:.{self._digits}g}"
            return self._noted(bound, f"{bound}: no Γ of the grid bounces, this is the highest")
        return self._noted("-", "-: not computed yet")

    def _noted(self, text: str, note: str) -> str:
        self.notes.append(note)
        return text


# Tables of cells and samples


def modes_csv(mode_map: "xarray.Dataset") -> bytes:
    """One row per cell."""
    outcomes = mode_map.outcome.attrs["flag_meanings"].split()
    omega, gamma = mode_map.omega.values.tolist(), mode_map.gamma.values.tolist()
    planes = [mode_map[name].values.tolist() for name in ("outcome", "bounces", "periods")]
    rows = (
        (omega[i], gamma[k], outcomes[planes[0][i][k]], planes[1][i][k], planes[2][i][k])
        for i in range(len(omega))
        for k in range(len(gamma))
    )
    return _csv(("omega", "gamma", "outcome", "bounces", "periods"), rows)


def modes_json(mode_map: "xarray.Dataset") -> bytes:
    """The axes, and a nested list (omega, gamma) per variable."""
    names = ("omega", "gamma", "outcome", "bounces", "periods")
    plain = {"xi": float(mode_map.xi), "direction": str(mode_map.direction.values)}
    plain |= {name: mode_map[name].values.tolist() for name in names}
    return json.dumps({**plain, "complete": bool(mode_map.attrs["complete"])}).encode()


_SAMPLES: Final = ("phase", "plate", "z1", "z2", "force", "in_flight")


def trajectory_csv(motion: "xarray.Dataset") -> bytes:
    """One row per sample."""
    columns = [motion[name].values.astype(float).tolist() for name in _SAMPLES]
    return _csv(_SAMPLES, zip(*columns, strict=True))


def trajectory_json(motion: "xarray.Dataset") -> bytes:
    """A list per variable, null for NaN, and the flights."""
    flights = {name: motion[name].values.tolist() for name in ("takeoff", "takeoff_phase", "flight_time")}
    samples = {name: _with_null(motion[name].values.tolist()) for name in _SAMPLES}
    scalars = {"rest_length": motion.attrs["rest_length"], "complete": bool(motion.attrs["complete"])}
    return json.dumps({**scalars, **samples, "flights": flights}).encode()


def _with_null(values: Sequence[float]) -> list[float | None]:
    """The values, None in the place of NaN, which JSON lacks."""
    return [None if isnan(value) else value for value in values]


def _csv(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(names)
    table.writerows(rows)
    return text.getvalue().encode()
