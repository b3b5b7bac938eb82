"""Jobs and their finished chunks in one SQLite file: the truth about what is done.

WAL and synchronous=FULL: what a transaction has said is on the disk when it returns.
One connection writes and one reads, each behind its lock, so that a poll never waits for a commit.
Only finished chunks have a row; a chunk without one is to be computed.
"""

import fcntl
import json
import sqlite3
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import fields
from pathlib import Path
from typing import IO, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from service.errors import DataFolderBusy, LedgerUnusable
from service.jobs.migrations import MIGRATIONS
from service.jobs.model import UNFINISHED, JobRecord, JobState, NewJob, check_transition
from service.jobs.transactions import ChunkReads, ChunkWrites

Column = str | float | bool | None

#: Rows of the chunks table read at once, so that a huge job does not keep the pollers waiting.
PAGE: Final = 50_000
#: Bytes for the ledger alone, on a disk that is full.
RESERVE: Final = 1 << 18


class Unfinished(NamedTuple):
    """What the supervisor needs to know of a job at every look."""

    id: str
    cancel_requested: bool


class Key(NamedTuple):
    """What an idempotency key was used for."""

    body: str  # the body's fingerprint
    job_id: str


class Pace(NamedTuple):
    """How long the finished chunks of a job took."""

    spec: str
    seconds: float
    cells: int


class ReadTransaction(ChunkReads):
    """Questions to the ledger, on one connection."""

    def find(self, job_id: str) -> JobRecord | None:
        """The job, if there is one."""
        row = self._sql.execute("SELECT * FROM jobs WHERE id = ?", (job_id,)).fetchone()
        return _record(row) if row else None

    def newest(self, state: JobState | None, limit: int, before: int | None = None) -> list[JobRecord]:
        """Jobs, the last accepted first; those accepted before the job of number `before`."""
        found = {"state = ?": state, "seq < ?": before}
        given = {rule: value for rule, value in found.items() if value is not None}
        where = f"WHERE {' AND '.join(given)}" if given else ""
        values = [*given.values(), limit]
        rows = self._sql.execute(f"SELECT * FROM jobs {where} ORDER BY seq DESC LIMIT ?", values)
        return [_record(row) for row in rows]

    def count(self, states: Sequence[JobState]) -> int:
        """Number of jobs in any of `states`."""
        marks = ",".join("?" * len(states))
        row = self._sql.execute(f"SELECT count(*) FROM jobs WHERE state IN ({marks})", states).fetchone()
        return int(row[0])

    def totals(self) -> tuple[int, int]:
        """Chunks and cells done, over all jobs."""
        row = self._sql.execute("SELECT total(chunks_done), total(cells_done) FROM jobs").fetchone()
        return int(row[0]), int(row[1])

    def unfinished(self, limit: int) -> list[Unfinished]:
        """Running jobs, then queued ones, each in the order they were accepted."""
        rows = self._sql.execute(
            "SELECT id, cancel_requested FROM jobs WHERE state IN (?, ?) ORDER BY state = ?, seq LIMIT ?",
            (*UNFINISHED, JobState.QUEUED, limit),
        )
        return [Unfinished(row["id"], bool(row["cancel_requested"])) for row in rows]

    def newest_seq(self) -> int:
        """The number of the last job ever accepted, also if it was deleted; 0 if there was none."""
        row = self._sql.execute("SELECT seq FROM sqlite_sequence WHERE name = 'jobs'").fetchone()
        return int(row[0]) if row else 0

    def key(self, key: str) -> Key | None:
        """What an idempotency key was used for, if it is remembered."""
        row = self._sql.execute(
            "SELECT keys.body, jobs.id FROM keys JOIN jobs ON keys.job = jobs.seq WHERE key = ?", (key,)
        ).fetchone()
        return Key(row["body"], row["id"]) if row else None

    def paces(self, jobs: int, longest: int) -> list[Pace]:
        """What finished chunks took, for each of the last `jobs` whose specification is at most `longest`."""
        rows = self._sql.execute(
            "SELECT spec, sum(seconds) AS seconds, sum(cells) AS cells FROM chunks JOIN ("
            "SELECT seq, spec FROM jobs WHERE chunks_done > 0 AND length(spec) <= ? ORDER BY seq DESC LIMIT ?"
            ") ON job = seq GROUP BY job",
            (longest, jobs),
        )
        return [Pace(row["spec"], row["seconds"], row["cells"]) for row in rows]


