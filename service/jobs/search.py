"""Searches of jobs: conditions and order in SQL, and the cursor of the next page. Pure."""

import base64
import json
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple

from service.jobs.model import JobRecord, JobState

#: Longest text to search for, in characters.
MAX_TEXT: Final = 200


#: Above all numbers of a cursor, and within SQLite's range.
_MAX: Final = 1 << 62


class InvalidCursor(ValueError):
    """A text that is no cursor of a list in this order."""


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
    descending: bool  # `seq` too, which orders equal jobs


_COLUMNS: Final = {
    JobOrder.NEWEST: _Column("seq", descending=True),
    JobOrder.OLDEST: _Column("seq", descending=False),
    JobOrder.FINISHED: _Column("coalesce(finished, 0)", descending=True),
    JobOrder.NAME: _Column("name COLLATE NOCASE", descending=False),
    JobOrder.LARGEST: _Column("cells_total", descending=True),
}


@dataclass(frozen=True)
class JobSearch:
    """Conditions on jobs; None: any.

    `text` is contained in the name (ASCII letters in either case), or begins the id. Times are in seconds
    since 1970; `created_from` is included, `created_before` is not.
    """

    text: str | None = None
    state: JobState | None = None
    model: str | None = None  # kind of contact
    protocol: str | None = None  # kind of protocol
    pinned: bool | None = None
    created_from: float | None = None
    created_before: float | None = None
    order: JobOrder = JobOrder.NEWEST

    def where(self, after: Position | None = None) -> tuple[str, list[str | float]]:
        """The WHERE clause of a query of `jobs` for jobs behind `after`, and its parameters."""
        conditions: list[tuple[str, list[str | float]]] = []
        if self.text:
            contained = f"%{_escaped(self.text)}%"
            begins = f"{_escaped(self.text.lower())}%"
            conditions.append(("(name LIKE ? ESCAPE '\\' OR id LIKE ? ESCAPE '\\')", [contained, begins]))
        for sql, value in (
            ("state = ?", self.state),
            ("model = ?", self.model),
            ("protocol = ?", self.protocol),
            ("pinned = ?", self.pinned),
            ("created >= ?", self.created_from),
            ("created < ?", self.created_before),
        ):
            if value is not None:
                conditions.append((sql, [value]))
        if after is not None:
            conditions.append(self._behind(after))
        clause = " AND ".join(sql for sql, _ in conditions)
        return f"WHERE {clause}" if clause else "", [value for _, values in conditions for value in values]

    @property
    def order_by(self) -> str:
        """The ORDER BY clause."""
        column = _COLUMNS[self.order]
        way = "DESC" if column.descending else "ASC"
        return f"ORDER BY seq {way}" if column.sql == "seq" else f"ORDER BY {column.sql} {way}, seq {way}"

    def _behind(self, after: Position) -> tuple[str, list[str | float]]:
        column = _COLUMNS[self.order]
        sign = "<" if column.descending else ">"
        if column.sql == "seq":
            return f"seq {sign} ?", [after.seq]
        return f"({column.sql}, seq) {sign} (?, ?)", [after.value, after.seq]

    def cursor(self, job: JobRecord) -> str:
        """The cursor after a job; opaque to clients."""
        values: dict[JobOrder, str | float] = {
            JobOrder.NAME: job.name,
            JobOrder.FINISHED: job.finished or 0.0,
            JobOrder.LARGEST: job.cells_total,
        }
        if self.order not in values:
            return str(job.seq)
        text = json.dumps([self.order, values[self.order], job.seq], ensure_ascii=False)
        return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")

    def read_cursor(self, text: str) -> Position:
        """The position of a cursor in this order. Raises InvalidCursor for other texts."""
        if _COLUMNS[self.order].sql == "seq":
            if not (text.isascii() and text.isdecimal() and len(text) <= 18):
                raise InvalidCursor(text)
            return Position(int(text), int(text))
        try:
            order, value, seq = json.loads(base64.urlsafe_b64decode(text + "=" * (-len(text) % 4)))
            if isinstance(value, str):
                value.encode()  # raises UnicodeEncodeError for half of a surrogate pair
        except (ValueError, TypeError, RecursionError) as error:
            raise InvalidCursor(text) from error
        is_value = isinstance(value, str) if self.order is JobOrder.NAME else _is_number(value)
        if order != self.order or not is_value or type(seq) is not int or abs(seq) > _MAX:
            raise InvalidCursor(text)
        return Position(value, seq)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) <= _MAX


def _escaped(text: str) -> str:
    """`text` as part of a LIKE pattern."""
    return text.replace("\\", "\\\\").replace("%", "\\%").replace("_", "\\_")
