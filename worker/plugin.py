"""Room: what makes a Dask worker ready. Imports distributed and worker.warm, and so no kernel:
a worker loads this before it has claimed its kernel cache."""

import asyncio
from typing import Any

from distributed import WorkerPlugin

from worker.warm import claim_cache, warm


class WarmKernels(WorkerPlugin):
    """Makes every worker of a cluster ready when it starts or joins, before it takes a task."""

    name = "bouncing-spring-kernels"

    def __init__(self, root: str | None = None) -> None:
        self._root = root

    async def setup(self, worker: Any) -> None:
        """Called by distributed in the worker's process; compiles beside its event loop."""
        claim_cache(self._root)
        await asyncio.to_thread(warm, self._root)
