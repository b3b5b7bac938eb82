"""Everything a person running the service may set, from `BOUNCE_*` variables or options of the same names."""

from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import (
    Field,
    SecretStr,
    field_validator,
    model_validator,
)
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from worker import store

Port = Annotated[int, Field(ge=0, le=65535)]
#: As much as the system's clocks and SQLite can count.
Positive = Annotated[float, Field(gt=0, le=1e9)]
Count = Annotated[int, Field(ge=1, le=2**62)]

#: Names under which this machine reaches itself.
LOOPBACK_NAMES: Final = frozenset({"localhost", "127.0.0.1", "::1"})

#: Fewer characters can be guessed.
SHORTEST_TOKEN: Final = 16


class Settings(BaseSettings):
    """Where to listen, where to keep data, where to compute, and how much one request may ask for."""

    model_config = SettingsConfigDict(env_prefix="BOUNCE_", frozen=True, extra="forbid")

    host: str = "127.0.0.1"
    port: Port = 8000  # 0: any free port
    token: SecretStr | None = None  # what callers must know; needed to listen on more than loopback
    allowed_hosts: Annotated[frozenset[str], NoDecode] = frozenset()  # more names to answer to; *: any
    log_level: Literal["debug", "info", "warning", "error"] = "info"

    data: Path = Path("bounce-data")
    stores: str | None = None  # folder, or s3://BUCKET/PREFIX, of the stores; data/stores if left out

    workers: Count = 2  # processes of the embedded cluster; unused with a scheduler
    scheduler: str | None = None  # address of a Dask scheduler
    scheduler_file: Path | None = None  # written by `dask scheduler --scheduler-file`
    cluster: Annotated[str, Field(pattern=r"^[\w.]+:\w+$")] | None = None  # module:function that makes one
    scheduler_ca: Path | None = None  # TLS to the scheduler (tls://...): who vouches for it,
    scheduler_cert: Path | None = None  # and what we show it
    scheduler_key: Path | None = None

    max_body_bytes: Count = 1_000_000
    body_seconds: Positive = 10.0  # for a request's head to arrive, and for its body
    max_cells: Count = 20_000_000  # of one sweep
    max_bytes: Count = 32 * 2**30  # of one sweep's stored arrays before compression
    max_queue: Count = 1_000  # jobs queued or running
    max_points: Count = 1_000_000  # flights, or cells of a map, in one answer
    max_export_bytes: Count = 2 * 2**30  # of the sweep behind one file
    max_exports: Count = 2  # files being written at a time
    max_trajectories: Count = 2  # being computed at a time
    trajectory_seconds: Positive = 5.0  # of computing for one of them
    max_listeners: Count = 1_000  # to events
    key_seconds: Positive = 24 * 3600.0  # for which an Idempotency-Key is remembered

    active_jobs: Count = 32  # jobs whose plans are held in memory; the rest stay queued
    window: Count = 2  # chunks in flight per worker and job, or more if they are small:
    window_seconds: Annotated[float, Field(ge=0, le=1e9)] = 0.5  # of work in flight per worker and job
    chunk_tries: Count = 3  # for a chunk that fails, or whose worker dies of it
    chunk_seconds: Positive = 60.0  # that any chunk may take before its worker is replaced
    chunk_slack: Positive = 300.0  # times what the plan says: a cell may cost 150 times the usual
    worker_memory: Count | None = None  # bytes, of an embedded worker; its share of the machine's if unset
    failed_chunks: Count = 8  # after so many a job submits no more
    heartbeat_seconds: Positive = 2.0  # how often the supervisor looks round with nothing to wake it
    shutdown_seconds: Positive = 2.0  # for requests under way to finish

    @field_validator("allowed_hosts", mode="before")
    @classmethod
    def _names(cls, given: Any) -> Any:
        """A text is names with commas between, as a variable of the environment has to be."""
        names = given.split(",") if isinstance(given, str) else given
        return frozenset(str(name).strip().lower() for name in names) - {""}

    @field_validator("stores")
    @classmethod
    def _place(cls, given: str | None) -> str | None:
        if given is not None:
            try:
                store.check_address(given)
            except store.StoreError as error:
                raise ValueError(str(error)) from error
        return given

    @field_validator("token", mode="before")
    @classmethod
    def _no_token(cls, given: Any) -> Any:
        """An empty variable is none."""
        return given or None

    @field_validator("token")
    @classmethod
    def _long_token(cls, given: SecretStr | None) -> SecretStr | None:
        text = given.get_secret_value() if given else "x" * SHORTEST_TOKEN
        if len(text) < SHORTEST_TOKEN or not (text.isascii() and text.isprintable()) or " " in text:
            raise ValueError(f"must be at least {SHORTEST_TOKEN} ASCII characters without spaces")
        return given

    @model_validator(mode="after")
    def _closed_to_strangers(self) -> Self:
        if self.token is None and not is_loopback(self.host):
            raise ValueError(
                f"to listen on {self.host}, where others can reach it, needs a token: set BOUNCE_TOKEN"
            )
        return self

    @model_validator(mode="after")
    def _one_cluster(self) -> Self:
        if sum(map(bool, (self.scheduler, self.scheduler_file, self.cluster))) > 1:
            raise ValueError("only one of scheduler, scheduler_file and cluster can be computed with")
        return self

    @model_validator(mode="after")
    def _whole_tls(self) -> Self:
        files = (self.scheduler_ca, self.scheduler_cert, self.scheduler_key)
        if any(files) and not all(files):
            raise ValueError("TLS to the scheduler needs scheduler_ca, scheduler_cert and scheduler_key")
        return self

    @property
    def hosts(self) -> frozenset[str]:
        """The names that the service answers to."""
        anywhere = {"0.0.0.0", "::", ""}
        return LOOPBACK_NAMES | self.allowed_hosts | ({self.host.lower()} - anywhere)

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
        if self.stores is not None and store.in_bucket(self.stores):
            return f"{self.stores.rstrip('/')}/{job_id}.zarr"
        folder = self.data / "stores" if self.stores is None else Path(self.stores)
        return str(folder.absolute() / f"{job_id}.zarr")


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach what listens on `host`."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"
