"""Reads and changes of the ledger within one transaction.

Only done chunks have a row; a chunk without one is to be computed.
"""

import json
import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import fields
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.params import KERNEL_VERSION, Outcome
from service.jobs.model import (
    UNFINISHED,
    Failure,
    JobRecord,
    JobState,
    NewJob,
    check_transition,
    summary_of,
)
from service.jobs.search import JobSearch, Position
from service.software import with_this_run
from worker.tasks import ChunkReport

#: Chunks whose verification is recorded together.
VERIFIED_PAGE: Final = 512

Column = str | float | bool | None


class Unfinished(NamedTuple):
    """What the supervisor reads about an unfinished job at every sync."""

    id: str
    cancel_requested: bool
    seq: int  # numbers jobs in the order they were accepted
    chunks_done: int
    chunks_total: int
    owner: str | None  # the name of the access token that submitted it


class DeletionStep(IntEnum):
    """Progress of a deletion."""

    RECORDED = 0  # the job is forgotten, its results are in place
    FREED = 1  # the job's address is free: the same study may be stored there again
    COMPLETE = 2  # all is removed; kept until the next start of the service


class Deletion(NamedTuple):
    """A deleted job whose stored results are not all removed."""

    job_id: str
    seq: int  # the job's
    created: float  # when it was deleted, in seconds since 1970
    step: DeletionStep


class Key(NamedTuple):
    """The use of an idempotency key."""

    body: str  # the body's fingerprint
    job_id: str


class StoredChunk(NamedTuple):
    """The ledger's record of a done chunk's stored bytes."""

    number: int
    checksum: str
    size: int | None  # of all arrays, in bytes; None if unknown


class Pace(NamedTuple):
    """Time taken by the done chunks of a job."""

    job: JobRecord
    seconds: float
    cells: int


