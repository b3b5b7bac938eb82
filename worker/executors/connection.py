"""The connection to a Dask scheduler, restored when the scheduler dies, freezes or is replaced."""

import contextlib
import logging
import socket
import threading
import time
from collections.abc import Callable, Collection
from typing import Any, Final

import dask
from distributed import Client, WorkerPlugin
from distributed.comm.addressing import get_address_host_port

from worker.executors.demand import HANDLER, Demand
from worker.executors.errors import ClusterLost
from worker.executors.sent_plugin import ROSTER
from worker.executors.targets import NO_SCHEDULER, Target
from worker.watchdog import TOPIC

log = logging.getLogger(__name__)

#: A scheduler that has not answered for this long counts as lost: a frozen one neither answers nor fails.
PING_SECONDS: Final = 2.0
#: A scheduler that has just started may be busy with its workers.
REGISTER_SECONDS: Final = 30.0
#: The interval at which a lost scheduler is tried again.
RETRY_SECONDS: Final = 1.0

#: Dask settings that the scheduler needs.
SCHEDULER_SETTINGS: Final[dict[str, float]] = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
}
#: What happens without them. The service itself retries tasks, and a task must wait at the scheduler for the
#: first free worker.
_WITHOUT_SETTING: Final[dict[str, str]] = {
    "distributed.scheduler.allowed-failures": "a chunk that kills its worker kills several before it fails",
    "distributed.scheduler.worker-saturation": "chunks may wait behind one that hangs",
}


class _ClientOfOneConnection(Client):
    """A client that does not reconnect by itself: `SchedulerConnection` replaces it.

    If closed while it reconnects, distributed leaves the new connection open until this process ends.
    """

    async def _reconnect(self) -> None:
        self.scheduler_comm = None
        for state in self.futures.values():
            state.cancel(reason="scheduler-connection-lost", msg="The connection to the scheduler was lost.")
        self.futures.clear()