class WriteTransaction(ReadTransaction, ChunkWrites):
    """Changes of the ledger, within one transaction."""

    def insert(self, job: NewJob, now: float) -> None:
        """Accept a job."""
        self._sql.execute(
            "INSERT INTO jobs (id, name, spec, kernel_version, chunk_shape, state, created, chunks_total,"
            " cells_total) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (
                job.id, job.name, job.spec, job.kernel_version, json.dumps(job.chunk_shape),
                JobState.QUEUED, now, job.chunks_total, job.cells_total,
            ),
        )  # fmt: skip

    def queue(self, job: JobRecord) -> None:
        """Let a job that ended start again; what is done of it is kept."""
        self._move(job, JobState.QUEUED, error=None, finished=None, cancel_requested=False)
        self._sql.execute("DELETE FROM failures WHERE job = ?", (job.seq,))

    def run(self, job: JobRecord, now: float) -> None:
        """The supervisor picks the job up."""
        if job.state is not JobState.RUNNING:
            check_transition(job.state, JobState.RUNNING)
        self._update(
            job,
            state=JobState.RUNNING,
            started=job.started or now,
            run_started=now,
            run_cells=job.cells_done,
        )

    def finish(self, job: JobRecord, state: JobState, now: float, error: str | None = None) -> None:
        """End the job as done, failed or cancelled."""
        self._move(job, state, finished=now, error=error, cancel_requested=False)

    def choose(self, job: JobRecord, choice: str, chunk_shape: Sequence[int], chunks_total: int) -> None:
        """Note the model chosen for a job that waits, and how it is now cut."""
        self._update(job, choice=choice, chunk_shape=json.dumps(chunk_shape), chunks_total=chunks_total)

    def request_cancel(self, job: JobRecord, wanted: bool) -> None:
        """Note that a running job shall stop, or after all go on."""
        self._update(job, cancel_requested=wanted)

    def delete(self, job: JobRecord) -> None:
        """Forget a job, its chunks and its keys."""
        self._sql.execute("DELETE FROM jobs WHERE seq = ?", (job.seq,))

    def unmark(self, job: JobRecord, chunks: Iterable[int]) -> list[int]:
        """Chunks are to be computed again; a job that was done runs again. Returns which were marked."""
        gone = self.unmark_chunks(job, chunks)
        if gone and job.state is JobState.DONE:
            self._move(job, JobState.RUNNING, finished=None)
        return gone

    def remember_key(self, key: str, body: str, job: JobRecord, now: float) -> None:
        """Remember what an idempotency key was used for."""
        self._sql.execute("INSERT INTO keys VALUES (?, ?, ?, ?)", (key, body, job.seq, now))

    def forget_keys(self, before: float) -> None:
        """Forget the keys that were used before that time."""
        self._sql.execute("DELETE FROM keys WHERE created < ?", (before,))

    def _move(self, job: JobRecord, state: JobState, **columns: Column) -> None:
        check_transition(job.state, state)
        self._update(job, state=state, **columns)

    def _update(self, job: JobRecord, **columns: Column) -> None:
        settings = ", ".join(f"{name} = ?" for name in columns)
        self._sql.execute(f"UPDATE jobs SET {settings} WHERE seq = ?", [*columns.values(), job.seq])


class Ledger:
    """The ledger of one data folder; used by one process at a time.

    Raises DataFolderBusy if another one has it, LedgerUnusable if a newer version wrote it, and SQLite's
    own error where the file is no ledger at all; the folder is let go of then.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._write_lock, self._read_lock = threading.Lock(), threading.Lock()
        self._reserve = path.with_suffix(".reserve")
        with ExitStack() as opened:
            opened.enter_context(_hold(path.with_suffix(".lock")))
            self.keep_reserve()
            self._writer = opened.enter_context(_connected(path))
            self._reader = opened.enter_context(_connected(path))
            _migrate(self._writer)
            self._opened = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and let go of the data folder."""
        with self._write_lock, self._read_lock:
            self._opened.close()

    @contextmanager
    def reading(self) -> Iterator[ReadTransaction]:
        """Ask; never waits for a writer."""
        with self._read_lock:
            yield ReadTransaction(self._reader)

    @contextmanager
    def writing(self) -> Iterator[WriteTransaction]:
        """Change, all or nothing; on the disk when it returns."""
        with self._write_lock:
            self._writer.execute("BEGIN IMMEDIATE")
            try:
                yield WriteTransaction(self._writer)
                self._writer.execute("COMMIT")
            except BaseException as error:
                if self._writer.in_transaction:
                    self._writer.execute("ROLLBACK")
                if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
                    self._reserve.unlink(missing_ok=True)  # so that the next try can say what happened
                raise

    def keep_reserve(self) -> None:
        """Set some room aside, if there is any, for writing down what happened when there is none."""
        if not self._reserve.exists():
            with suppress(OSError), self._reserve.open("wb") as file:
                file.write(bytes(RESERVE))

    def find(self, job_id: str) -> JobRecord | None:
        """The job, if there is one."""
        with self.reading() as ledger:
            return ledger.find(job_id)

    def done_mask(self, job: JobRecord) -> NDArray[np.bool_]:
        """(chunks_total,) which chunks are done; read in pages so that others get their turn."""
        mask = np.zeros(job.chunks_total, np.bool_)
        for first in range(0, job.chunks_total, PAGE):
            with self.reading() as ledger:
                mask[ledger.done_chunks(job, first, first + PAGE)] = True
        return mask


_COLUMNS: Final = frozenset(field.name for field in fields(JobRecord))


def _record(row: sqlite3.Row) -> JobRecord:
    columns = {name: row[name] for name in _COLUMNS}
    columns["state"] = JobState(columns["state"])
    columns["cancel_requested"] = bool(columns["cancel_requested"])
    columns["chunk_shape"] = tuple(json.loads(columns["chunk_shape"]))
    return JobRecord(**columns)


@contextmanager
def _connected(path: Path) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(path, isolation_level=None, check_same_thread=False)) as connection:
        connection.row_factory = sqlite3.Row
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "busy_timeout=10000", "foreign_keys=ON"):
            connection.execute(f"PRAGMA {pragma}")
        yield connection


def _migrate(connection: sqlite3.Connection) -> None:
    """Bring the file to this version, each step whole or not at all."""
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version > len(MIGRATIONS):
        raise LedgerUnusable(
            f"the ledger is of version {version}, this service knows up to {len(MIGRATIONS)}: use a newer one"
        )
    for number, script in enumerate(MIGRATIONS[version:], version + 1):
        connection.executescript(f"BEGIN IMMEDIATE; {script}; PRAGMA user_version = {number}; COMMIT;")


def _hold(path: Path) -> IO[str]:
    """Keep a file locked for as long as it is open; the system lets go when the process dies."""
    file = path.open("w")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        raise DataFolderBusy(f"another service uses the data folder {path.parent}") from error
    return file