class ReadTransaction:
    """Reads the ledger on one connection."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._sql = connection

    # Jobs

    def find(self, job_id: str) -> JobRecord | None:
        """The job, if there is one."""
        row = self._sql.execute("SELECT * FROM jobs WHERE id = ?", (job_id,)).fetchone()
        return _record(row) if row else None

    def newest(self, state: JobState | None, limit: int, before: int | None = None) -> list[JobRecord]:
        """Jobs, the last accepted first; only those in `state` and with a `seq` below `before`."""
        after = None if before is None else Position(before, before)
        return self.search(JobSearch(state=state), limit, after)

    def search(self, search: JobSearch, limit: int, after: Position | None = None) -> list[JobRecord]:
        """The first `limit` jobs of a search behind a position, in its order."""
        where, values = search.where(after)
        rows = self._sql.execute(f"SELECT * FROM jobs {where} {search.order_by} LIMIT ?", [*values, limit])
        return [_record(row) for row in rows]

    def count_found(self, search: JobSearch) -> int:
        """Number of jobs that a search finds."""
        where, values = search.where()
        return int(self._sql.execute(f"SELECT count(*) FROM jobs {where}", values).fetchone()[0])

    def count(self, states: Sequence[JobState], owner: str | None = None) -> int:
        """Number of jobs in any of `states`; only those of `owner` if given."""
        where = f"state IN ({','.join('?' * len(states))})"
        values: list[str] = [*states]
        if owner is not None:
            where, values = f"{where} AND owner = ?", [*values, owner]
        row = self._sql.execute(f"SELECT count(*) FROM jobs WHERE {where}", values).fetchone()
        return int(row[0])

    def totals(self) -> tuple[int, int]:
        """Chunks and cells done, over all jobs."""
        row = self._sql.execute("SELECT total(chunks_done), total(cells_done) FROM jobs").fetchone()
        return int(row[0]), int(row[1])

    def unfinished(self, limit: int) -> list[Unfinished]:
        """Running jobs, then queued ones, each in the order they were accepted."""
        rows = self._sql.execute(
            "SELECT id, cancel_requested, seq, chunks_done, chunks_total, owner FROM jobs"
            " WHERE state IN (?, ?) ORDER BY state = ?, seq LIMIT ?",
            (*UNFINISHED, JobState.QUEUED, limit),
        )
        return [Unfinished(row[0], bool(row[1]), *row[2:]) for row in rows]

    def outdated_unfinished(self) -> list[JobRecord]:
        """Queued and running jobs of other kernel versions, in the order they were accepted."""
        rows = self._sql.execute(
            "SELECT * FROM jobs WHERE state IN (?, ?) AND kernel_version != ? ORDER BY seq",
            (*UNFINISHED, KERNEL_VERSION),
        )
        return [_record(row) for row in rows]

    def other_versions(self) -> list[str]:
        """The kernel versions of outdated jobs."""
        rows = self._sql.execute(
            "SELECT DISTINCT kernel_version FROM jobs WHERE kernel_version != ?", (KERNEL_VERSION,)
        )
        return [row[0] for row in rows]

    def newest_seq(self) -> int:
        """The number of the last job ever accepted, deleted ones included; 0 if there was none."""
        row = self._sql.execute("SELECT seq FROM sqlite_sequence WHERE name = 'jobs'").fetchone()
        return int(row[0]) if row else 0

    def key(self, key: str) -> Key | None:
        """The use of an idempotency key, if it is remembered.

        Keys of outdated jobs do not count: the same request now makes another job.
        """
        row = self._sql.execute(
            "SELECT keys.body, jobs.id FROM keys JOIN jobs ON keys.job = jobs.seq"
            " WHERE key = ? AND kernel_version = ?",
            (key, KERNEL_VERSION),
        ).fetchone()
        return Key(row["body"], row["id"]) if row else None

    def paces(self, jobs: int, max_spec_chars: int) -> list[Pace]:
        """Times of done chunks, for each of the last `jobs` with a specification of limited length.

        Only for this release's kernel, as versions differ in speed. Times of adopted chunks are
        unknown.
        """
        rows = self._sql.execute(
            "SELECT * FROM jobs WHERE chunks_done > 0 AND length(spec) <= ? AND kernel_version = ?"
            " ORDER BY seq DESC LIMIT ?",
            (max_spec_chars, KERNEL_VERSION, jobs),
        )
        return [
            Pace(_record(row), row["core_seconds"], row["cells_timed"]) for row in rows if row["cells_timed"]
        ]

    def marker(self) -> tuple[str, bool]:
        """The mark of this ledger's stores, and whether they were marked."""
        row = self._sql.execute("SELECT id, made FROM marker").fetchone()
        return str(row["id"]), bool(row["made"])

    def ids(self) -> set[str]:
        """The ids of all jobs."""
        return {row[0] for row in self._sql.execute("SELECT id FROM jobs")}

    # Deletions

    def deletions(self) -> list[Deletion]:
        """The deletions that are not complete, in the order they were recorded."""
        rows = self._sql.execute(
            "SELECT job, seq, created, step FROM deletions WHERE step < ? ORDER BY created, seq",
            (DeletionStep.COMPLETE,),
        )
        return [Deletion(row["job"], row["seq"], row["created"], DeletionStep(row["step"])) for row in rows]

    def is_occupied(self, job_id: str) -> bool:
        """Whether a deleted job's results must still be removed from this job's address."""
        row = self._sql.execute(
            "SELECT 1 FROM deletions WHERE job = ? AND step = ?", (job_id, DeletionStep.RECORDED)
        ).fetchone()
        return row is not None

    # Chunks

    def done_chunks(self, job: JobRecord, first: int, last: int) -> list[int]:
        """Indices of the done chunks with first <= index < last."""
        rows = self._sql.execute(
            "SELECT chunk FROM chunks WHERE job = ? AND chunk >= ? AND chunk < ?", (job.seq, first, last)
        )
        return [row[0] for row in rows]

    def stored_chunks(self, job: JobRecord, first: int, last: int) -> list[StoredChunk]:
        """Done chunks with first <= index < last, in order, and the stored bytes of each."""
        rows = self._sql.execute(
            "SELECT chunk, checksum, bytes FROM chunks WHERE job = ? AND chunk >= ? AND chunk < ?"
            " ORDER BY chunk",
            (job.seq, first, last),
        )
        return [StoredChunk(row[0], row[1].hex(), row[2]) for row in rows]

    def verified_chunks(self, job: JobRecord, page: int) -> NDArray[np.bool_]:
        """(VERIFIED_PAGE,) which chunks of a page of the job were verified since they were marked."""
        row = self._sql.execute(
            "SELECT chunks FROM verified WHERE job = ? AND page = ?", (job.seq, page)
        ).fetchone()
        if row is None:
            return np.zeros(VERIFIED_PAGE, np.bool_)
        return np.unpackbits(np.frombuffer(row[0], np.uint8)).astype(np.bool_)

    def failures(self, job: JobRecord) -> list[Failure]:
        """Chunks given up since the job was last accepted or resumed."""
        rows = self._sql.execute(
            "SELECT chunk, place, error, traceback, tries FROM failures WHERE job = ? ORDER BY chunk",
            (job.seq,),
        )
        return [Failure(*row) for row in rows]


