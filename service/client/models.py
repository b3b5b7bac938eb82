"""The records in the service's answers, and the status of a job. Imports no other module of the client."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from worker.spec.errors import Problem as FieldProblem

#: The final states of a job; only a request changes them.
FINISHED: Final = ("done", "failed", "cancelled")


@dataclass(frozen=True)
class Problem:
    """A problem document (RFC 9457)."""

    status: int
    title: str
    detail: str = ""
    fields: tuple[FieldProblem, ...] = ()

    @classmethod
    def from_json(cls, document: Mapping[str, Any], *, status: int, reason: str) -> "Problem":
        """Read a problem document; every member is optional. `status` and `reason` are the status line's."""
        return cls(
            status=status,
            title=str(document.get("title") or reason or f"status {status}"),
            detail=str(document.get("detail") or ""),
            fields=_field_problems(document.get("errors")),
        )

    def __str__(self) -> str:
        """The detail, then one line for each field that the detail does not mention."""
        text = self.detail or self.title
        lines = map(str, self.fields)
        return "\n".join([text, *(f"  {line}" for line in lines if line not in text)])


@dataclass(frozen=True)
class Progress:
    """How much of a job is computed. `eta_seconds` is None until the service can estimate it."""

    chunks_done: int
    chunks_total: int
    cells_done: int
    cells_total: int
    percent: float
    eta_seconds: float | None = None
    cells_settling: int = 0  # of those done, still settling at the end of their window
    cells_computed: int | None = None  # of an adaptive map: of those done, not taken from their block
    cells_needed: int | None = None  # of an adaptive map: known to be computed in the end; it can grow

    @classmethod
    def from_json(cls, view: Mapping[str, Any]) -> "Progress":
        """Read the `progress` member of a job."""
        return cls(**{name: view[name] for name in cls.__dataclass_fields__ if name in view})

    @property
    def whole_percent(self) -> int:
        """Percent rounded down: 100 means that every cell is computed."""
        return int(self.percent)


class Estimate(NamedTuple):
    """The estimated cost of a sweep."""

    cells: int
    chunks: int
    bytes: int  # of the stored arrays, before compression
    core_seconds: float  # of an adaptive map at most
    longest_core_seconds: float | None  # upper end: counts for limits; None for orbits
    basis: str  # measured: from a sample of the study; table: from the table of costs
    computed_cells: tuple[int, int] | None = None  # of an adaptive map, as a rule: at least and at most
    least_core_seconds: float | None = None  # of an adaptive map
    workers: int = 0  # tasks that the service's workers run at once, now


class JobStatus:
    """A job as the service last described it. `view` holds the whole JSON object."""

    id: str
    state: str
    progress: Progress
    view: dict[str, Any]

    def _update(self, view: Mapping[str, Any]) -> None:
        """Replace the description. Raises KeyError or TypeError if `view` does not describe a job."""
        self.id = str(view["id"])
        self.state = str(view["state"])
        self.progress = Progress.from_json(view["progress"])
        self.view = dict(view)

    @property
    def name(self) -> str:
        """The label given in the specification, or an empty string."""
        return str(self.view.get("name") or "")

    @property
    def error(self) -> str | None:
        """Why the job failed."""
        return self.view.get("error")

    @property
    def compiling(self) -> str:
        """The kernel that a worker compiles for the job, its time so far and its usual time; else empty."""
        facts = self.view.get("compiling")
        if not facts:
            return ""
        return f"compiling {facts['kernel']}, {round(facts['seconds'])} s of about {round(facts['usual'])}"

    @property
    def pinned(self) -> bool:
        """Whether a user marked the job."""
        return bool(self.view.get("pinned"))

    @property
    def notice(self) -> str | None:
        """That another kernel version than the service's computed the job; None if it did not.

        After `resume` of a job of another version: that this job starts it anew.
        """
        return self.view.get("notice")

    @property
    def replaced_by(self) -> str | None:
        """Id of the job that computes the sweep anew, for a job of another kernel version."""
        return self.view.get("replaced_by")

    @property
    def finished(self) -> bool:
        """Whether the job is done, failed or cancelled."""
        return self.state in FINISHED


def _field_problems(errors: object) -> tuple[FieldProblem, ...]:
    """The `errors` member, each entry naming a field and a rule; other entries are ignored."""
    entries = [entry for entry in errors if isinstance(entry, dict)] if isinstance(errors, list) else []
    names = FieldProblem._fields
    return tuple(FieldProblem._make(str(entry.get(name) or "") for name in names) for entry in entries)
