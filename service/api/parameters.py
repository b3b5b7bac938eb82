"""Query parameters of the HTTP API, as Pydantic models. A misspelt parameter is refused, not ignored."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from service.errors import InvalidRequest
from service.formats import (
    DatasetFormat,
    ExportFormat,
    ExportLayout,
)
from service.jobs.model import JobState
from service.jobs.search import MAX_TEXT, InvalidCursor, JobOrder, JobSearch, Position
from worker.spec.contact_models import CONTACT_MODELS
from worker.studies import STUDIES


class Query(BaseModel):
    """Base class: unknown parameters are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _one_of(kinds: Mapping[str, object]) -> AfterValidator:
    """Refuses a kind that a table does not have."""

    def check(kind: str | None) -> str | None:
        if kind is not None and kind not in kinds:
            raise ValueError(f"should be one of {', '.join(kinds)}")
        return kind

    return AfterValidator(check)


def _in_utc(time: datetime) -> datetime:
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time


Time = Annotated[datetime, AfterValidator(_in_utc)]


class JobsQuery(Query):
    """Which jobs to list."""

    state: JobState | None = None
    search: Annotated[
        str | None,
        Field(
            min_length=1,
            max_length=MAX_TEXT,
            description="part of the name, ASCII letters in either case, or the beginning of the id",
        ),
    ] = None
    model: Annotated[
        str | None,
        _one_of(CONTACT_MODELS),
        Field(description=f"kind of contact: {', '.join(CONTACT_MODELS)}"),
    ] = None
    protocol: Annotated[
        str | None, _one_of(STUDIES), Field(description=f"kind of protocol: {', '.join(STUDIES)}")
    ] = None
    pinned: bool | None = None
    created_from: Annotated[
        Time | None, Field(description="a date or time, UTC if it names no zone; included")
    ] = None
    created_before: Annotated[Time | None, Field(description="as created_from; not included")] = None
    order: JobOrder = JobOrder.NEWEST
    limit: Annotated[int, Field(ge=1, le=1000)] = 100
    cursor: Annotated[
        str | None, Field(pattern="^[0-9A-Za-z_-]{1,2000}$", description="`next` of the page before")
    ] = None

    @property
    def jobs(self) -> JobSearch:
        """What to look for."""
        first, last = (
            None if time is None else time.timestamp() for time in (self.created_from, self.created_before)
        )
        return JobSearch(
            self.search, self.state, self.model, self.protocol, self.pinned, first, last, self.order
        )

    def after(self) -> Position | None:
        """Where the page begins. Raises InvalidRequest for a cursor of another list."""
        if self.cursor is None:
            return None
        try:
            return self.jobs.read_cursor(self.cursor)
        except InvalidCursor as error:
            raise InvalidRequest.of(
                "cursor", "should be `next` of the page before, of a list in the same order"
            ) from error


class SubmitQuery(Query):
    """Whether to accept the sweep or only to validate it."""

    validate_only: bool = False


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
