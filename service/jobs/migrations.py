"""The ledger's tables, as scripts that bring a file of any older version to this one."""

from typing import Final

#: Script n brings a ledger from version n to n + 1; SQLite's `user_version` counts the scripts that have run.
MIGRATIONS: Final = (
    """
    CREATE TABLE jobs (
        seq INTEGER PRIMARY KEY AUTOINCREMENT,
        id TEXT NOT NULL UNIQUE,
        name TEXT NOT NULL,
        spec TEXT NOT NULL,
        kernel_version TEXT NOT NULL,
        chunk_shape TEXT NOT NULL,
        state TEXT NOT NULL,
        cancel_requested INTEGER NOT NULL DEFAULT 0,
        error TEXT,
        created REAL NOT NULL,
        started REAL,
        finished REAL,
        run_started REAL,
        run_cells INTEGER NOT NULL DEFAULT 0,
        chunks_done INTEGER NOT NULL DEFAULT 0,
        chunks_total INTEGER NOT NULL,
        cells_done INTEGER NOT NULL DEFAULT 0,
        cells_total INTEGER NOT NULL
    );
    CREATE INDEX jobs_by_state ON jobs (state, seq);
    CREATE TABLE chunks (
        job INTEGER NOT NULL REFERENCES jobs (seq) ON DELETE CASCADE,
        chunk INTEGER NOT NULL,
        cells INTEGER NOT NULL,
        seconds REAL NOT NULL,
        checksum TEXT NOT NULL,
        outcomes TEXT NOT NULL,
        PRIMARY KEY (job, chunk)
    ) WITHOUT ROWID;
    """,
    """
    CREATE TABLE keys (
        key TEXT PRIMARY KEY,
        body TEXT NOT NULL,
        job INTEGER NOT NULL REFERENCES jobs (seq) ON DELETE CASCADE,
        created REAL NOT NULL
    ) WITHOUT ROWID;
    CREATE INDEX keys_by_age ON keys (created);
    CREATE INDEX keys_by_job ON keys (job);
    """,
    """
    ALTER TABLE jobs ADD COLUMN choice TEXT;
    """,
    """
    CREATE TABLE failures (
        job INTEGER NOT NULL REFERENCES jobs (seq) ON DELETE CASCADE,
        chunk INTEGER NOT NULL,
        place TEXT NOT NULL,
        error TEXT NOT NULL,
        traceback TEXT,
        tries INTEGER NOT NULL,
        PRIMARY KEY (job, chunk)
    ) WITHOUT ROWID;
    """,
    """
    ALTER TABLE jobs ADD COLUMN replaced_by TEXT REFERENCES jobs (id) ON DELETE SET NULL;
    """,
    """
    ALTER TABLE jobs ADD COLUMN cells_settling INTEGER NOT NULL DEFAULT 0;
    """,
    """
    ALTER TABLE jobs ADD COLUMN owner TEXT;
    """,
    """
    CREATE TABLE deletions (
        job TEXT NOT NULL,
        seq INTEGER NOT NULL,
        created REAL NOT NULL,
        step INTEGER NOT NULL DEFAULT 0,
        PRIMARY KEY (job, seq)
    ) WITHOUT ROWID;
    """,
    """
    ALTER TABLE jobs ADD COLUMN first_cells INTEGER NOT NULL DEFAULT 0;
    ALTER TABLE jobs ADD COLUMN cells_computed INTEGER NOT NULL DEFAULT 0;
    ALTER TABLE chunks ADD COLUMN computed INTEGER;
    """,
    """
    ALTER TABLE jobs ADD COLUMN pinned INTEGER NOT NULL DEFAULT 0;
    ALTER TABLE jobs ADD COLUMN core_seconds REAL NOT NULL DEFAULT 0;
    UPDATE jobs SET core_seconds = (SELECT total(seconds) FROM chunks WHERE job = seq);
    ALTER TABLE jobs ADD COLUMN model TEXT
        AS (CASE WHEN json_valid(spec) THEN json_extract(spec, '$.model.kind') END) VIRTUAL;
    ALTER TABLE jobs ADD COLUMN protocol TEXT
        AS (CASE WHEN json_valid(spec) THEN json_extract(spec, '$.protocol.kind') END) VIRTUAL;
    CREATE INDEX jobs_by_model ON jobs (model, seq);
    CREATE INDEX jobs_by_protocol ON jobs (protocol, seq);
    CREATE INDEX jobs_by_name ON jobs (name COLLATE NOCASE, seq);
    CREATE INDEX jobs_by_cells ON jobs (cells_total, seq);
    CREATE INDEX jobs_by_end ON jobs (coalesce(finished, 0), seq);
    CREATE INDEX jobs_by_creation ON jobs (created);
    CREATE INDEX jobs_pinned ON jobs (seq) WHERE pinned;
    """,
    """
    ALTER TABLE jobs ADD COLUMN runs TEXT NOT NULL DEFAULT '[]';
    """,
    # Chunks no longer refer to jobs, so that those of a deleted job can be removed a few at a time.
    """
    ALTER TABLE jobs ADD COLUMN store_format INTEGER NOT NULL DEFAULT 1;
    ALTER TABLE jobs ADD COLUMN verified REAL;
    ALTER TABLE jobs ADD COLUMN cells_timed INTEGER NOT NULL DEFAULT 0;
    UPDATE jobs SET cells_timed =
        (SELECT coalesce(sum(cells), 0) FROM chunks WHERE job = seq AND chunks.seconds > 0);
    CREATE TABLE compact_chunks (
        job INTEGER NOT NULL,
        chunk INTEGER NOT NULL,
        cells INTEGER NOT NULL,
        seconds REAL NOT NULL,
        checksum BLOB NOT NULL,
        outcomes TEXT NOT NULL,
        computed INTEGER,
        bytes INTEGER,
        PRIMARY KEY (job, chunk)
    ) WITHOUT ROWID;
    INSERT INTO compact_chunks
        SELECT job, chunk, cells, seconds, packed(checksum), replace(outcomes, ' ', ''), computed, NULL
        FROM chunks ORDER BY job, chunk;
    DROP TABLE chunks;
    ALTER TABLE compact_chunks RENAME TO chunks;
    CREATE TABLE verified (
        job INTEGER NOT NULL,
        page INTEGER NOT NULL,
        chunks BLOB NOT NULL,
        PRIMARY KEY (job, page)
    ) WITHOUT ROWID;
    """,
    # What marks the stores as this ledger's, and whether they were marked.
    """
    CREATE TABLE marker (id TEXT NOT NULL, made INTEGER NOT NULL);
    INSERT INTO marker VALUES (lower(hex(randomblob(16))), 0);
    """,
)
