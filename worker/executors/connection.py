"""The connection to a Dask scheduler, restored when the scheduler dies, freezes or is replaced."""

import asyncio
import contextlib
import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Final

import dask
from distributed import Client, WorkerPlugin

from worker.executors.base import ClusterLost
from worker.executors.clusters import NO_SCHEDULER, SCHEDULER_SETTINGS, Target, environment_variable
from worker.executors.plugins import DEMAND, ROSTER, Demand
from worker.watchdog import TOPIC

log = logging.getLogger(__name__)

#: A scheduler that has not answered for this long counts as lost: a frozen one neither answers nor fails.
PING_SECONDS: Final = 2.0
#: The interval at which a lost scheduler is tried again.
RETRY_SECONDS: Final = 1.0


class _ClientOfOneConnection(Client):
    """A client that does not reconnect by itself: `SchedulerConnection` replaces it.

    If closed while it reconnects, distributed leaves the new connection open until this process ends.
    If it cannot connect, distributed leaves its thread and three files; and it waits for the first answer of
    a frozen scheduler indefinitely.
    """

    def start(self, **options: Any) -> None:
        """Called by distributed when the client is made. Each of three answers may take the time-out."""
        try:
            super().start(**options, callback_timeout=3 * options["timeout"])  # type: ignore[no-untyped-call]
        except BaseException:
            self._loop_runner.stop()  # type: ignore[no-untyped-call]
            self.status = "closed"
            raise

    async def _reconnect(self) -> None:
        self.scheduler_comm = None
        for state in self.futures.values():
            state.cancel(reason="scheduler-connection-lost", msg="The connection to the scheduler was lost.")
        self.futures.clear()


class SchedulerConnection:
    """A Dask client for the scheduler that `target` finds (an address or a cluster object).

    A thread checks the connection every second, reconnects when it is lost, and registers `plugin` with each
    new scheduler. `on_event` gets the events that workers log, in the client's event loop; `on_lost` a client
    whose connection was lost. Thread-safe.
    Raises ClusterLost if no scheduler answers within the first `timeout` seconds.
    """

    def __init__(
        self,
        target: Target,
        plugin: WorkerPlugin,
        on_event: Callable[[dict[str, Any]], None],
        on_lost: Callable[[Any], None],
        *,
        security: Any = None,
        timeout: float,
    ) -> None:
        self._target, self._plugin, self._security = target, plugin, security
        self._on_event, self._on_lost, self._timeout = on_event, on_lost, timeout
        self._closed = threading.Event()
        self._registered = False  # whether the scheduler has our plugin
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
        if self._client.status != "running" or not self._registered:
            raise ClusterLost(f"not connected to a scheduler: {self._client.status}")
        return self._client

    def worker_threads(self) -> dict[str, int] | None:
        """Threads by worker address; None if the scheduler does not answer within `PING_SECONDS`."""
        try:
            client = self.client
            threads: dict[str, int] = client.sync(client.scheduler.ncores, callback_timeout=PING_SECONDS)
        except (ClusterLost, OSError, RuntimeError):  # the last: the client was closed meanwhile
            return None
        return threads

    def ask_for(self, seconds: float, tasks: int) -> None:
        """Tell the scheduler how much work remains (see `Demand`); does not block."""
        client = self._client

        async def tell() -> None:
            with contextlib.suppress(Exception):  # the next demand tries again
                call = client.scheduler.set_metadata(keys=[DEMAND, client.id], value=(seconds, tasks))
                await asyncio.wait_for(call, PING_SECONDS)  # each waiting call holds a connection

        if client.status == "running":
            client.loop.add_callback(tell)

    def close(self) -> None:
        """Disconnect. The scheduler and its workers stay."""
        self._closed.set()
        self._monitor.join(2 * PING_SECONDS)
        self._client.close()

    def _connect(self, timeout: float) -> Any:
        address: Any = "an unknown address"
        try:
            address = self._target.find()
            return _ClientOfOneConnection(  # type: ignore[no-untyped-call]
                address, timeout=timeout, set_as_default=False, security=self._security
            )
        except (*NO_SCHEDULER, RuntimeError) as error:  # the last: TLS is set, and the address is not tls://
            self._target.unanswered()
            without = isinstance(error, TypeError) and str(address).startswith("tls://")
            reason = "it needs certificates, see BOUNCE_SCHEDULER_CA" if without else error
            raise ClusterLost(f"no scheduler answers at {address}: {reason}") from error

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
        """Prepare a scheduler for tasks: events, plugins, settings."""
        for topic in (TOPIC, ROSTER):
            self._client.subscribe_topic(topic, lambda event: self._on_event(event[1]))
        try:
            register = self._client.register_plugin  # all workers must answer
            self._client.sync(register, self._plugin, callback_timeout=self._timeout)
        except TimeoutError:  # they have it once they answer
            log.warning("not all workers answer: those that hang cannot be judged, and get no chunk")
        with contextlib.suppress(OSError, ValueError, KeyError):  # it refuses to run code, or is gone
            self._client.register_plugin(Demand())
            self._check_settings()
        self._registered = True

    def _check_settings(self) -> None:
        """Warn about settings that the scheduler lacks. Results are right without them."""
        for name, required in SCHEDULER_SETTINGS.items():
            if (actual := self._client.run_on_scheduler(dask.config.get, name)) != required:
                setting = f"{environment_variable(name)}={required:g}"
                log.warning("the scheduler's %s is %s: start it with %s", name, actual, setting)

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
        """Connect again if the connection is lost; register with the scheduler that answers."""
        if self._client.status != "running":
            self._registered = False
            lost, self._client = self._client, self._connect(PING_SECONDS)
            with contextlib.suppress(Exception):
                lost.close(timeout=RETRY_SECONDS)
            self._on_lost(lost)
        if not self._registered:
            self._register()
            log.info("connected to a scheduler again")