class SchedulerConnection:
    """A Dask client for the scheduler that `target` finds (an address or a cluster object).

    A thread checks the connection every second, reconnects when it is lost, and registers `plugin` with each
    new scheduler. `on_event` gets the events that workers log under `TOPIC`, and `on_roster` those under
    `ROSTER`, in the client's event loop. `on_lost` gets a client whose connection was lost. Thread-safe.
    Raises ClusterLost if no scheduler answers within the first `timeout` seconds.
    """

    def __init__(
        self,
        target: Target,
        plugin: WorkerPlugin,
        on_event: Callable[[dict[str, Any]], None],
        on_roster: Callable[[dict[str, Any]], None],
        on_lost: Callable[[Any], None],
        *,
        security: Any = None,
        timeout: float,
    ) -> None:
        self._target, self._plugin, self._security = target, plugin, security
        self._on_event, self._on_roster, self._on_lost = on_event, on_roster, on_lost
        self._closed = threading.Event()
        self._scheduler_id = ""  # of the scheduler that has our plugin; empty while there is none
        self._takes_demand = False  # whether that scheduler has the plugin `Demand`
        self._asked: tuple[float, int] | None = None  # of that scheduler
        self.fault = ""  # why the last attempt to connect failed
        self._client = self._connect(timeout)
        try:
            self._register_at_first(timeout)
        except BaseException:
            self._client.close()
            raise
        self._monitor = threading.Thread(target=self._keep_connected, name="scheduler", daemon=True)
        self._monitor.start()

    @property
    def client(self) -> Any:
        """The client, connected as of the last check. Raises ClusterLost."""
        if self._client.status != "running" or not self._scheduler_id:
            raise ClusterLost(f"not connected to a scheduler: {self._client.status}")
        return self._client

    def worker_threads(self) -> int | None:
        """The scheduler's count of its workers' threads; None if it does not answer within `PING_SECONDS`."""
        if self._client.status != "running":
            return None
        try:
            identity = self._identity()
        except (OSError, TimeoutError, RuntimeError):  # the last: the client was closed meanwhile
            return None
        return int(identity["total_threads"]) if identity["id"] == self._scheduler_id else None

    def threads_of(self, workers: Collection[str] | None = None) -> dict[str, int]:
        """Threads by worker address, of all workers or of these if present.

        Empty if the scheduler does not answer within `PING_SECONDS`.
        """
        client = self._client
        asked = None if workers is None else list(workers)
        try:
            threads: dict[str, int] = client.sync(
                client.scheduler.ncores, workers=asked, callback_timeout=PING_SECONDS
            )
        except (OSError, TimeoutError, RuntimeError):
            return {}
        return threads

    def run_on(self, worker: str, function: Callable[..., Any], *arguments: Any) -> None:
        """Run `function(*arguments, dask_worker=...)` in a worker's event loop; does not block."""
        client = self._client

        async def run() -> None:
            with contextlib.suppress(Exception):  # the worker is gone, or the scheduler
                await client.run(function, *arguments, workers=[worker], on_error="ignore")

        client.loop.add_callback(run)

    def ask_for(self, seconds: float, tasks: int) -> None:
        """Tell the scheduler how much work remains (see `Demand`); does not block."""
        if self._takes_demand and self._scheduler_id and self._asked != (seconds, tasks):
            self._asked = (seconds, tasks)
            self._client.loop.add_callback(self._tell, self._client, seconds, tasks)

    async def _tell(self, client: Any, seconds: float, tasks: int) -> None:
        try:
            await getattr(client.scheduler, HANDLER)(client=client.id, seconds=seconds, tasks=tasks)
        except Exception:  # noqa: BLE001 - the next demand tries again
            self._asked = None

    def close(self) -> None:
        """Disconnect. The scheduler and its workers stay."""
        self._closed.set()
        self._monitor.join(2 * PING_SECONDS)
        self._client.close()

    def _identity(self, seconds: float = PING_SECONDS) -> dict[str, Any]:
        client = self._client
        identity: dict[str, Any] = client.sync(
            client.scheduler.identity, n_workers=0, callback_timeout=seconds
        )
        return identity

    def _connect(self, timeout: float) -> Any:
        address: Any = "an unknown address"
        try:
            address = self._target.find()
            if isinstance(address, str):
                get_address_host_port(address)  # with a malformed address, a client takes a minute to close
            return _ClientOfOneConnection(  # type: ignore[no-untyped-call]
                address, timeout=timeout, set_as_default=False, security=self._security
            )
        except NO_SCHEDULER as error:
            self._target.unanswered()
            raise ClusterLost(f"no scheduler answers at {address}: {error}") from error

    def _register_at_first(self, timeout: float) -> None:
        """Register, trying again if a worker dies meanwhile. Raises ClusterLost after `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while True:
            try:
                return self._register()
            except (OSError, RuntimeError) as error:
                if self._client.status != "running" or time.monotonic() > deadline:
                    raise ClusterLost(f"the scheduler or its workers cannot be prepared: {error}") from error
                log.warning("the workers cannot be prepared, trying again: %s", error)
                time.sleep(RETRY_SECONDS)

    def _register(self) -> None:
        """Prepare a scheduler for tasks: events, plugin, settings. Until then `client` raises ClusterLost."""
        self._client.subscribe_topic(TOPIC, lambda event: self._on_event(event[1]))
        self._client.subscribe_topic(ROSTER, lambda event: self._on_roster(event[1]))
        self._client.register_plugin(self._plugin)
        self._check_settings()
        self._register_demand()
        self._scheduler_id = self._identity(REGISTER_SECONDS)["id"]

    def _check_settings(self) -> None:
        """Warn about settings that the scheduler lacks. Results are right without them."""
        for name, required in SCHEDULER_SETTINGS.items():
            try:
                actual = self._client.run_on_scheduler(dask.config.get, name)
            except (OSError, ValueError, KeyError) as error:  # it refuses to run code, or is gone again
                log.warning("cannot read the scheduler's setting %s: %s", name, error)
                continue
            if actual != required:
                log.warning(
                    "the scheduler's %s is %s: %s; start it with %s=%g",
                    name, actual, _WITHOUT_SETTING[name], environment_variable(name), required,
                )  # fmt: skip

    def _register_demand(self) -> None:
        """Without it the scheduler counts the chunks in flight only, and adaptive clusters stay small."""
        self._takes_demand, self._asked = False, None
        try:
            self._client.register_plugin(Demand())
            self._takes_demand = True
        except Exception as error:  # noqa: BLE001 - any error of importing this project
            log.warning("the scheduler cannot be told how much is left to compute: %s", error)

    def _keep_connected(self) -> None:
        while not self._closed.wait(RETRY_SECONDS):
            try:
                self._reconnect_if_lost()
                self._target.refill()
                self.fault = ""
            except ClusterLost as error:
                self.fault = str(error)  # tried again at the next check
            except Exception:
                log.exception("cannot use the scheduler that answers; retrying in %g s", RETRY_SECONDS)

    def _reconnect_if_lost(self) -> None:
        """Connect again if the connection is lost; register with a scheduler that replaced the last one."""
        if self._client.status != "running":
            self._scheduler_id = ""
            self._check_listener()
            lost, self._client = self._client, self._connect(PING_SECONDS)
            with contextlib.suppress(Exception):
                lost.close(timeout=RETRY_SECONDS)
            self._on_lost(lost)
            self._register()
            log.info("connected to a scheduler again")
        elif self._is_replaced():
            self._scheduler_id = ""
            self._register()

    def _check_listener(self) -> None:
        """Raise ClusterLost if nobody listens at the scheduler's address.

        A distributed client that finds nobody keeps its thread and three files until this process ends:
        retried every second, they would run out within hours.
        """
        address: Any = "an unknown address"
        try:
            address = self._target.find()
            if isinstance(address, str):
                socket.create_connection(get_address_host_port(address), PING_SECONDS).close()
        except NO_SCHEDULER as error:
            raise ClusterLost(f"no scheduler answers at {address}: {error}") from error

    def _is_replaced(self) -> bool:
        try:
            return bool(self._identity()["id"] != self._scheduler_id)
        except (OSError, TimeoutError, RuntimeError):
            return False


def environment_variable(setting: str) -> str:
    """The environment variable that sets a Dask setting."""
    return "DASK_" + setting.replace(".", "__").replace("-", "_").upper()
