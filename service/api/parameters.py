"""Query parameters of the HTTP API, as Pydantic models. A misspelt parameter is refused, not ignored."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from kernel.branches.curves import CURVES
from service.errors import InvalidRequest
from service.formats import (
    DatasetFormat,
    ExportFormat,
    ExportLayout,
)
from service.jobs.model import JobState
from service.jobs.search import MAX_TEXT, InvalidCursor, JobOrder, JobSearch, Position
from service.views.view import Omega, Xi
from worker.orbits import MAX_POINTS
from worker.spec.contact_models import CONTACT_MODELS
from worker.studies import STUDIES

Number = Annotated[float, Field(allow_inf_nan=False)]
Every = Annotated[int, Field(ge=1, le=1_000_000, description="n: return every n-th value only")]
Pixels = Annotated[int, Field(ge=1, le=4096)]
MinFlight = Annotated[
    Number | None,
    Field(
        ge=0, description="rad; shorter flights do not count, unless all of a cell are; default: micro_flight"
    ),
]
Direction = Annotated[
    str | None, Field(description="rest, up or down; default: the first direction of the sweep")
]


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


class LineQuery(Query):
    """One line of the grid along one axis; the other axes are fixed at the nearest grid value."""

    along: Literal["gamma", "omega", "xi"] = "gamma"
    gamma: Number | None = None
    omega: Number | None = None
    xi: Number | None = None
    direction: Direction = None
    min_flight: MinFlight = None


Modes = Annotated[str, Field(max_length=200, description="bounces-periods, as 1-1,1-2; cycles of one bounce")]
GammaMax = Annotated[Number, Field(gt=0, le=1e6, description="branches and curves are cut above this Γ")]


class OrbitsQuery(Query):
    """A spring, and which of its branches to compute."""

    omega: Omega
    xi: Xi
    modes: Modes = "1-1,1-2"
    gamma_max: GammaMax = 8.0
    points: Annotated[int, Field(ge=10, le=MAX_POINTS, description="of each branch, at least")] = 400
    energy: bool = Field(False, description="the energy balance of every point as well")


class CurvesQuery(Query):
    """A range of Ω at one ξ, or of ξ at one Ω."""

    omega: Omega | None = None
    xi: Xi | None = None
    omega_start: Omega | None = None
    omega_stop: Omega | None = None
    xi_start: Xi | None = None
    xi_stop: Xi | None = None
    modes: Modes = "1-1,1-2"
    kinds: Annotated[
        str, Field(max_length=200, description="fold, flip, neimark-sacker, immediate-takeoff; default: all")
    ] = ",".join(CURVES)
    gamma_max: GammaMax = 8.0


class PlaneQuery(Query):
    """Plane of the grid at the nearest value of ξ, in one direction."""

    xi: Number | None = None
    direction: Direction = None
    min_flight: MinFlight = None
    hysteresis: bool = Field(
        False, description="of a sweep ramped both ways: where its directions differ as well"
    )


class JobOrbitsQuery(Query):
    """The spring of the sweep nearest to the given values, and the direction whose cells are continued."""

    omega: Number | None = None
    xi: Number | None = None
    direction: Direction = None
    gamma_max: GammaMax = 8.0
    energy: bool = Field(False, description="the energy balance of every point as well")


class ExportQuery(Query):
    """Format of the file, and what its rows are."""

    format: ExportFormat
    layout: ExportLayout = Field(
        "cells",
        description="of parquet: a row for every cell, of basins and multistability for every attractor of a "
        "cell; or for each of their flights",
    )


class LineViewQuery(LineQuery):
    """A line and a window of it: left and right in units of the axis, bottom and top in rad."""

    left: Number | None = None
    right: Number | None = None
    bottom: Number = 0.0
    top: Number | None = None
    log: bool = Field(False, description="columns at equal ratios")
    width: Pixels = 800
    height: Pixels = 400
    most: Annotated[int, Field(ge=0, le=1_000_000, description="flights sent as points")] = 250_000


class PlaneViewQuery(PlaneQuery):
    """A plane and a window of it: left and right in Γ, bottom and top in Ω."""

    left: Number | None = None
    right: Number | None = None
    bottom: Number | None = None
    top: Number | None = None
