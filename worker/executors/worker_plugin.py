"""The plugin that prepares a Dask worker for tasks and ends its process quickly.

Imports no kernel: a worker unpickles the plugin, and so imports this module, before it has claimed its
kernel cache. For the same reason `worker/executors/__init__.py` is empty.
"""

import asyncio
import os
from typing import Any

from distributed import Status, WorkerPlugin

from worker.kernel_cache import claim_cache, warm


class WarmKernels(WorkerPlugin):
    """Compiles all kernels on every worker that starts or joins, before it takes a task.

    `root` is the folder of the kernel caches; None: the default of `worker.kernel_cache`.
    """

    name = "bouncing-spring-kernels"

    def __init__(self, root: str | None = None) -> None:
        self._root = root

    async def setup(self, worker: Any) -> None:
        """Called by distributed in the worker's process. Compiles in a thread, beside the event loop."""
        claim_cache(self._root)
        await asyncio.to_thread(warm, self._root)

    def teardown(self, worker: Any) -> None:
        """Called by distributed when the plugin is replaced or the worker closes; then ends the process.

        A closing worker would first finish the chunk it computes and then free all compiled code, which
        takes seconds when the service stops or the scheduler restarts. Nothing is lost: the service submits
        an unfinished chunk again. Without a nanny, nobody would notice that the process has ended.
        """
        if worker.nanny is not None and worker.status == Status.closing:
            os._exit(0)
