"""Whether a worker may compute chunks: it must be as the service is, and see the service's stores.

A worker with another kernel computes other numbers, and one that does not see the stores, or cannot load the
kernel, fails every chunk. They are refused before their first chunk, with the reason. Nothing here imports a
kernel or zarr at the top: a worker unpickles the plugin, and so imports this module, before it has claimed
its kernel cache.
"""

import hashlib
import pickle
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import invalidate_caches
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from worker.executors.errors import WorkerRefused

#: Libraries on whose versions stored numbers or bytes depend.
_LIBRARIES: Final = ("numpy", "numba", "zarr", "numcodecs")
#: Packages of this project whose sources decide what is stored.
_PACKAGES: Final = ("kernel", "worker")

#: Why this process, a worker, is refused; empty if it is not. Set by `judge`.
_refusal: list[str] = []


@dataclass(frozen=True)
class Probe:
    """A file among the stores that every worker must see: the same folder under the same path."""

    url: str  # of the folder, or prefix of a bucket, that holds the stores
    content: str


@dataclass(frozen=True)
class Requirements:
    """What a worker must have in common with the service. `facts`: as `facts()` gives them in the service."""

    facts: Mapping[str, str]
    probe: Probe | None = None

    def judge(self, threads: int, prepare: Callable[[], object] = lambda: None) -> str:
        """Why this process may not compute, and from now on does not; empty if it may.

        `threads`: how many chunks it would compute at once. `prepare` is called if there is no other reason;
        what it raises is one.
        """
        invalidate_caches()  # what could not be imported before may be there now
        wrong = self._differences(threads)
        if not wrong:
            try:
                prepare()
            except Exception as error:  # noqa: BLE001 - whatever it is, no chunk can be computed
                wrong.append(f"it cannot load the kernel: {_told(error)}")
        _refusal[:] = filter(None, ["; ".join(wrong)])
        return refusal()

    def _differences(self, threads: int) -> list[str]:
        try:
            here = facts()
        except Exception as error:  # noqa: BLE001 - a library that is not there, or is broken
            return [f"it cannot load the kernel: {_told(error)}"]
        wrong = [
            f"its {name} is {here.get(name)}, the service's {expected}"
            for name, expected in self.facts.items()
            if here.get(name) != expected
        ]
        if threads != 1:
            wrong.append(f"it has {threads} threads: start it with --nthreads 1")
        if self.probe is not None and (unseen := _unseen(self.probe)):
            wrong.append(unseen)
        return wrong


def facts() -> dict[str, str]:
    """What the stored bytes depend on in this process, by name.

    No feature of the processor beside its kind is among them: what the kernel computes with is rounded
    correctly everywhere (docs/accuracy.md).
    """
    from kernel.params import KERNEL_VERSION  # noqa: PLC0415 - see above

    return {
        "kernel version": KERNEL_VERSION,
        **{f"package {name}": _digest(name) for name in _PACKAGES},
        "Python": ".".join(platform.python_version_tuple()[:2]),
        **{name: _version(name) for name in _LIBRARIES},
        "kind of processor": platform.machine(),
    }


def refusal() -> str:
    """Why this process, a worker, is refused; empty if it is not."""
    return "".join(_refusal)


def run_if_admitted(call: bytes) -> Any:
    """What a function returns that is pickled with its arguments; WorkerRefused if this worker is refused.

    The scheduler gives a refused worker no task, but may have given it one before the worker was judged. Such
    a worker may not be able to unpickle it.
    """
    if _refusal:
        return WorkerRefused(_refusal[0])
    function, *arguments = pickle.loads(call)
    return function(*arguments)


def _digest(package: str) -> str:
    """Of the contents of a package's sources, not of their times: each machine has a copy of its own."""
    found = find_spec(package)
    folder = Path(next(iter(found.submodule_search_locations or ()))) if found else Path()
    digest = hashlib.sha256()
    for source in sorted(folder.rglob("*.py")):
        digest.update(f"{source.relative_to(folder)}\n".encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "missing"


def _unseen(probe: Probe) -> str:
    """Why the stores' folder is not the service's, or of no use; empty if it is."""
    try:
        from worker import store  # noqa: PLC0415 - see above

        found = store.read_marker(probe.url)
    except Exception as error:  # noqa: BLE001 - whatever keeps it from reading keeps it from computing
        return f"it cannot read {probe.url}, where the stores are: {_told(error)}"
    if found == probe.content:
        return (
            "" if store.is_writable(probe.url) else f"it cannot write into {probe.url}, where the stores are"
        )
    return f"it does not see the service's stores in {probe.url}: share that folder, under the same path"


def _told(error: Exception) -> str:
    """An error in one line; numpy's are of many."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
