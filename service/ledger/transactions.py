"""Reads and changes of the ledger within one transaction. Only done chunks have a row."""

import json
import sqlite3
import time
from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any, Final, NamedTuple

from kernel.params import KERNEL_VERSION, Outcome
from service.ledger.model import (
    UNFINISHED,
    Failure,
    JobRecord,
    JobState,
    NewJob,
    check_transition,
    summary_of,
)
from service.ledger.search import EVERY_JOB, JobSearch, Position
from service.software import with_this_run
from worker.study import ChunkReport

#: Answers of a result that are kept for each job.
ANSWERS: Final = 16

Column = str | bytes | float | bool | None


class Unfinished(NamedTuple):
    """An unfinished job, as the supervisor reads it at every sync."""

    id: str
    cancel_requested: bool
    seq: int  # numbers jobs in the order they were accepted
    chunks_done: int
    chunks_total: int
    owner: str | None  # the name of the access token that submitted it


class Deletion(NamedTuple):
    """A deleted job whose store is to be removed."""

    id: int
    job: int  # its number
    store: str


class ReadTransaction:
    """Reads the ledger on one connection."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._sql = connection

    def _fetch_all(self, sql: str, *values: Column) -> list[sqlite3.Row]:
        return self._sql.execute(sql, values).fetchall()

    def _fetch_one(self, sql: str, *values: Column) -> Any:
        return self._sql.execute(sql, values).fetchone()

    # Jobs

    def find(self, job_id: str) -> JobRecord | None:
        """The job, if there is one."""
        row = self._fetch_one("SELECT * FROM jobs WHERE id = ?", job_id)
        return _record(row) if row else None

    def search(
        self, search: JobSearch = EVERY_JOB, limit: int = -1, after: Position | None = None
    ) -> list[JobRecord]:
        """The first `limit` jobs of a search after a position, in its order; by default all jobs."""
        where, values = search.where(after)
        sql = f"SELECT * FROM jobs {where} {search.order_by} LIMIT ?"
        return [_record(row) for row in self._fetch_all(sql, *values, limit)]

    def count_found(self, search: JobSearch) -> int:
        """Number of jobs that a search finds."""
        where, values = search.where()
        return int(self._fetch_one(f"SELECT count(*) FROM jobs {where}", *values)[0])

    def count(self, states: Sequence[JobState], owner: str | None = None) -> int:
        """Number of jobs in any of `states`; only those of `owner` if given."""
        sql = f"SELECT count(*) FROM jobs WHERE state IN ({','.join('?' * len(states))})"
        if owner is None:
            return int(self._fetch_one(sql, *states)[0])
        return int(self._fetch_one(f"{sql} AND owner = ?", *states, owner)[0])

    def totals(self) -> tuple[int, int]:
        """Chunks and cells done, over all jobs."""
        chunks, cells = self._fetch_one("SELECT total(chunks_done), total(cells_done) FROM jobs")
        return int(chunks), int(cells)

    def unfinished(self, limit: int) -> list[Unfinished]:
        """Up to `limit` unfinished jobs: running, then queued ones, each in the order they were accepted."""
        sql = (
            "SELECT id, cancel_requested, seq, chunks_done, chunks_total, owner FROM jobs"
            " WHERE state IN (?, ?) ORDER BY state = ?, seq LIMIT ?"
        )
        return [Unfinished(*row) for row in self._fetch_all(sql, *UNFINISHED, JobState.QUEUED, limit)]

    def unfinished_record(self, job: JobRecord) -> JobRecord | None:
        """The job as it is now; None if it has ended, or was deleted, even if it was accepted again."""
        current = self.find(job.id)
        same = current is not None and current.seq == job.seq and current.state in UNFINISHED
        return current if same else None

    def outdated_unfinished(self) -> list[JobRecord]:
        """Queued and running jobs of other kernel versions, in the order they were accepted."""
        sql = "SELECT * FROM jobs WHERE state IN (?, ?) AND kernel_version != ? ORDER BY seq"
        return [_record(row) for row in self._fetch_all(sql, *UNFINISHED, KERNEL_VERSION)]

    def other_versions(self) -> list[str]:
        """The kernel versions of outdated jobs."""
        sql = "SELECT DISTINCT kernel_version FROM jobs WHERE kernel_version != ?"
        return [row[0] for row in self._fetch_all(sql, KERNEL_VERSION)]

    def newest_seq(self) -> int:
        """The number of the last job ever accepted, even if it was deleted; 0 if there was none."""
        row = self._fetch_one("SELECT seq FROM sqlite_sequence WHERE name = 'jobs'")
        return int(row[0]) if row else 0

    def key(self, key: str) -> str | None:
        """The fingerprint of the body with which an idempotency key was used; None if it is not remembered.

        Keys of outdated jobs do not count, because the same request now makes another job.
        """
        sql = "SELECT body FROM keys JOIN jobs ON job = seq WHERE key = ? AND kernel_version = ?"
        row = self._fetch_one(sql, key, KERNEL_VERSION)
        return str(row[0]) if row else None

    def marker(self) -> tuple[str, bool]:
        """The mark of this ledger's stores, and whether they were marked."""
        name, made = self._fetch_one("SELECT id, made FROM marker")
        return str(name), bool(made)

    def stores(self) -> set[str]:
        """The names of all jobs' stores, and of those to be removed."""
        return {row[0] for row in self._fetch_all("SELECT store FROM jobs UNION SELECT store FROM deletions")}

    # Answers

    def answer(self, job: JobRecord, name: str, query: str) -> list[Any] | None:
        """The kept answer of workers for a result of the job; None if there is none."""
        row = self._fetch_one(
            "SELECT parts FROM answers WHERE job = ? AND name = ? AND query = ?", job.seq, name, query
        )
        return None if row is None else json.loads(row[0])

    def sentence(self, job: JobRecord, name: str) -> str | None:
        """The sentence of the last answer kept for a result; None if there is none."""
        row = self._fetch_one(
            "SELECT sentence FROM answers WHERE job = ? AND name = ? ORDER BY id DESC", job.seq, name
        )
        return None if row is None else str(row[0])

    # Deletions

    def deletions(self) -> list[Deletion]:
        """The stores to be removed."""
        return [Deletion(*row) for row in self._fetch_all("SELECT id, job, store FROM deletions ORDER BY id")]

    # Chunks

    def done_chunks(self, job: JobRecord, first: int, last: int) -> list[int]:
        """Indices of the done chunks with first <= index < last."""
        sql = "SELECT chunk FROM chunks WHERE job = ? AND chunk >= ? AND chunk < ?"
        return [row[0] for row in self._fetch_all(sql, job.seq, first, last)]

    def failures(self, job: JobRecord) -> list[Failure]:
        """Chunks given up since the job was last accepted or resumed."""
        sql = "SELECT chunk, place, error, traceback, tries FROM failures WHERE job = ? ORDER BY chunk"
        return [Failure(*row) for row in self._fetch_all(sql, job.seq)]


