"""Room: the connection to a Dask scheduler, kept through its death and freezing."""

import contextlib
import json
import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import dask
from distributed import Client, WorkerPlugin
from distributed.comm.addressing import get_address_host_port

from worker.executors.errors import ClusterLost
from worker.watchdog import TOPIC

log = logging.getLogger(__name__)

#: A frozen scheduler never answers and never fails: after so long it counts as not there.
PING_SECONDS: Final = 2.0
#: But one that has just come may have a lot to do.
GREETING_SECONDS: Final = 30.0
#: How often a lost scheduler is looked for.
RETRY_SECONDS: Final = 1.0
#: How a scheduler has to be set, and what comes of it otherwise.
SCHEDULER: Final[dict[str, tuple[float, str]]] = {
    # Whose fault a worker's death was is judged here, at once.
    "distributed.scheduler.allowed-failures": (0, "a chunk that ends its worker ends more of them first"),
    # What waits for a worker waits at the scheduler, and goes to whichever is free.
    "distributed.scheduler.worker-saturation": (1.0, "chunks may wait behind one that hangs"),
}
#: What leads to no scheduler: a time-out is an OSError, a file may be half written.
_NOBODY: Final = (OSError, ValueError, KeyError, TypeError)

Target = Callable[[], Any]


class SchedulerConnection:
    """A client of the scheduler that `target` gives (an address or a cluster), made anew when it is lost.

    Every scheduler is told of `plugin` for its workers, and `heard` gets what they say, in the client's own
    thread. Raises ClusterLost if there is no scheduler within `timeout` seconds at first.
    """

    def __init__(
        self,
        target: Target,
        plugin: WorkerPlugin,
        heard: Callable[[dict[str, Any]], None],
        *,
        security: Any = None,
        timeout: float,
    ) -> None:
        self._target, self._plugin, self._heard, self._security = target, plugin, heard, security
        self._closed = threading.Event()
        self._scheduler = ""  # the identity of the one that knows our plugin
        self._client = self._connected(timeout)
        try:
            self._greet()
        except BaseException:
            self._client.close()
            raise
        self._keeper = threading.Thread(target=self._keep, name="link", daemon=True)
        self._keeper.start()

    @property
    def client(self) -> Any:
        """The client, connected as far as anyone knows. Raises ClusterLost."""
        if self._client.status != "running" or not self._scheduler:
            raise ClusterLost(f"not connected to a scheduler: {self._client.status}")
        return self._client

    def threads(self) -> int:
        """The scheduler's own count of its workers' threads; 0 if it does not answer in time."""
        if self._client.status != "running":
            return 0
        try:
            found = self._identity()
        except (OSError, TimeoutError, RuntimeError):  # the last: the client was closed meanwhile
            return 0
        return int(found["total_threads"]) if found["id"] == self._scheduler else 0

    def close(self) -> None:
        """Let go of the scheduler."""
        self._closed.set()
        self._keeper.join(2 * PING_SECONDS)
        self._client.close()

    def _identity(self, seconds: float = PING_SECONDS) -> dict[str, Any]:
        client = self._client
        found: dict[str, Any] = client.sync(client.scheduler.identity, n_workers=0, callback_timeout=seconds)
        return found

    def _connected(self, timeout: float) -> Any:
        place: Any = "an address to come"
        try:
            place = self._target()
            if isinstance(place, str):
                get_address_host_port(place)  # a client of what is no address would take a minute to close
            return Client(place, timeout=timeout, set_as_default=False, security=self._security)  # type: ignore[no-untyped-call]
        except _NOBODY as error:
            raise ClusterLost(f"no scheduler answers at {place}: {error}") from error

    def _greet(self) -> None:
        """Tell a scheduler what it has to know; after that, chunks may be given to it."""
        self._client.subscribe_topic(TOPIC, lambda event: self._heard(event[1]))
        self._client.register_plugin(self._plugin)
        self._look_at_settings()
        self._scheduler = self._identity(GREETING_SECONDS)["id"]

    def _look_at_settings(self) -> None:
        """Say so if the scheduler is not set as it has to be; results are right all the same."""
        for name, (wanted, otherwise) in SCHEDULER.items():
            try:
                found = self._client.run_on_scheduler(dask.config.get, name)
            except (OSError, ValueError, KeyError) as error:  # it runs nobody's code, or is gone again
                log.warning("the scheduler does not tell its %s: %s", name, error)
                continue
            if found != wanted:
                said = "the scheduler's %s is %s: %s; start it with %s=%g"
                log.warning(said, name, found, otherwise, variable(name), wanted)

    def _keep(self) -> None:
        while not self._closed.wait(RETRY_SECONDS):
            try:
                self._mend()
            except ClusterLost:
                continue  # it is looked for until it is there
            except Exception:
                log.exception("a scheduler answers but cannot be used; it is tried again soon")

    def _mend(self) -> None:
        """Connect again if the scheduler is lost, or greet the one that took its place."""
        if self._client.status != "running":
            self._scheduler = ""
            lost, self._client = self._client, self._connected(PING_SECONDS)
            with contextlib.suppress(Exception):
                lost.close(timeout=RETRY_SECONDS)
            self._greet()
            log.info("connected to a scheduler again")
        elif self._is_another():
            self._scheduler = ""
            self._greet()

    def _is_another(self) -> bool:
        try:
            return bool(self._identity()["id"] != self._scheduler)
        except (OSError, TimeoutError, RuntimeError):
            return False


def variable(name: str) -> str:
    """Of a scheduler's environment, what sets a configuration of Dask."""
    return "DASK_" + name.replace(".", "__").replace("-", "_").upper()


def address_in(file: Path, timeout: float) -> str:
    """The address a scheduler wrote; waits for the file, which distributed itself would do for ever."""
    deadline = time.monotonic() + timeout
    while True:
        try:
            return str(json.loads(file.read_text())["address"])
        except _NOBODY as error:
            if time.monotonic() > deadline:
                raise ClusterLost(f"no scheduler has written its address to {file}: {error}") from error
        time.sleep(0.1)
