"""The plugin as workers get it: it loads the one of this project, or refuses a worker that cannot load it.

A worker unpickles its plugins when it joins, and ends if that fails; with one that was there before, the
service could not start. So what is pickled is the text of this module, for a worker without this project, or
with another version of Python: nothing here needs more than the standard library and distributed.
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
#: Seconds between two looks at whether a refused worker may compute now: its folder may be mounted late.
JUDGE_SECONDS: Final = 5.0


class SentPlugin(WorkerPlugin):
    """Sets up the plugin that is pickled in `pickled` on every worker that starts or joins.

    A worker on which that fails stays, and the scheduler gives it no task. It is tried again, in case its
    folders were mounted late.
    """

    name = "bouncing-spring-kernels"

    def __init__(self, pickled: bytes) -> None:
        self._pickled = pickled
        self._plugin: Any = None
        self._removed = False

    def __reduce__(self) -> Any:
        names = {"__name__": __name__, "text": Path(__file__).read_text("utf-8"), "pickled": self._pickled}
        return eval, ("exec(text) or SentPlugin(pickled)", names)

    async def setup(self, worker: Any) -> None:
        """Called by distributed in the worker's process."""
        importlib.invalidate_caches()  # what was not there before may be now
        try:
            self._plugin = pickle.loads(self._pickled)
            await self._plugin.setup(worker)
        except Exception as error:  # noqa: BLE001 - whatever it is, nothing can be computed there
            told = " ".join(str(error).split())
            reason = f"it cannot load bouncing-spring: {type(error).__name__}: {told}"
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
    """Have the scheduler give this worker no task, and tell why: each time, as events can be lost."""
    set_available(worker, available=False)
    log_event(worker, refused=reason)


def set_available(worker: Any, *, available: bool) -> None:
    """Have the scheduler give this worker tasks, or none.

    The worker itself stays as it is: one that is paused would keep the tasks that it was given before, and
    its memory monitor would end the pause.
    """
    worker.batched_send(
        {
            "op": "worker-status-change",
            "status": (Status.running if available else Status.paused).name,
            "stimulus_id": f"bouncing-spring-{time.time()}",
        }
    )


def log_event(worker: Any, **what: Any) -> None:
    """Tell the service of this worker, under `ROSTER`."""
    event = {"worker": worker.address, "host": socket.gethostname(), "process": os.getpid()}
    worker.log_event(ROSTER, {**event, **what})
