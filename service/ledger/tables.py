"""The ledger's tables."""

from typing import Final

from service.ledger.model import JobState

#: SQLite's `user_version` of a ledger with these tables.
VERSION: Final = 18

_ANSWERS: Final = """
    -- What workers computed about the results of a job, such as an audit, by the result's name and query.
    CREATE TABLE answers (
        id INTEGER PRIMARY KEY,
        job INTEGER NOT NULL REFERENCES jobs (seq) ON DELETE CASCADE,
        name TEXT NOT NULL,
        query TEXT NOT NULL,
        parts TEXT NOT NULL,
        sentence TEXT NOT NULL,
        UNIQUE (job, name, query)
    );
"""

TABLES: Final = f"""
    {_ANSWERS}
    CREATE TABLE jobs (
        seq INTEGER PRIMARY KEY AUTOINCREMENT,
        id TEXT NOT NULL UNIQUE,
        store TEXT NOT NULL DEFAULT '',
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
        progressed REAL,
        seconds_left REAL,
        runs TEXT NOT NULL DEFAULT '[]',
        chunks_done INTEGER NOT NULL DEFAULT 0,
        chunks_total INTEGER NOT NULL,
        cells_done INTEGER NOT NULL DEFAULT 0,
        cells_total INTEGER NOT NULL,
        cells_settling INTEGER NOT NULL DEFAULT 0,
        first_cells INTEGER NOT NULL DEFAULT 0,
        cells_computed INTEGER NOT NULL DEFAULT 0,
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

    -- Chunks refer to no job: those of a deleted job are removed a few at a time.
    CREATE TABLE chunks (
        job INTEGER NOT NULL,
        chunk INTEGER NOT NULL,
        cells INTEGER NOT NULL,
        seconds REAL NOT NULL,
        outcomes TEXT NOT NULL,
        computed INTEGER,
        PRIMARY KEY (job, chunk)
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
    -- Stores to be removed; the job is forgotten already.
    CREATE TABLE deletions (id INTEGER PRIMARY KEY, job INTEGER NOT NULL, store TEXT NOT NULL);
    CREATE TABLE keys (
        key TEXT PRIMARY KEY,
        body TEXT NOT NULL,
        job INTEGER NOT NULL REFERENCES jobs (seq) ON DELETE CASCADE,
        created REAL NOT NULL
    ) WITHOUT ROWID;
    CREATE INDEX keys_by_age ON keys (created);
    CREATE INDEX keys_by_job ON keys (job);

    -- The mark of this ledger's stores, and whether they were marked.
    CREATE TABLE marker (id TEXT NOT NULL, made INTEGER NOT NULL);
    INSERT INTO marker VALUES (lower(hex(randomblob(16))), 0);
"""

#: The version of the tables of 0.2.0.
RELEASED: Final = 14
#: The statements that turn them into these. Stores were named by the job's id alone, so that a job waited
#: until a deleted one's store was renamed.
UPGRADE: Final = f"""
    ALTER TABLE jobs ADD COLUMN store TEXT NOT NULL DEFAULT '';
    UPDATE jobs SET store = CASE
        WHEN id IN (SELECT job FROM deletions WHERE step = 0) THEN seq || '-' || id ELSE id END || '.zarr';
    ALTER TABLE jobs DROP COLUMN verified;
    ALTER TABLE chunks DROP COLUMN checksum;
    ALTER TABLE chunks DROP COLUMN bytes;
    DROP TABLE verified;
    ALTER TABLE deletions RENAME TO earlier;
    CREATE TABLE deletions (id INTEGER PRIMARY KEY, job INTEGER NOT NULL, store TEXT NOT NULL);
    INSERT INTO deletions (job, store)
        SELECT seq, job || '.zarr' || iif(step, '.deleted-' || seq, '') FROM earlier WHERE step < 2;
    DROP TABLE earlier;
    ALTER TABLE jobs ADD COLUMN progressed REAL;
    ALTER TABLE jobs ADD COLUMN seconds_left REAL;
    ALTER TABLE jobs DROP COLUMN run_started;
    ALTER TABLE jobs DROP COLUMN run_cells;
    ALTER TABLE jobs DROP COLUMN cells_timed;
    {_ANSWERS}
"""

#: The rule of each column of a job, which SQLite does not enforce: a list of jobs reads all columns. Whether
#: the specification belongs to the id takes longer to check, when the job is prepared.
_COLUMNS: Final = {
    "id": f"id GLOB '{'[0-9a-f]' * 32}'",
    "store": "store = id || '.zarr' OR ltrim(store, '0123456789') = '-' || id || '.zarr'",
    "spec": "json_valid(spec) AND json_type(spec) = 'object'",
    "choice": "choice IS NULL OR json_valid(choice) AND json_type(choice, '$.model') = 'text'",
    "state": f"state IN {tuple(map(str, JobState))}",
} | {
    column: rule.format(column)
    for rule, columns in {
        "typeof({0}) = 'text'": "name kernel_version",
        "json_valid({0}) AND json_type({0}) = 'array'": "chunk_shape runs",
        "coalesce({0}, 0) BETWEEN 0 AND 1e10": "created started finished progressed",
        "coalesce({0}, 0) BETWEEN -1e300 AND 1e300": "core_seconds seconds_left",
        "typeof({0}) = 'integer' AND {0} >= 0": "chunks_total cells_total cells_done cells_settling"
        " cells_computed first_cells",
    }.items()
    for column in columns.split()
}
_WRONG: Final = " ".join(
    f"WHEN ({rule}) IS NOT TRUE THEN '{column} ' || substr(quote({column}), 1, 80)"
    for column, rule in _COLUMNS.items()
)

#: Queries for rows that no service writes; each returns what is wrong, or NULL.
_ROWS: Final = (
    "SELECT 'has no mark of its stores' WHERE (SELECT count(*) FROM marker) != 1",
    "SELECT 'deletes ' || quote(store) || ', not the store of a deleted job' FROM deletions WHERE"
    " (store GLOB '?*.zarr*' AND store NOT GLOB '*/*') IS NOT TRUE OR store IN (SELECT store FROM jobs)",
    # reads all text, because text that is not UTF-8 is an error
    f"SELECT 'is damaged: job ' || id || ' cannot have the ' || CASE {_WRONG} END,"
    " name, spec, kernel_version, choice, owner, error, replaced_by, runs FROM jobs",
)
#: Not `quick_check`: with a log of another copy, indices can name rows missing from the tables.
_INTEGRITY: Final = (
    "SELECT 'is damaged (' || replace(integrity_check, char(10), ' ') || ')' FROM pragma_integrity_check(1)"
    " WHERE integrity_check != 'ok'"
)
_CONTRADICTION: Final = """
    SELECT 'contradicts itself: job ' || id || ' counts ' || chunks_done || ' chunks and has ' || counted
        || ', as with the write-ahead log of another copy' FROM (
        SELECT id, chunks_done, (SELECT count(*) FROM chunks WHERE job = seq) AS counted FROM jobs
    ) WHERE chunks_done != counted LIMIT 1
"""


def faults(version: int) -> tuple[str, ...]:
    """The queries for faults of a ledger of a version, quickest first; 0: it has no tables."""
    return (*(_ROWS if version == VERSION else ()), _INTEGRITY, *((_CONTRADICTION,) if version else ()))
