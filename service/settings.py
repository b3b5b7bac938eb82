"""The service's settings, from `BOUNCE_*` environment variables or command-line options of the same names."""

import re
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    FilePath,
    SecretStr,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from service import tokens
from service.errors import NotStarted
from worker import store
from worker.spec.errors import rule_of
from worker.study.chunks import (
    DEFAULT_MAX_BYTES,
    DEFAULT_MAX_CELLS,
    DEFAULT_MAX_CORE_SECONDS,
    LONGEST_SECONDS,
)

Port = Annotated[int, Field(ge=0, le=65535)]
#: The upper limits are those of the system's clocks and SQLite.
Positive = Annotated[float, Field(gt=0, le=1e9)]
Count = Annotated[int, Field(ge=1, le=2**62)]

MOST_WORKERS: Final = 1024

#: Host names and addresses of this machine's loopback interface.
LOOPBACK_NAMES: Final = frozenset({"localhost", "127.0.0.1", "::1"})


def _split(value: Any) -> Any:
    names = value.split(",") if isinstance(value, str) else value
    return frozenset(str(name).strip().lower() for name in names) - {""}


#: Names that a variable separates by commas.
Names = Annotated[frozenset[str], NoDecode, BeforeValidator(_split)]


def _hosts(values: frozenset[str]) -> frozenset[str]:
    """Names, addresses or `*`. Raises ValueError for what no Host header names."""
    for name in values:
        if not re.fullmatch(r"\*|[\w.-]+|[0-9a-f.]*(?::[0-9a-f.]*){2,}", name):
            raise ValueError(f"{name[:80]}: a host is a name or an address, without scheme and port")
    return values


def _cluster(name: str) -> str:
    if not re.fullmatch(r"[\w.]+:\w+", name):
        raise ValueError(f"{name[:80]}: write module:function, such as clusters:slurm")
    return name