class WriteTransaction(ReadTransaction):
    """Changes the ledger, within one transaction."""

    # Jobs

    def insert(self, job: NewJob, now: float) -> None:
        """Accept a job."""
        self._sql.execute(
            "INSERT INTO jobs (id, name, spec, kernel_version, chunk_shape, state, created, chunks_total,"
            " cells_total, first_cells, owner) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (
                job.id, job.name, job.spec, job.kernel_version, json.dumps(job.chunk_shape),
                JobState.QUEUED, now, job.chunks_total, job.cells_total, job.first_cells, job.owner,
            ),
        )  # fmt: skip

    def queue(self, job: JobRecord, owner: str | None) -> None:
        """Resume a failed or cancelled job, which then belongs to `owner`; its done chunks are kept."""
        self._move(job, JobState.QUEUED, error=None, finished=None, cancel_requested=False, owner=owner)
        self._sql.execute("DELETE FROM failures WHERE job = ?", (job.seq,))

    def run(self, job: JobRecord, now: float) -> None:
        """Start the job, or continue it after a restart of the service."""
        if job.state is not JobState.RUNNING:
            check_transition(job.state, JobState.RUNNING)
        self._update(
            job,
            state=JobState.RUNNING,
            started=job.started or now,
            run_started=now,
            run_cells=job.cells_done,
            runs=with_this_run(job.runs, now),
        )

    def finish(self, job: JobRecord, state: JobState, now: float, error: str | None = None) -> None:
        """End the job as done, failed or cancelled."""
        self._move(job, state, finished=now, error=error, cancel_requested=False)

    def choose(self, job: JobRecord, choice: str, chunk_shape: Sequence[int], chunks_total: int) -> None:
        """Record the model chosen for a queued job, and the job's chunks for that model."""
        self._update(job, choice=choice, chunk_shape=json.dumps(chunk_shape), chunks_total=chunks_total)

    def set_cancel_requested(self, job: JobRecord, cancel_requested: bool) -> None:
        """Request a running job to stop, or revoke the request."""
        self._update(job, cancel_requested=cancel_requested)

    def pin(self, job: JobRecord, pinned: bool) -> None:
        """Pin a job, or unpin it."""
        self._update(job, pinned=pinned)

    def replace(self, job: JobRecord, successor: str) -> None:
        """Record the job that computes an outdated job's study anew."""
        self._update(job, replaced_by=successor)

    def adopt(
        self, job: NewJob, reports: Sequence[ChunkReport], choice: str | None, now: float, error: str
    ) -> None:
        """Insert a job with stored results: done if `reports` has every chunk, else failed."""
        self.insert(job, now)
        complete = len(reports) == job.chunks_total
        self._sql.execute(
            "UPDATE jobs SET state = ?, started = ?, finished = ?, choice = ?, error = ? WHERE id = ?",
            (
                JobState.DONE if complete else JobState.FAILED, now, now, choice,
                None if complete else error, job.id,
            ),
        )  # fmt: skip
        record = self.find(job.id)
        if record is not None:
            self.mark_done(record, reports)

    def delete(self, job: JobRecord, now: float) -> None:
        """Forget a job, its keys, and its role as a replacement; record that its store must be removed.

        Its chunks are forgotten later, see `forget_chunks`: there may be a million.
        """
        self._sql.execute("DELETE FROM jobs WHERE seq = ?", (job.seq,))
        self._sql.execute(
            "INSERT OR REPLACE INTO deletions VALUES (?, ?, ?, ?)",
            (job.id, job.seq, now, DeletionStep.RECORDED),
        )

    def repeat_deletion(self, job: JobRecord, now: float) -> bool:
        """Remove a deleted job's results once more; False if no deletion of this job is recorded."""
        updated = self._sql.execute(
            "UPDATE deletions SET created = ?, step = ? WHERE job = ? AND seq = ?",
            (now, DeletionStep.RECORDED, job.id, job.seq),
        )
        return updated.rowcount == 1

    def advance_deletion(self, deletion: Deletion, step: DeletionStep) -> None:
        """Record the progress of a deletion, unless it was repeated meanwhile."""
        self._sql.execute(
            "UPDATE deletions SET step = ? WHERE job = ? AND seq = ? AND created = ?",
            (step, deletion.job_id, deletion.seq, deletion.created),
        )

    def forget_deletions(self, step: DeletionStep = DeletionStep.RECORDED) -> int:
        """Forget the deletions that have reached `step`, by default all; returns their number."""
        return self._sql.execute("DELETE FROM deletions WHERE step >= ?", (step,)).rowcount

    def forget_chunks(self, seq: int, limit: int) -> int:
        """Forget at most `limit` chunks of a deleted job; returns their number, 0 if none was left."""
        forgotten = self._sql.execute(
            "DELETE FROM chunks WHERE job = ? AND chunk IN (SELECT chunk FROM chunks WHERE job = ? LIMIT ?)",
            (seq, seq, limit),
        ).rowcount
        if not forgotten:
            self._sql.execute("DELETE FROM verified WHERE job = ?", (seq,))
        return forgotten

    def remember_key(self, key: str, body: str, job: JobRecord, now: float) -> None:
        """Record the use of an idempotency key."""
        self._sql.execute("INSERT OR REPLACE INTO keys VALUES (?, ?, ?, ?)", (key, body, job.seq, now))

    def note_marked(self) -> None:
        """Record that the stores are marked as this ledger's."""
        self._sql.execute("UPDATE marker SET made = 1")

    def forget_keys(self, before: float) -> None:
        """Forget the keys used before that time, in seconds since 1970."""
        self._sql.execute("DELETE FROM keys WHERE created < ?", (before,))

    def _move(self, job: JobRecord, state: JobState, **columns: Column) -> None:
        check_transition(job.state, state)
        self._update(job, state=state, **columns)

    def _update(self, job: JobRecord, **columns: Column) -> None:
        settings = ", ".join(f"{name} = ?" for name in columns)
        self._sql.execute(f"UPDATE jobs SET {settings} WHERE seq = ?", [*columns.values(), job.seq])

    # Chunks

    def mark_done(self, job: JobRecord, reports: Iterable[ChunkReport]) -> None:
        """Mark stored chunks as done; marked ones stay as they are."""
        marked = [report for report in reports if self._insert_chunk(job, report)]
        self._sql.execute(
            "UPDATE jobs SET chunks_done = chunks_done + ?, cells_done = cells_done + ?,"
            " cells_settling = cells_settling + ?, cells_computed = cells_computed + ?,"
            " core_seconds = core_seconds + ?, cells_timed = cells_timed + ? WHERE seq = ?",
            (
                len(marked),
                sum(report.cells for report in marked),
                sum(_settling(report.outcomes) for report in marked),
                sum(report.computed or 0 for report in marked),
                sum(report.seconds for report in marked),
                sum(report.cells for report in marked if report.seconds > 0),
                job.seq,
            ),
        )

    def unmark(self, job: JobRecord, chunks: Iterable[int]) -> list[int]:
        """Unmark chunks to compute them again; a done job runs again. Returns those that were marked."""
        unmarked = self._unmark(job, chunks)
        if unmarked and job.state is JobState.DONE:
            self._move(job, JobState.RUNNING)  # `finished` shows that it is being repaired
        return unmarked

    def lose(self, job: JobRecord, failures: Sequence[Failure]) -> list[int]:
        """Give up damaged chunks of an outdated job, never to be computed again; a done job becomes failed.

        Returns those that were marked.
        """
        lost = self._unmark(job, [failure.chunk for failure in failures])
        if lost:
            self.note_failures(job, [failure for failure in failures if failure.chunk in lost])
            if job.state is JobState.DONE:
                self._move(job, JobState.FAILED, error=summary_of(self.failures(job)))
        return lost

    def note_verified(self, job: JobRecord, page: int, verified: NDArray[np.bool_]) -> None:
        """Record which chunks of a page were verified. `verified`: as from `verified_chunks`."""
        self._sql.execute(
            "INSERT OR REPLACE INTO verified VALUES (?, ?, ?)",
            (job.seq, page, np.packbits(verified).tobytes()),
        )

    def finish_verification(self, job: JobRecord, now: float) -> None:
        """Record that all chunks of a job have been verified."""
        self._update(job, verified=now)

    def forget_verification(self, job: JobRecord) -> None:
        """Mark all chunks of a job as unverified."""
        self._sql.execute("DELETE FROM verified WHERE job = ?", (job.seq,))
        self._update(job, verified=None)

    def note_failures(self, job: JobRecord, failures: Iterable[Failure]) -> None:
        """Record chunks that were given up."""
        for failure in failures:
            self._sql.execute(
                "INSERT OR REPLACE INTO failures VALUES (?, ?, ?, ?, ?, ?)", (job.seq, *failure)
            )

    def _insert_chunk(self, job: JobRecord, report: ChunkReport) -> bool:
        """Insert a chunk; whether it was not marked before."""
        outcomes = json.dumps(list(report.outcomes), separators=(",", ":"))
        inserted = self._sql.execute(
            "INSERT OR IGNORE INTO chunks VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (
                job.seq, report.index, report.cells, report.seconds, bytes.fromhex(report.checksum), outcomes,
                report.computed, report.bytes,
            ),
        )  # fmt: skip
        return inserted.rowcount == 1

    def _unmark(self, job: JobRecord, chunks: Iterable[int]) -> list[int]:
        """Unmark chunks; returns those that were marked."""
        unmarked = [row for chunk in chunks for row in self._delete_chunk(job, chunk)]
        self._sql.execute(
            "UPDATE jobs SET chunks_done = chunks_done - ?, cells_done = cells_done - ?,"
            " cells_settling = cells_settling - ?, cells_computed = cells_computed - ? WHERE seq = ?",
            (
                len(unmarked),
                sum(row["cells"] for row in unmarked),
                sum(_settling(json.loads(row["outcomes"])) for row in unmarked),
                sum(row["computed"] or 0 for row in unmarked),
                job.seq,
            ),
        )
        return [row["chunk"] for row in unmarked]

    def _delete_chunk(self, job: JobRecord, chunk: int) -> list[sqlite3.Row]:
        """Remove a chunk, also from the verified ones; returns its cells and outcomes if it was marked."""
        self._sql.execute(
            "DELETE FROM verified WHERE job = ? AND page = ?", (job.seq, chunk // VERIFIED_PAGE)
        )
        return self._sql.execute(
            "DELETE FROM chunks WHERE job = ? AND chunk = ? RETURNING chunk, cells, outcomes, computed",
            (job.seq, chunk),
        ).fetchall()


def _settling(outcomes: Sequence[int]) -> int:
    """Number of settling cells among those counted by outcome; another kernel may know fewer outcomes."""
    return outcomes[Outcome.SETTLING] if len(outcomes) > Outcome.SETTLING else 0


_COLUMNS: Final = frozenset(field.name for field in fields(JobRecord))


def _record(row: sqlite3.Row) -> JobRecord:
    columns = {name: row[name] for name in _COLUMNS}
    columns["state"] = JobState(columns["state"])
    columns |= {name: bool(columns[name]) for name in ("cancel_requested", "pinned")}
    columns["chunk_shape"] = tuple(json.loads(columns["chunk_shape"]))
    return JobRecord(**columns)
