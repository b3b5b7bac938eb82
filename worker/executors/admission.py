"""Whether a worker may compute chunks: it must be as the service is, and see the service's stores.

A worker with another kernel computes other numbers, and one that does not see the stores fails every chunk.
Both are refused before their first chunk, with the reason. Nothing here imports a kernel or zarr at the top:
a worker unpickles the plugin, and so imports this module, before it has claimed its kernel cache.
"""

import hashlib
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, TypeVar

from worker.executors.errors import WorkerRefused

Result = TypeVar("Result")

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

    def judge(self, threads: int) -> str:
        """Why this process may not compute, and from now on does not; empty if it may.

        `threads`: how many chunks it would compute at once.
        """
        _refusal[:] = filter(None, ["; ".join(self._differences(threads))])
        return "".join(_refusal)

    def _differences(self, threads: int) -> list[str]:
        here = facts()
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


def run_if_admitted(function: Callable[..., Result], *arguments: Any) -> "Result | WorkerRefused":
    """`function(*arguments)`, unless this worker is refused.

    The scheduler gives a refused worker no task, but may have given it one before the worker was judged.
    """
    return WorkerRefused(_refusal[0]) if _refusal else function(*arguments)


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
    """Why the stores' folder is not the service's; empty if it is."""
    from worker import store  # noqa: PLC0415 - see above

    try:
        found = store.read_probe(probe.url)
    except Exception as error:  # noqa: BLE001 - whatever keeps it from reading keeps it from computing
        return f"it cannot read {probe.url}, where the stores are: {type(error).__name__}: {error}"
    if found == probe.content:
        return ""
    return f"it does not see the service's stores in {probe.url}: share that folder, under the same path"