class Settings(BaseSettings):
    """Where the service listens, keeps data and computes, and how much one request may ask for."""

    model_config = SettingsConfigDict(
        env_prefix="BOUNCE_", env_ignore_empty=True, frozen=True, extra="forbid", hide_input_in_errors=True
    )

    # The web server

    host: str = Field("127.0.0.1", description="Address to listen on.")
    port: Port = Field(8000, description="Port to listen on; 0 takes any free one.")
    token: SecretStr | None = Field(
        None,
        description="Access token that callers must send; `auto` makes one and keeps it in `data`; "
        "required beyond loopback.",
    )
    token_file: Path | None = Field(
        None,
        description="File of more access tokens, one `NAME: TOKEN` per line, readable by this user alone.",
    )
    allowed_hosts: Annotated[Names, AfterValidator(_hosts)] = Field(
        frozenset(),
        description="Host names accepted beside loopback and `host`, separated by commas; `*` accepts any.",
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="Lowest level of messages that are logged."
    )

    # Data

    data: Path = Field(
        Path("bounce-data"), description="Folder of the ledger, the stores and files being exported."
    )
    stores: str | None = Field(
        None, description="Folder, or s3://BUCKET/PREFIX, of the stores; default `data`/stores."
    )

    private: bool = Field(True, description="Close ledger and stores to other users of this machine.")

    # The cluster

    workers: int = Field(2, ge=1, le=MOST_WORKERS, description="Worker processes of the embedded cluster.")
    scheduler: str | None = Field(None, description="Address of a Dask scheduler to compute with.")
    scheduler_file: Path | None = Field(
        None, description="File written by `dask scheduler --scheduler-file`."
    )
    cluster: Annotated[str, AfterValidator(_cluster)] | None = Field(
        None, description="`module:function` that returns a Dask cluster to compute with."
    )
    scheduler_ca: FilePath | None = Field(
        None, description="CA certificate to check the scheduler's TLS certificate against."
    )
    scheduler_cert: FilePath | None = Field(
        None, description="TLS certificate that the service presents to the scheduler."
    )
    scheduler_key: FilePath | None = Field(None, description="Private key of `scheduler_cert`.")
    worker_memory: Annotated[int, Field(ge=500_000_000, le=2**62)] | None = Field(
        None, description="Bytes of memory of an embedded worker; default: its share of the machine's."
    )

    # Limits on requests

    max_body_bytes: Count = Field(1_000_000, description="Bytes of a request body.")
    body_seconds: Positive = Field(
        10.0, description="Seconds for a request's headers to arrive, and for its body."
    )
    stall_seconds: Positive = Field(
        60.0, description="Seconds after which a client that reads nothing is disconnected, on Linux."
    )
    max_cells: Count = Field(DEFAULT_MAX_CELLS, description="Cells of one sweep.")
    max_bytes: Count = Field(DEFAULT_MAX_BYTES, description="Bytes of one sweep's arrays before compression.")
    max_core_seconds: Positive = Field(
        DEFAULT_MAX_CORE_SECONDS, description="Core-seconds of one study, by the cost table's upper estimate."
    )
    max_queue: Count = Field(1_000, description="Unfinished jobs.")
    max_queue_per_token: Count = Field(500, description="Unfinished jobs of one named token.")
    max_points: Count = Field(1_000_000, description="Flights, or cells of a mode map, in one answer.")
    max_export_bytes: Count = Field(
        2 * 2**30, description="Bytes of a sweep exported as one file, before compression."
    )
    max_reads: Count = Field(1, description="Diagrams, maps and tables read or drawn at a time.")
    answer_memory: Count = Field(
        512 * 2**20, description="Bytes of all answers together until they are sent."
    )
    turn_seconds: Positive = Field(
        5.0, description="Seconds that a costly request waits before it is refused."
    )
    max_exports: Count = Field(1, description="Files exported at a time.")
    max_trajectories: Count = Field(2, description="Trajectories computed at a time.")
    trajectory_seconds: Positive = Field(5.0, description="Estimated seconds of one trajectory.")
    max_listeners: Count = Field(1_000, description="Connections to progress streams.")
    key_seconds: Positive = Field(
        24 * 3600.0, description="Seconds for which an Idempotency-Key is remembered."
    )

    # Running jobs

    active_jobs: Count = Field(32, description="Jobs with their plans in memory.")
    window: Count = Field(2, description="Chunks in flight per worker; chunks of larger jobs do not count.")
    window_seconds: Annotated[float, Field(ge=0, le=1e9)] = Field(
        0.5, description="Core-seconds in flight per worker, if that is more chunks than `window`."
    )
    longest_chunk_seconds: Positive = Field(
        LONGEST_SECONDS,
        description="Longest chunk, in estimated core-seconds, in jobs above 15,000 chunks of 0.75 s.",
    )
    chunk_tries: Count = Field(3, description="Tries of a chunk before it is given up.")
    chunk_seconds: Positive = Field(
        60.0, description="Seconds that any chunk may take before its worker is replaced."
    )
    # One cell may cost 150 times its value in the table of costs.
    chunk_slack: Positive = Field(
        300.0,
        description="Limit on a chunk's time in multiples of its longest estimate, if that is above "
        "`chunk_seconds`.",
    )
    failed_chunks: Count = Field(8, description="Chunks given up after which a job submits no more.")
    heartbeat_seconds: Positive = Field(
        2.0, description="Seconds between two syncs of the supervisor with the ledger, unless woken."
    )
    shutdown_seconds: Positive = Field(2.0, description="Seconds for open requests to finish at shutdown.")

    @field_validator("scheduler")
    @classmethod
    def _check_scheduler(cls, value: str | None) -> str | None:
        if value is not None and "@" in value:
            raise ValueError(
                "must not contain credentials: scheduler_cert and scheduler_key identify the service"
            )
        return value

    @field_validator("data")
    @classmethod
    def _check_data(cls, value: Path) -> Path:
        if value.parts[:1] == ("s3:",):
            raise ValueError("must be a folder; only `stores` can be in a bucket")
        return value

    @field_validator("stores")
    @classmethod
    def _check_stores(cls, value: str | None) -> str | None:
        if value is not None:
            if "@" in urlsplit(value).netloc or (value.startswith("s3:") and "@" in value):
                raise ValueError(
                    "must not contain credentials; set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, "
                    "for the workers too"
                )
            try:
                store.check_address(value)
            except store.StoreError as error:
                raise ValueError(str(error)) from error
        return value

    @field_validator("token")
    @classmethod
    def _check_token(cls, value: SecretStr | None) -> SecretStr | None:
        text = value.get_secret_value() if value else ""
        if text not in ("", tokens.AUTO) and not tokens.is_valid(text):
            raise ValueError(f"{tokens.RULE}, or auto")
        return value if text else None

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        if self.token is None and self.token_file is None and not tokens.is_loopback(self.host):
            raise ValueError(
                f"to listen on {self.host}, where others can reach it, needs a token: "
                "set BOUNCE_TOKEN or BOUNCE_TOKEN_FILE"
            )
        if sum(map(bool, (self.scheduler, self.scheduler_file, self.cluster))) > 1:
            raise ValueError("only one of scheduler, scheduler_file and cluster can be given")
        files = (self.scheduler_ca, self.scheduler_cert, self.scheduler_key)
        if any(files) and not all(files):
            raise ValueError("TLS to the scheduler needs scheduler_ca, scheduler_cert and scheduler_key")
        return self

    @property
    def makes_token(self) -> bool:
        """Whether the service creates its token itself."""
        return self.token is not None and self.token.get_secret_value() == tokens.AUTO

    def access_tokens(self) -> dict[str, str | None]:
        """The names of all accepted tokens, by token; empty if none is required.

        Reads `token_file`. `auto` must have been replaced by the created token. Raises NotStarted.
        """
        if self.makes_token:
            raise NotStarted("token: auto is not replaced by a token")
        accepted: dict[str, str | None] = {}
        if self.token_file is not None:
            try:
                named = tokens.read_tokens(self.token_file, private=self.private)
            except tokens.TokenFileUnusable as error:
                raise NotStarted(f"token_file: {error}") from error
            accepted |= {token: name for name, token in named.items()}
        if self.token is not None:
            accepted.setdefault(self.token.get_secret_value(), None)
        return accepted

    @property
    def hosts(self) -> frozenset[str]:
        """The Host names that the service accepts."""
        any_address = {"0.0.0.0", "::", ""}
        return LOOPBACK_NAMES | self.allowed_hosts | ({self.host.lower()} - any_address)

    @property
    def ledger_path(self) -> Path:
        """The ledger's SQLite file."""
        return self.data / "ledger.sqlite"

    @property
    def exports_path(self) -> Path:
        """The folder of files being exported."""
        return self.data.absolute() / "exports"

    @property
    def stores_url(self) -> str:
        """The folder of the stores, as an absolute path, or their bucket prefix."""
        if self.stores is not None and store.in_bucket(self.stores):
            return self.stores.rstrip("/")
        return str(Path(self.stores or self.data / "stores").absolute())

    @property
    def folders(self) -> tuple[Path, ...]:
        """Folders on this machine that hold data: of the ledger, and of the stores."""
        in_bucket = store.in_bucket(self.stores_url)
        return (self.data,) if in_bucket else (self.data, Path(self.stores or self.data / "stores"))

    def store_of(self, name: str) -> str:
        """The address of the zarr store with this name: an absolute path or an s3:// URL."""
        return f"{self.stores_url}/{name}"


def read_settings(**overrides: Any) -> Settings:
    """Settings from `BOUNCE_*` variables, overridden by arguments that are neither None nor empty.

    Raises NotStarted naming the setting and the rule.
    """
    try:
        return Settings(**{name: value for name, value in overrides.items() if value not in (None, "")})
    except ValidationError as error:
        rules = [": ".join([*map(str, entry["loc"]), rule_of(entry)]) for entry in error.errors()]
        raise NotStarted("; ".join(rules)) from error
