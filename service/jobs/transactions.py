"""What the ledger says of single chunks: which are done, what their bytes should be, which failed.

Only finished chunks have a row; a chunk without one is to be computed.
"""

import json
import sqlite3
from collections.abc import Iterable

from service.jobs.model import DoneChunk, Failure, JobRecord


class ChunkReads:
    """Questions about chunks, on one connection."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._sql = connection

    def done_chunks(self, job: JobRecord, first: int, last: int) -> list[int]:
        """Indices of the finished chunks from `first` up to but without `last`."""
        rows = self._sql.execute(
            "SELECT chunk FROM chunks WHERE job = ? AND chunk >= ? AND chunk < ?", (job.seq, first, last)
        )
        return [row[0] for row in rows]

    def checksums(self, job: JobRecord, after: int, limit: int) -> list[tuple[int, str]]:
        """Finished chunks beyond number `after`, in order, each with what its stored bytes should give."""
        rows = self._sql.execute(
            "SELECT chunk, checksum FROM chunks WHERE job = ? AND chunk > ? ORDER BY chunk LIMIT ?",
            (job.seq, after, limit),
        )
        return [(row[0], row[1]) for row in rows]

    def failures(self, job: JobRecord) -> list[Failure]:
        """Chunks that could not be computed since the job was last started."""
        rows = self._sql.execute(
            "SELECT chunk, place, error, traceback, tries FROM failures WHERE job = ? ORDER BY chunk",
            (job.seq,),
        )
        return [Failure(*row) for row in rows]


class ChunkWrites(ChunkReads):
    """Changes of chunks, within one transaction."""

    def mark_done(self, job: JobRecord, chunks: Iterable[DoneChunk]) -> None:
        """Mark chunks that are written; one that is marked already stays as it is."""
        fresh = [chunk for chunk in chunks if self._insert_chunk(job, chunk)]
        self._sql.execute(
            "UPDATE jobs SET chunks_done = chunks_done + ?, cells_done = cells_done + ? WHERE seq = ?",
            (len(fresh), sum(chunk.cells for chunk in fresh), job.seq),
        )

    def unmark_chunks(self, job: JobRecord, chunks: Iterable[int]) -> list[int]:
        """Chunks are to be computed again. Returns those that were marked."""
        gone = [(chunk, cells) for chunk in chunks for cells in self._delete_chunk(job, chunk)]
        if gone:
            self._sql.execute(
                "UPDATE jobs SET chunks_done = chunks_done - ?, cells_done = cells_done - ? WHERE seq = ?",
                (len(gone), sum(cells for _, cells in gone), job.seq),
            )
        return [chunk for chunk, _ in gone]

    def note_failures(self, job: JobRecord, failures: Iterable[Failure]) -> None:
        """Note chunks that could not be computed."""
        for failure in failures:
            self._sql.execute(
                "INSERT OR REPLACE INTO failures VALUES (?, ?, ?, ?, ?, ?)", (job.seq, *failure)
            )

    def _insert_chunk(self, job: JobRecord, done: DoneChunk) -> bool:
        counts = json.dumps(list(done.outcomes))
        inserted = self._sql.execute(
            "INSERT OR IGNORE INTO chunks VALUES (?, ?, ?, ?, ?, ?)",
            (job.seq, done.chunk, done.cells, done.seconds, done.checksum, counts),
        )
        return inserted.rowcount == 1

    def _delete_chunk(self, job: JobRecord, chunk: int) -> list[int]:
        """The cells of the chunk, if it was marked."""
        rows = self._sql.execute(
            "DELETE FROM chunks WHERE job = ? AND chunk = ? RETURNING cells", (job.seq, chunk)
        )
        return [row[0] for row in rows]