class WriteTransaction(ReadTransaction):
    """Changes the ledger, within one transaction."""

    def _execute(self, sql: str, *values: Column) -> int:
        """Execute a statement; the number of rows that it has changed."""
        return self._sql.execute(sql, values).rowcount

    # Jobs

    def insert(self, job: NewJob, now: float, store: str | None = None) -> None:
        """Accept a job. Its store has the given name, or one that no other job ever had."""
        columns = {field.name: getattr(job, field.name) for field in fields(NewJob)}
        columns |= {"chunk_shape": json.dumps(job.chunk_shape), "state": JobState.QUEUED, "created": now}
        marks = ", ".join("?" * len(columns))
        self._execute(f"INSERT INTO jobs ({', '.join(columns)}) VALUES ({marks})", *columns.values())
        sql = "UPDATE jobs SET store = coalesce(?, seq || '-' || id || '.zarr') WHERE id = ?"
        self._execute(sql, store, job.id)

    def continue_after(self, seq: int) -> None:
        """Give the next jobs numbers above `seq`, even if this ledger has not counted that far."""
        if seq > self.newest_seq():
            self._execute("DELETE FROM sqlite_sequence WHERE name = 'jobs'")
            self._execute("INSERT INTO sqlite_sequence VALUES ('jobs', ?)", seq)

    def queue(self, job: JobRecord, owner: str | None) -> None:
        """Resume a failed or cancelled job, which then belongs to `owner`. Its done chunks are kept."""
        self._move(job, JobState.QUEUED, error=None, finished=None, cancel_requested=False, owner=owner)
        self._execute("DELETE FROM failures WHERE job = ?", job.seq)

    def run(self, job: JobRecord, now: float, seconds_left: float | None = None) -> None:
        """Start a job, or continue it after a restart of the service. seconds_left: until the job is done."""
        if job.state is not JobState.RUNNING:
            check_transition(job.state, JobState.RUNNING)
        runs, first = with_this_run(job.runs, now), job.started or now
        left = {"progressed": now, "seconds_left": seconds_left}
        self.update(job, state=JobState.RUNNING, started=first, runs=runs, **left)

    def finish(self, job: JobRecord, state: JobState, now: float, error: str | None = None) -> None:
        """End a job as done, failed or cancelled."""
        self._move(job, state, finished=now, error=error, cancel_requested=False)

    def end(self, job: JobRecord, state: JobState, now: float, error: str | None = None) -> bool:
        """End an unfinished job; False if it must continue after all."""
        current = self.unfinished_record(job)
        if current is None:
            return True
        if state is JobState.CANCELLED and not current.cancel_requested:
            return False
        if state is JobState.DONE and current.chunks_done < current.chunks_total:
            return False  # a damaged chunk has just been unmarked
        self.finish(current, state, now, error)
        return True

    def choose(self, job: JobRecord, choice: str, chunk_shape: Sequence[int], chunks_total: int) -> None:
        """Record the model chosen for a queued job, and the job's chunks for that model."""
        self.update(job, choice=choice, chunk_shape=json.dumps(chunk_shape), chunks_total=chunks_total)

    def update(self, job: JobRecord, **columns: Column) -> None:
        """Set columns of a job, without a check of transitions."""
        settings = ", ".join(f"{name} = ?" for name in columns)
        self._execute(f"UPDATE jobs SET {settings} WHERE seq = ?", *columns.values(), job.seq)

    def delete(self, job: JobRecord) -> None:
        """Forget a job, its keys, and its role as a replacement; record that its store must be removed.

        `forget_deletion` forgets its chunks, as there may be a million.
        """
        self._execute("DELETE FROM jobs WHERE seq = ?", job.seq)
        self._execute("INSERT INTO deletions (job, store) VALUES (?, ?)", job.seq, job.store)

    def delete_again(self, job: JobRecord) -> bool:
        """Have the store of a deleted job removed again; False if the job is not deleted."""
        sql = (
            "INSERT INTO deletions (job, store) SELECT ?, ?"
            " WHERE NOT EXISTS (SELECT 1 FROM jobs WHERE seq = ?)"
        )
        return self._execute(sql, job.seq, job.store, job.seq) == 1

    def forget_deletion(self, deletion: Deletion, limit: int) -> bool:
        """Forget at most `limit` chunks of a deleted job, at last its deletion; whether all is forgotten."""
        sql = "DELETE FROM chunks WHERE job = ? AND chunk IN (SELECT chunk FROM chunks WHERE job = ? LIMIT ?)"
        if self._execute(sql, deletion.job, deletion.job, limit) == limit:
            return False
        self._execute("DELETE FROM deletions WHERE id = ?", deletion.id)
        return True

    def remember_key(self, key: str, body: str, job: JobRecord, now: float) -> None:
        """Record the use of an idempotency key."""
        self._execute("INSERT OR REPLACE INTO keys VALUES (?, ?, ?, ?)", key, body, job.seq, now)

    def keep_answer(self, job: JobRecord, name: str, query: str, parts: list[Any], sentence: str) -> None:
        """Keep the answer of workers for a result of the job, and only the last ANSWERS of the result."""
        sql = "INSERT OR REPLACE INTO answers (job, name, query, parts, sentence) VALUES (?, ?, ?, ?, ?)"
        self._execute(sql, job.seq, name, query, json.dumps(parts), sentence)
        last = "SELECT id FROM answers WHERE job = ? AND name = ? ORDER BY id DESC LIMIT ?"
        self._execute(
            f"DELETE FROM answers WHERE job = ? AND name = ? AND id NOT IN ({last})",
            job.seq, name, job.seq, name, ANSWERS,
        )  # fmt: skip

    def note_marked(self) -> None:
        """Record that the stores are marked as this ledger's."""
        self._execute("UPDATE marker SET made = 1")

    def forget_keys(self, before: float) -> None:
        """Forget the keys used before that time, in seconds since 1970."""
        self._execute("DELETE FROM keys WHERE created < ?", before)

    def _move(self, job: JobRecord, state: JobState, **columns: Column) -> None:
        check_transition(job.state, state)
        self.update(job, state=state, **columns)

    def _add(self, job: JobRecord, **counts: float) -> None:
        settings = ", ".join(f"{name} = {name} + ?" for name in counts)
        self._execute(f"UPDATE jobs SET {settings} WHERE seq = ?", *counts.values(), job.seq)

    # Chunks

    def mark_done(
        self, job: JobRecord, reports: Iterable[ChunkReport], seconds_left: float | None = None
    ) -> None:
        """Mark stored chunks as done, unless they are marked. seconds_left: until the job is done."""
        sql = "INSERT OR IGNORE INTO chunks VALUES (?, ?, ?, ?, ?, ?)"
        marked = []
        for report in reports:
            outcomes = json.dumps(report.outcomes, separators=(",", ":"))
            chunk = (report.index, report.cells, report.seconds, outcomes, report.computed)
            if self._execute(sql, job.seq, *chunk):
                marked.append(report)
        self._add(
            job,
            chunks_done=len(marked),
            cells_done=sum(report.cells for report in marked),
            cells_settling=sum(_settling(report.outcomes) for report in marked),
            cells_computed=sum(report.computed or 0 for report in marked),
            core_seconds=sum(report.seconds - report.paused_seconds for report in marked),
        )
        if marked:
            self.update(job, progressed=time.time(), seconds_left=seconds_left)

    def note_paused(self, job: JobRecord, seconds: float) -> None:
        """Add the seconds of slices after which chunks paused."""
        self._add(job, core_seconds=seconds)

    def unmark(self, job: JobRecord, chunks: Iterable[int]) -> list[int]:
        """Unmark chunks to compute them again; a done job then runs again. Returns the unmarked chunks."""
        unmarked = self._unmark(job, chunks)
        if unmarked and job.state is JobState.DONE:
            self._move(job, JobState.RUNNING)  # `finished` shows that it is being repaired
        return unmarked

    def lose(self, job: JobRecord, failures: Sequence[Failure]) -> list[int]:
        """Give up damaged chunks of an outdated job; a done job then fails. Returns the lost chunks."""
        lost = self._unmark(job, [failure.chunk for failure in failures])
        if lost:
            self.note_failures(job, [failure for failure in failures if failure.chunk in lost])
            if job.state is JobState.DONE:
                self._move(job, JobState.FAILED, error=summary_of(self.failures(job)))
        return lost

    def note_failures(self, job: JobRecord, failures: Iterable[Failure]) -> None:
        """Record chunks that were given up."""
        for failure in failures:
            self._execute("INSERT OR REPLACE INTO failures VALUES (?, ?, ?, ?, ?, ?)", job.seq, *failure)

    def _unmark(self, job: JobRecord, chunks: Iterable[int]) -> list[int]:
        """Unmark chunks. Returns those that were marked."""
        sql = "DELETE FROM chunks WHERE job = ? AND chunk = ? RETURNING chunk, cells, outcomes, computed"
        unmarked: list[sqlite3.Row] = []
        for chunk in chunks:
            unmarked += self._fetch_all(sql, job.seq, chunk)
        self._add(
            job,
            chunks_done=-len(unmarked),
            cells_done=-sum(row["cells"] for row in unmarked),
            cells_settling=-sum(_settling(json.loads(row["outcomes"])) for row in unmarked),
            cells_computed=-sum(row["computed"] or 0 for row in unmarked),
        )
        return [row["chunk"] for row in unmarked]


def _settling(outcomes: Sequence[int]) -> int:
    """Number of settling cells, from counts by outcome; some studies have fewer outcomes."""
    return sum(outcomes[Outcome.SETTLING : Outcome.SETTLING + 1])


def _record(row: sqlite3.Row) -> JobRecord:
    columns = {field.name: row[field.name] for field in fields(JobRecord)}
    columns["state"] = JobState(columns["state"])
    columns |= {name: bool(columns[name]) for name in ("cancel_requested", "pinned")}
    columns["chunk_shape"] = tuple(json.loads(columns["chunk_shape"]))
    return JobRecord(**columns)
