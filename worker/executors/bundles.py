"""Tasks submitted at the same time go to Dask's scheduler in one message.

The scheduler takes about as long for one task as for many. Each task is sent as bytes and unpickled when it
runs, because a worker that cannot unpickle a message ends.
"""

import asyncio
import pickle
from collections import defaultdict
from typing import Any, Final, NamedTuple

from distributed.protocol.pickle import dumps

from worker.executors.admission import run_if_admitted

#: Seconds that a task waits for others.
WAIT_SECONDS: Final = 0.002
#: Tasks with the same workers share a message if their priorities differ by less than this, in seconds.
SAME_PRIORITY: Final = 1.0


class Call(NamedTuple):
    """A function with its arguments, and the only workers that may run it (none: all may)."""

    arguments: tuple[Any, ...]
    priority: float
    workers: tuple[str, ...] = ()


class Bundles:
    """Collects calls and submits those of equal priority together; used only in the client's event loop."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Any, Call, asyncio.Future[Any]]] = []

    async def add(self, client: Any, call: Call) -> Any:
        """The Dask future of a call. Raises the errors of submitting it."""
        loop = asyncio.get_running_loop()
        submitted: asyncio.Future[Any] = loop.create_future()
        self._waiting.append((client, call, submitted))
        if len(self._waiting) == 1:
            loop.call_later(WAIT_SECONDS, self._submit)
        return await submitted

    def _submit(self) -> None:
        bundles = defaultdict(list)
        for client, call, submitted in self._waiting:
            if not submitted.done():  # cancelled meanwhile
                key = client, call.workers, call.priority // SAME_PRIORITY
                bundles[key].append((call, submitted))
        self._waiting = []
        for (client, workers, _), bundle in bundles.items():
            try:
                futures = client.map(
                    pickle.loads,
                    [pickle.dumps(_Admitted(call.arguments)) for call, _ in bundle],
                    key=run_if_admitted.__name__,
                    pure=False,
                    priority=max(call.priority for call, _ in bundle),
                    workers=list(workers) or None,
                )
            except Exception as error:  # noqa: BLE001 - every call gets the error
                for _, submitted in bundle:
                    submitted.set_exception(error)
                continue
            for (_, submitted), future in zip(bundle, futures, strict=True):
                submitted.set_result(future)


class _Admitted:
    """A function and its arguments, which unpickle as a call of `run_if_admitted`.

    Scheduler and worker need nothing of this project until a worker runs it.
    """

    def __init__(self, call: tuple[Any, ...]) -> None:
        self._call = call

    def __reduce__(self) -> Any:
        return run_if_admitted, (dumps(self._call),)  # type: ignore[no-untyped-call]
