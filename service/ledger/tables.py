"""The ledger's tables."""

from typing import Final

#: SQLite's `user_version` of a ledger with these tables. Development versions before 0.2.0 counted to 13.
VERSION: Final = 14

TABLES: Final = """
    CREATE TABLE jobs (
        seq INTEGER PRIMARY KEY AUTOINCREMENT,
        id TEXT NOT NULL UNIQUE,
        name TEXT NOT NULL,
        spec TEXT NOT NULL,
        kernel_version TEXT NOT NULL,
        chunk_shape TEXT NOT NULL,
        choice TEXT,
        owner TEXT,
        pinned INTEGER NOT NULL DEFAULT 0,
        state TEXT NOT NULL,
        cancel_requested INTEGER NOT NULL DEFAULT 0,
        error TEXT,
        replaced_by TEXT REFERENCES jobs (id) ON DELETE SET NULL,
        created REAL NOT NULL,
        started REAL,
        finished REAL,
        verified REAL,
        run_started REAL,
        run_cells INTEGER NOT NULL DEFAULT 0,
        runs TEXT NOT NULL DEFAULT '[]',
        chunks_done INTEGER NOT NULL DEFAULT 0,
        chunks_total INTEGER NOT NULL,
        cells_done INTEGER NOT NULL DEFAULT 0,
        cells_total INTEGER NOT NULL,
        cells_settling INTEGER NOT NULL DEFAULT 0,
        first_cells INTEGER NOT NULL DEFAULT 0,
        cells_computed INTEGER NOT NULL DEFAULT 0,
        cells_timed INTEGER NOT NULL DEFAULT 0,
        core_seconds REAL NOT NULL DEFAULT 0,
        model TEXT AS (CASE WHEN json_valid(spec) THEN json_extract(spec, '$.model.kind') END) VIRTUAL,
        protocol TEXT AS (CASE WHEN json_valid(spec) THEN json_extract(spec, '$.protocol.kind') END) VIRTUAL
    );
    CREATE INDEX jobs_by_state ON jobs (state, seq);
    CREATE INDEX jobs_by_model ON jobs (model, seq);
    CREATE INDEX jobs_by_protocol ON jobs (protocol, seq);
    CREATE INDEX jobs_by_name ON jobs (name COLLATE NOCASE, seq);
    CREATE INDEX jobs_by_cells ON jobs (cells_total, seq);
    CREATE INDEX jobs_by_end ON jobs (coalesce(finished, 0), seq);
    CREATE INDEX jobs_by_creation ON jobs (created);
    CREATE INDEX jobs_pinned ON jobs (seq) WHERE pinned;

    -- Chunks refer to no job: those of a deleted one are removed a few at a time.
    CREATE TABLE chunks (
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
    CREATE TABLE verified (
        job INTEGER NOT NULL,
        page INTEGER NOT NULL,
        chunks BLOB NOT NULL,
        PRIMARY KEY (job, page)
    ) WITHOUT ROWID;
    CREATE TABLE failures (
        job INTEGER NOT NULL REFERENCES jobs (seq) ON DELETE CASCADE,
        chunk INTEGER NOT NULL,
        place TEXT NOT NULL,
        error TEXT NOT NULL,
        traceback TEXT,
        tries INTEGER NOT NULL,
        PRIMARY KEY (job, chunk)
    ) WITHOUT ROWID;
    CREATE TABLE deletions (
        job TEXT NOT NULL,
        seq INTEGER NOT NULL,
        created REAL NOT NULL,
        step INTEGER NOT NULL DEFAULT 0,
        PRIMARY KEY (job, seq)
    ) WITHOUT ROWID;
    CREATE TABLE keys (
        key TEXT PRIMARY KEY,
        body TEXT NOT NULL,
        job INTEGER NOT NULL REFERENCES jobs (seq) ON DELETE CASCADE,
        created REAL NOT NULL
    ) WITHOUT ROWID;
    CREATE INDEX keys_by_age ON keys (created);
    CREATE INDEX keys_by_job ON keys (job);

    -- What marks the stores as this ledger's, and whether they were marked.
    CREATE TABLE marker (id TEXT NOT NULL, made INTEGER NOT NULL);
    INSERT INTO marker VALUES (lower(hex(randomblob(16))), 0);
"""
