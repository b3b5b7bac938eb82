"""Query parameters of the HTTP API, as Pydantic models. A misspelt parameter is refused, not ignored."""

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, Field

from service.formats import DatasetFormat, ExportFormat, ExportLayout
from service.jobs.model import JobState
from service.jobs.search import MAX_TEXT, JobOrder, JobSearch, Position
from service.views.view import Query
from worker.spec.contact_models import CONTACT_MODELS
from worker.studies import STUDIES

if TYPE_CHECKING:
    Contact = str
    Protocol = str
else:
    Contact, Protocol = Literal[tuple(CONTACT_MODELS)], Literal[tuple(STUDIES)]


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
    model: Contact | None = None
    protocol: Protocol | None = None
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
        return None if self.cursor is None else self.jobs.read_cursor(self.cursor)


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
