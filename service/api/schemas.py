"""Query parameters and response bodies of the HTTP API, as Pydantic models. Refuses misspelt parameters."""

import math
import time
from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from kernel.numerics.cache import Compilation
from service.formats import MEDIA_TYPES, DatasetFormat, ExportFormat, ExportLayout
from service.jobs.prepare import choice_of
from service.ledger.model import Failure, JobRecord, JobState
from service.ledger.search import JobSearch
from service.views.registry import VIEWS
from service.views.view import SECONDS, Query
from worker.analysis.model_selection import ModelChoice
from worker.spec.contact_models import CONTACT_MODELS
from worker.spec.errors import Code
from worker.spec.specification import Document, Label
from worker.studies import STUDIES

#: Lists leave out a specification longer than this, in characters of JSON.
LONG_SPEC: Final = 10_000


if TYPE_CHECKING:
    Contact = str
    Protocol = str
else:
    Contact, Protocol = Literal[tuple(CONTACT_MODELS)], Literal[tuple(STUDIES)]


class NewName(Document):
    """Another name of a job."""

    WHAT: ClassVar = "a name"

    name: Label


class JobsQuery(JobSearch):
    """Which jobs to list."""

    model: Contact | None = None
    protocol: Protocol | None = None
    limit: Annotated[int, Field(ge=1, le=1000)] = 100
    cursor: str | None = Field(
        None, pattern="^[0-9A-Za-z_-]{1,2000}$", description="`next` of the page before"
    )


class SubmitQuery(Query):
    """Whether to accept the sweep or only to validate it."""

    validate_only: bool = False
    budget: Annotated[float, Field(le=604_800), SECONDS] | None = Field(
        None, description="s, or a time such as 5m, at most a week: the finest level that fits is computed"
    )


class JobQuery(Query):
    """Which budget is shown."""

    budget: str | None = Field(
        None, description="id of a budget with this level; by default the newest with this level is shown"
    )


class MotionQuery(Query):
    """The format of a motion."""

    format: DatasetFormat = "json"


class ExportQuery(Query):
    """Format of the file, and what its rows are."""

    format: ExportFormat
    layout: ExportLayout = Field(
        "cells",
        description="of parquet: a row for every cell, of basins and multistability for every attractor of a "
        "cell; or for each of their flights",
    )


class ProgressView(BaseModel):
    """Progress of a job."""

    chunks_done: int
    chunks_total: int
    cells_done: int
    cells_total: int
    cells_settling: int = Field(description="of the cells done: still settling at the end of their window")
    cells_computed: int | None = Field(
        description="of an adaptive map: of the cells done, those not taken from their block; else null"
    )
    cells_needed: int | None = Field(
        description="of an adaptive map: cells known to be computed in the end; it grows while tiles are "
        "refined, and is `cells_computed` once the job is done; else null"
    )
    percent: float
    eta_seconds: float | None


class FailureView(BaseModel):
    """A chunk that could not be computed."""

    chunk: int
    place: str = Field(description="the chunk's cells")
    error: str
    traceback: str | None = Field(description="null if a worker process died")
    tries: int


class CompilingView(BaseModel):
    """A kernel that is compiled before a job's first chunk."""

    model_config = ConfigDict(from_attributes=True)

    kernel: str = Field(description="its contact model")
    seconds: float = Field(description="so far")
    usual: float = Field(description="seconds that it took the last time, or usually takes")


class BudgetView(BaseModel):
    """A sweep within a time: its levels, each a job."""

    model_config = ConfigDict(from_attributes=True)

    id: str = Field(description="as the `budget` of GET: budgets of one sweep share levels")
    doing: str = Field(description="the level that is computed; in the end what its audit says")
    computing: str | None = Field(description="id of the job of that level")
    answer: str | None = Field(description="id of the job of the finest level that is done")
    seconds_left: int
    over: bool
    error: str | None = Field(description="why there is no answer")


class JobView(BaseModel):
    """A job."""

    id: str
    name: str
    state: JobState
    progress: ProgressView
    error: str | None
    kernel_version: str
    notice: str | None = Field(
        description="of a job of another kernel version than this release's: that it is; of a job that is "
        "not computed now: why (a disk that cannot be written, no scheduler, no workers yet, workers "
        "refused); else null"
    )
    replaced_by: str | None = Field(
        description="id of the job that computes the sweep anew, with this release's kernel version"
    )
    owner: str | None = Field(
        description="name of the access token that submitted it, or resumed it last; null if that has none"
    )
    created: datetime
    started: datetime | None
    finished: datetime | None
    repairing: bool = Field(
        description="it was done, and computes stored results again that were damaged; no answer is complete"
    )
    pinned: bool = Field(description="a user marked it, to find it again")
    core_seconds: float = Field(
        description="that its chunks took, those computed again included; not known of adopted chunks"
    )
    spec: dict[str, JsonValue] | None = Field(description="null in lists if it is long")
    compiling: CompilingView | None = Field(None, description="the kernel that is compiled now")
    choice: ModelChoice | None = Field(None, description="model `auto`: the model that was chosen, and why")
    budget: BudgetView | None = Field(
        None, description="of a level of a budget that this service began: how far that is; null in lists"
    )
    failures: list[FailureView] = Field([], description="empty in lists and events")
    links: dict[str, str]


