"""Everything a person running the service may set, from `BOUNCE_*` variables or options of the same names."""

from pathlib import Path
from typing import Annotated

from pydantic import Field, PositiveFloat, PositiveInt
from pydantic_settings import BaseSettings, SettingsConfigDict

Port = Annotated[int, Field(ge=0, le=65535)]


class Settings(BaseSettings):
    """Where to listen, where to keep data, where to compute, and how much one request may ask for."""

    model_config = SettingsConfigDict(env_prefix="BOUNCE_", frozen=True, extra="forbid")

    host: str = "127.0.0.1"
    port: Port = 8000  # 0: any free port
    data: Path = Path("bounce-data")

    workers: PositiveInt = 2  # processes of the embedded cluster; unused with a scheduler
    scheduler: str | None = None  # address of a Dask scheduler
    scheduler_file: Path | None = None  # written by `dask scheduler --scheduler-file`

    max_body_bytes: PositiveInt = 1_000_000
    body_seconds: PositiveFloat = 10.0  # for a request's body to arrive
    max_cells: PositiveInt = 20_000_000  # of one sweep
    max_bytes: PositiveInt = 32 * 2**30  # of one sweep's stored arrays before compression
    max_queue: PositiveInt = 1_000  # jobs queued or running
    key_seconds: PositiveFloat = 24 * 3600.0  # for which an Idempotency-Key is remembered
    max_points: PositiveInt = 1_000_000  # flights, or cells of a map, in one answer

    max_export_bytes: PositiveInt = 2 * 2**30  # of the sweep behind one file
    max_exports: PositiveInt = 2  # files being written at a time
    max_trajectories: PositiveInt = 2  # being computed at a time
    trajectory_seconds: PositiveFloat = 5.0  # of computing for one of them
    max_listeners: PositiveInt = 1_000  # to events

    active_jobs: PositiveInt = 32  # jobs whose plans are held in memory; the rest stay queued
    window: PositiveInt = 2  # chunks in flight per worker and job
    chunk_tries: PositiveInt = 3  # for a chunk that fails, or whose worker dies of it
    chunk_seconds: PositiveFloat = 60.0  # that any chunk may take before its worker is replaced
    chunk_slack: PositiveFloat = 30.0  # times what the plan says, that a long one may take
    worker_memory: PositiveInt | None = (
        None  # bytes, of an embedded worker; its share of the machine's if unset
    )
    failed_chunks: PositiveInt = 8  # after so many a job submits no more
    heartbeat_seconds: PositiveFloat = 2.0  # how often the supervisor looks round with nothing to wake it
    shutdown_seconds: PositiveFloat = 5.0  # for requests under way to finish

    @property
    def ledger_path(self) -> Path:
        """The SQLite file that says what is done."""
        return self.data / "ledger.sqlite"

    @property
    def exports_path(self) -> Path:
        """Where files lie while they are written."""
        return self.data.absolute() / "exports"

    def store_of(self, job_id: str) -> str:
        """Where a job's zarr store is."""
        return str(self.data.absolute() / "stores" / f"{job_id}.zarr")
