"""The HTTP contract: what queries may ask and what answers hold."""

import hashlib
import json
import time
from datetime import UTC, datetime
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from service.api.failures import FailureView, failures_view
from service.formats import DiagramFormat, ExportFormat
from service.jobs.model import Failure, JobRecord, JobState
from service.jobs.model_selection import ChoiceView

#: A specification longer than this (in characters of JSON) is left out of lists.
LONG_SPEC: Final = 10_000

Number = Annotated[float, Field(allow_inf_nan=False)]
Every = Annotated[int, Field(ge=1, le=1_000_000, description="n: take every n-th value only")]


class Query(BaseModel):
    """Query parameters; a misspelt one is refused, not ignored."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class JobsQuery(Query):
    """Which jobs to list."""

    state: JobState | None = None
    limit: Annotated[int, Field(ge=1, le=1000)] = 100
    cursor: Annotated[str, Field(pattern="^[0-9]{1,18}$", description="`next` of the page before")] | None = (
        None
    )


class SubmitQuery(Query):
    """Whether the sweep is accepted or only looked at."""

    validate_only: bool = False


class LineQuery(Query):
    """One line of cells through the grid: along one axis, the others fixed at the nearest grid value."""

    along: Literal["gamma", "omega", "xi"] = "gamma"
    gamma: Number | None = None
    omega: Number | None = None
    xi: Number | None = None
    direction: str | None = Field(None, description="rest, up or down; the sweep's first if left out")
    min_flight: Annotated[Number, Field(ge=0, description="rad; shorter flights are left out")] = 0.0


class DiagramQuery(LineQuery):
    """A line and the form it comes in."""

    format: DiagramFormat = "json"
    every: Every = 1


class ThresholdQuery(Query):
    """Where Eq. 25 is asked for."""

    omega: Annotated[Number, Field(gt=0, le=1e6)]
    xi: Annotated[Number, Field(ge=0, le=1e6)]


class JobThresholdQuery(Query):
    """At which xi, the nearest grid value; may be left out where the sweep has one."""

    xi: Number | None = None
    tolerance: Annotated[Number, Field(ge=1e-9, le=1e3)] | None = Field(
        None, description="in Γ: refine beyond the sweep's grid, from its stored states"
    )


class PlaneQuery(Query):
    """Which plane of the grid: at the xi nearest to the one given, in one direction."""

    xi: Number | None = None
    direction: str | None = Field(None, description="rest, up or down; the sweep's first if left out")


class ModesQuery(PlaneQuery):
    """A plane, and how much of it."""

    every: Every = 1


class ExportQuery(Query):
    """What the file is."""

    format: ExportFormat


class ProgressView(BaseModel):
    """How far a job is."""

    chunks_done: int
    chunks_total: int
    cells_done: int
    cells_total: int
    percent: float
    eta_seconds: float | None


class JobView(BaseModel):
    """A job as its reader sees it."""

    id: str
    name: str
    state: JobState
    progress: ProgressView
    error: str | None
    created: datetime
    started: datetime | None
    finished: datetime | None
    spec: dict[str, JsonValue] | None = Field(description="null in events, and in lists where it is long")
    choice: ChoiceView | None = Field(None, description="of `auto`: the model that was chosen, and why")
    failures: list[FailureView] = Field([], description="given for a single job alone")
    links: dict[str, str]


class JobList(BaseModel):
    """Jobs, the last accepted first."""

    jobs: list[JobView]
    total: int = Field(description="how many there are, also beyond the limit")
    next: str | None = Field(description="cursor of the next page; null on the last")


class Modes(BaseModel):
    """Outcome and mode of every cell of a plane; rows are values of Ω, columns of Γ."""

    xi: float
    direction: str
    omega: list[float]
    gamma: list[float]
    outcome: list[list[int]]
    bounces: list[list[int]]
    periods: list[list[int]]
    complete: bool
    every: int = Field(1, description="the values are every n-th of both axes; left out where it is 1")


class Threshold(BaseModel):
    """Eq. 25 at one point."""

    omega: float
    xi: float
    threshold: float | None = Field(description="the lowest Γ that bounces from rest; null where none does")


class FlightsView(BaseModel):
    """The flights that took off and landed within the samples; rad."""

    takeoff: list[float] = Field(description="since the first sample")
    takeoff_phase: list[float] = Field(description="of the plate, modulo 2π")
    flight_time: list[float]


class Trajectory(BaseModel):
    """One cell, sample by sample; lengths in plate amplitudes, null beyond where it could be followed."""

    gamma: float
    omega: float
    xi: float
    model: dict[str, JsonValue]
    rest_length: float = Field(
        description="of the spring; where the model leaves it open, 1e4 contact depths"
    )
    phase: list[float] = Field(description="rad since the first sample")
    plate: list[float]
    z1: list[float | None] = Field(description="upper mass")
    z2: list[float | None] = Field(description="lower mass")
    force: list[float | None] = Field(description="of the plate on the lower mass, in mAω²")
    in_flight: list[bool]
    flights: FlightsView
    complete: bool


class BrokenRule(BaseModel):
    """A field and the rule it breaks."""

    field: str
    rule: str


class ProblemDocument(BaseModel):
    """An error (RFC 9457)."""

    title: str
    status: int
    detail: str
    errors: list[BrokenRule] = []


class Health(BaseModel):
    """Whether the service can do its work, and if not, why."""

    status: Literal["ok"]


def job_view(
    job: JobRecord, now: float | None = None, longest_spec: int | None = None, *failures: Failure
) -> JobView:
    """The view of a job at `now` (seconds since 1970); a specification longer than that is left out."""
    progress = job.progress(time.time() if now is None else now)
    return JobView(
        id=job.id,
        name=job.name,
        state=job.state,
        progress=ProgressView(
            chunks_done=progress.chunks_done,
            chunks_total=progress.chunks_total,
            cells_done=progress.cells_done,
            cells_total=progress.cells_total,
            percent=progress.percent,
            eta_seconds=progress.eta_seconds,
        ),
        error=job.error,
        created=_time(job.created),
        started=_time(job.started),
        finished=_time(job.finished),
        spec=None if longest_spec is not None and len(job.spec) > longest_spec else json.loads(job.spec),
        choice=None if job.choice is None else ChoiceView.model_validate_json(job.choice),
        failures=failures_view(failures),
        links=_links(job.id),
    )


def etag(job: JobRecord, failures: int = 0) -> str:
    """Changes when the view does, but for the time to go, which changes all the time."""
    facts = (failures, job.id, job.state, job.error, job.choice, job.chunks_done, job.started, job.finished)
    return f'W/"{hashlib.sha256(repr(facts).encode()).hexdigest()[:16]}"'


#: What there is of a job besides itself.
_PARTS: Final = ("cancel", "resume", "events", "diagram", "threshold", "modes", "export", "zarr")


def _links(job_id: str) -> dict[str, str]:
    here = f"/v1/jobs/{job_id}"
    return {"self": here, **{part: f"{here}/{part}" for part in _PARTS}}


def _time(seconds: float | None) -> Any:
    return None if seconds is None else datetime.fromtimestamp(seconds, UTC)


def problem_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """What the API document says of errors."""
    content = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/ProblemDocument"}}}
    return {status: {"description": "see the problem document", "content": content} for status in statuses}
