"""Searches for jobs: conditions and order in SQL, and the cursor of the next page. Pure."""

import base64
import json
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from enum import StrEnum
from itertools import chain
from operator import attrgetter
from typing import Annotated, Final, NamedTuple

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter

from service.errors import InvalidRequest
from service.ledger.model import JobRecord, JobState
from worker.spec.errors import is_number


class JobOrder(StrEnum):
    """The order of a list of jobs."""

    NEWEST = "newest"  # the last accepted first
    OLDEST = "oldest"
    FINISHED = "finished"  # the last finished first, unfinished ones at the end
    NAME = "name"  # by alphabet, without regard to ASCII case
    LARGEST = "largest"  # by the number of cells


class Position(NamedTuple):
    """Cursor position: after job `seq`, whose sort key is `value`."""

    value: str | float
    seq: int


class _Column(NamedTuple):
    sql: str
    key: Callable[[JobRecord], str | float]
    way: str = "DESC"  # of `seq` too, which orders equal jobs


_COLUMNS: Final = {
    JobOrder.NEWEST: _Column("seq", attrgetter("seq")),
    JobOrder.OLDEST: _Column("seq", attrgetter("seq"), "ASC"),
    JobOrder.FINISHED: _Column("coalesce(finished, 0)", lambda job: job.finished or 0.0),
    JobOrder.NAME: _Column("name COLLATE NOCASE", attrgetter("name"), "ASC"),
    JobOrder.LARGEST: _Column("cells_total", attrgetter("cells_total")),
}


#: Order, sort key and `seq` in a cursor; numbers within SQLite's range.
_CURSOR: Final = TypeAdapter(
    tuple[JobOrder, str | Annotated[float, Field(ge=0, lt=2**62)], Annotated[int, Field(ge=0, lt=2**62)]]
)


def _in_utc(moment: datetime) -> datetime:
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment


def _day(text: object) -> object:
    if is_number(str(text)):  # Pydantic would take it for seconds since 1970
        raise ValueError(f"must be a day such as 2026-11-25, not {text}")
    return text


Time = Annotated[datetime, BeforeValidator(_day), AfterValidator(_in_utc)]


class JobSearch(BaseModel):
    """Conditions on jobs; None allows any value."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    state: JobState | None = None
    search: str | None = Field(
        None,
        min_length=1,
        max_length=200,
        description="part of the name, ASCII letters in either case, or the beginning of the id",
    )
    model: str | None = None
    protocol: str | None = None
    pinned: bool | None = None
    created_from: Time | None = Field(None, description="a date or time, UTC if it names no zone; included")
    created_before: Annotated[Time | None, Field(description="as created_from; not included")] = None
    order: JobOrder = JobOrder.NEWEST

    def where(self, after: Position | None = None) -> tuple[str, list[str | float | None]]:
        """The WHERE clause of a query of `jobs` for jobs behind `after`, and its parameters."""
        ends = (self.created_from, self.created_before)
        first, last = (None if end is None else end.timestamp() for end in ends)
        values: dict[str, Sequence[str | float | None]] = {
            "state = ?": [self.state],
            "model = ?": [self.model],
            "protocol = ?": [self.protocol],
            "pinned = ?": [self.pinned],
            "created >= ?": [first],
            "created < ?": [last],
        }
        if self.search:
            text = self.search.casefold()
            values["(instr(casefold(name), ?) OR instr(id, ?) = 1)"] = [text, text]
        if after is not None:
            column = _COLUMNS[self.order]
            values[f"({column.sql}, seq) {'<' if column.way == 'DESC' else '>'} (?, ?)"] = after
        conditions = {sql: given for sql, given in values.items() if None not in given}
        return f"WHERE {' AND '.join(conditions) or 'true'}", [*chain(*conditions.values())]

    @property
    def order_by(self) -> str:
        """The ORDER BY clause."""
        column = _COLUMNS[self.order]
        return f"ORDER BY {column.sql} {column.way}, seq {column.way}"

    def cursor_after(self, job: JobRecord) -> str:
        """The cursor after a job; opaque to clients."""
        text = json.dumps([self.order, _COLUMNS[self.order].key(job), job.seq], ensure_ascii=False)
        return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")

    def read_cursor(self, text: str) -> Position:
        """The position of a cursor in this order. Raises InvalidRequest for other texts."""
        rule = "must be `next` of the page before, of a list in the same order"
        try:
            content = base64.urlsafe_b64decode(text + "=" * (-len(text) % 4))
            order, value, seq = _CURSOR.validate_json(content, strict=True)
        except ValueError as error:
            raise InvalidRequest.of("cursor", rule) from error
        if order is not self.order or isinstance(value, str) is not (order is JobOrder.NAME):
            raise InvalidRequest.of("cursor", rule)
        return Position(value, seq)


#: The search that finds all jobs, the newest first.
EVERY_JOB: Final = JobSearch()