class JobList(BaseModel):
    """A page of jobs."""

    jobs: list[JobView]
    total: int = Field(description="number of jobs on all pages")
    next: str | None = Field(description="cursor of the next page; null on the last page")
    notice: str | None = Field(description="why no job is accepted now; null if jobs are")


class BrokenRule(BaseModel):
    """A field and the rule that it breaks."""

    field: str
    rule: str
    code: Code = Field(description="missing, unknown, type: the field is, or has another type; else rule")


class ProblemDocument(BaseModel):
    """A problem document (RFC 9457)."""

    title: str
    status: int
    detail: str
    errors: list[BrokenRule] = []


class Health(BaseModel):
    """The service is alive."""

    status: Literal["ok"]


class SoftwareView(BaseModel):
    """What the service runs on."""

    release: str
    kernel_version: str = Field(description="with which new jobs are computed; a job names its own")
    python: str
    libraries: dict[str, str]
    data: str = Field(description="the service's data folder")


class ReadinessView(BaseModel):
    """The service accepts and computes jobs."""

    status: Literal["ok"]
    notices: list[str] = Field(
        [], description="what an operator should know, such as stores that the ledger does not know"
    )


class PartsView(BaseModel):
    """Progress of a response that workers compute in parts."""

    parts_done: int
    parts_total: int
    percent: float


class PendingView(BaseModel):
    """Workers are computing the response: repeat the request after Retry-After seconds."""

    state: Literal["running"] = "running"
    progress: PartsView
    notice: str | None = Field(None, description="why nothing is computed now")


def job_view(
    job: JobRecord,
    longest_spec: float = math.inf,
    failures: Sequence[Failure] = (),
    notice: str | None = None,
    compiling: Compilation | None = None,
    budget: BudgetView | None = None,
) -> JobView:
    """The view of a job now, without a specification longer than `longest_spec`.

    `notice` replaces the job's own.
    """
    here = f"/v1/jobs/{job.id}"
    return JobView(
        **vars(job)
        | {
            "progress": job.progress(time.time(), compiling=compiling is not None),
            "notice": notice or job.notice,
            "repairing": job.repairing,
            "finished": None if job.repairing else job.finished,
            "core_seconds": round(job.core_seconds, 3),
            "spec": job.named_spec if len(job.spec) <= longest_spec else None,
            "compiling": compiling,
            "choice": choice_of(job),
            "budget": budget,
            "failures": [failure._asdict() for failure in failures],
            "links": {"self": here, **{part: f"{here}/{part}" for part in (*_PARTS, *VIEWS)}},
        }
    )


#: Resources of a job beside its views.
_PARTS: Final = ("cancel", "resume", "pin", "unpin", "rename", "events", "export", "zarr")


def problem_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Entries of the API document for responses that are problem documents."""
    content = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/ProblemDocument"}}}
    return {status: {"description": "Problem document", "content": content} for status in statuses}


def content(*formats: str) -> dict[int | str, dict[str, Any]]:
    """Entries of the API document for an answer in one of these formats; Parquet is an extra."""
    lacking = problem_responses(501) if "parquet" in formats else {}
    return {200: {"content": {MEDIA_TYPES[format]: {} for format in formats}}, **lacking}


#: Entry of the API document for responses that workers compute on demand.
PENDING_RESPONSE: Final[dict[int | str, dict[str, Any]]] = {
    202: {"model": PendingView, "description": "Being computed; repeat the request after Retry-After seconds"}
}


#: Entry of the API document for conditional requests.
NOT_MODIFIED: Final[dict[int | str, dict[str, Any]]] = {
    304: {"description": "The tag in If-None-Match is current"}
}


def json_body(*names: str) -> dict[str, Any]:
    """Entry of the API document for a body that is one of these models."""
    schemas = [{"$ref": f"#/components/schemas/{name}"} for name in names]
    schema = schemas[0] if len(schemas) == 1 else {"oneOf": schemas}
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": schema}}}}
