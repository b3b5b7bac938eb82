"""Tells the scheduler how much work the jobs have, so that adaptive clusters grow before chunks wait.

An adaptive cluster (`cluster.adapt(...)`, also of dask-jobqueue and dask-gateway) asks the scheduler how many
workers it should have. The scheduler counts its own tasks, but the service submits only a few chunks per
worker. So the service reports the remaining core-seconds and how many chunks could run at once.
"""

import math
from typing import Any, Final

import dask
from dask.utils import parse_timedelta
from distributed import SchedulerPlugin, Status

#: The name of the plugin, and of the scheduler's handler.
NAME: Final = "bouncing-spring-demand"
HANDLER: Final = "bouncing_spring_demand"


class Demand(SchedulerPlugin):
    """Makes the scheduler ask for as many workers as its services need.

    With `seconds` core-seconds left and Dask's `target-duration` T these are seconds / T, at most as many as
    chunks could run at once, plus one for each refused or resting worker.
    """

    name = NAME
    idempotent = True

    def __init__(self) -> None:
        self._needs: dict[str, tuple[float, int]] = {}  # core-seconds and chunks, by client

    async def start(self, scheduler: Any) -> None:
        """Called by distributed in the scheduler's process."""
        self._scheduler, self._by_tasks = scheduler, scheduler.adaptive_target
        scheduler.adaptive_target = self._target
        scheduler.handlers["adaptive_target"] = self._target
        scheduler.handlers[HANDLER] = self._set

    def remove_client(self, scheduler: Any, client: str) -> None:
        """Called by distributed: a service that has left needs nothing."""
        self._needs.pop(client, None)

    def _set(self, client: str, seconds: float, tasks: int) -> None:
        self._needs[client] = (seconds, tasks)

    def _target(self, target_duration: Any = None) -> int:
        """Replaces `Scheduler.adaptive_target`; never less than that."""
        by_tasks: int = self._by_tasks(target_duration)
        duration = parse_timedelta(target_duration or dask.config.get("distributed.adaptive.target-duration"))
        wanted: int = sum(
            min(tasks, math.ceil(seconds / duration)) for seconds, tasks in self._needs.values()
        )
        if not wanted:
            return by_tasks
        paused: int = sum(worker.status == Status.paused for worker in self._scheduler.workers.values())
        return max(by_tasks, wanted + paused)
