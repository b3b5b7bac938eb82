"""The plugin as sent to workers: it loads this project's plugin, or refuses a worker that cannot load it.

A worker unpickles its plugins when it joins, and ends if that fails; if one such worker were present, the
service could not start. So the text of this module is pickled, for workers without this project or with
another version of Python: it needs only the standard library and distributed.
"""

import importlib
import os
import pickle
import socket
import time
from pathlib import Path
from typing import Any, Final

from distributed import Status, WorkerPlugin

#: The topic under which a worker's plugin logs events, each with "worker", "host" and "process", and one of
#: "refused" (why), "admitted" and "leaving".
ROSTER: Final = "bouncing-spring-workers"
#: Seconds between checks of a refused worker: its folder may be mounted late.
JUDGE_SECONDS: Final = 5.0


class PluginLoader(WorkerPlugin):
    """Sets up the plugin pickled in `pickled` on every worker that starts or joins.

    If that fails, the worker stays without tasks and setup is tried again, in case its folders were mounted
    late.
    """

    name = "bouncing-spring-kernels"

    def __init__(self, pickled: bytes) -> None:
        self._pickled = pickled
        self._plugin: Any = None
        self._removed = False

    def __reduce__(self) -> Any:
        names = {"__name__": __name__, "text": Path(__file__).read_text("utf-8"), "pickled": self._pickled}
        return eval, ("exec(text) or PluginLoader(pickled)", names)

    async def setup(self, worker: Any) -> None:
        """Called by distributed in the worker's process."""
        importlib.invalidate_caches()  # modules may have been installed since
        try:
            self._plugin = pickle.loads(self._pickled)
            await self._plugin.setup(worker)
        except Exception as error:  # noqa: BLE001 - any error means that it cannot compute
            text = " ".join(str(error).split())
            reason = f"it cannot load bouncing-spring: {type(error).__name__}: {text}"
            refuse(worker, reason)
            worker.loop.call_later(JUDGE_SECONDS, self._set_up_again, worker)

    async def teardown(self, worker: Any) -> None:
        """Called by distributed when the plugin is replaced or the worker closes."""
        self._removed = True
        if self._plugin is not None:
            await self._plugin.teardown(worker)

    async def _set_up_again(self, worker: Any) -> None:
        if not self._removed:
            await self.setup(worker)


def refuse(worker: Any, reason: str) -> None:
    """Stop the scheduler from giving this worker tasks, and report why, repeatedly, as events can be lost."""
    set_available(worker, available=False)
    log_event(worker, refused=reason)


def set_available(worker: Any, *, available: bool) -> None:
    """Allow or forbid the scheduler to give this worker tasks.

    The worker itself is not paused: that would hold up the tasks it already has, and its memory monitor
    would end the pause.
    """
    worker.batched_send(
        {
            "op": "worker-status-change",
            "status": (Status.running if available else Status.paused).name,
            "stimulus_id": f"bouncing-spring-{time.time()}",
        }
    )


def log_event(worker: Any, **what: Any) -> None:
    """Report something about this worker to the service, under `ROSTER`."""
    event = {"worker": worker.address, "host": socket.gethostname(), "process": os.getpid()}
    worker.log_event(ROSTER, {**event, **what})
