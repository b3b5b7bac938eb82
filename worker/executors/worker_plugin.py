"""Makes a Dask worker ready, and lets it go.

Imports distributed and worker.kernel_cache, and so no kernel: a worker loads this before it has claimed its
kernel cache.
"""

import asyncio
import os
from typing import Any

from distributed import Status, WorkerPlugin

from worker.kernel_cache import claim_cache, warm


class WarmKernels(WorkerPlugin):
    """Makes every worker of a cluster ready when it starts or joins, before it takes a task."""

    name = "bouncing-spring-kernels"

    def __init__(self, root: str | None = None) -> None:
        self._root = root

    async def setup(self, worker: Any) -> None:
        """Called by distributed in the worker's process; compiles beside its event loop."""
        claim_cache(self._root)
        await asyncio.to_thread(warm, self._root)

    def teardown(self, worker: Any) -> None:
        """Called by distributed when the plugin is replaced, or as the worker closes: then it ends at once.

        Nothing in it is worth waiting for, not even a chunk in work: whoever wanted that submits it again.
        Left to itself it would finish the chunk, then take apart all it has compiled: seconds that a stop
        of the service, or a new start after a scheduler's death, would take longer. Only where a nanny
        looks after it, and sees that it is gone.
        """
        if worker.nanny is not None and worker.status == Status.closing:
            os._exit(0)
