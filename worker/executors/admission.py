"""Worker admission: same code and library versions as the service, and access to its stores.

A worker with another kernel computes other numbers; one without the stores, or unable to load the kernel,
fails every chunk. Such workers are refused before their first chunk, with the reason. Nothing here imports a
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
#: Packages of this project whose sources determine the stored numbers.
_PACKAGES: Final = ("kernel", "worker")

#: Why this worker process is refused; empty if it is admitted. Set by `judge`.
_refusal: list[str] = []


@dataclass(frozen=True)
class Probe:
    """A file beside the stores that every worker must see: the same folder under the same path."""

    url: str  # of the folder, or prefix of a bucket, that holds the stores
    content: str


@dataclass(frozen=True)
class Requirements:
    """What a worker must have in common with the service. `facts`: the service's own `facts()`."""

    facts: Mapping[str, str]
    probe: Probe | None = None

    def judge(self, threads: int, prepare: Callable[[], object] = lambda: None) -> str:
        """Admit or refuse this process; return why it is refused, empty if it is admitted.

        `threads`: chunks it would compute at once. `prepare` is called if nothing else is wrong; its error is
        a reason too.
        """
        invalidate_caches()  # modules may have been installed since
        wrong = self._differences(threads)
        if not wrong:
            try:
                prepare()
            except Exception as error:  # noqa: BLE001 - any error means that it cannot compute
                wrong.append(f"it cannot load the kernel: {_one_line(error)}")
        _refusal[:] = filter(None, ["; ".join(wrong)])
        return refusal()

    def _differences(self, threads: int) -> list[str]:
        try:
            own = facts()
        except Exception as error:  # noqa: BLE001 - a missing or broken library
            return [f"it cannot load the kernel: {_one_line(error)}"]
        wrong = [
            f"its {name} is {own.get(name)}, the service's {expected}"
            for name, expected in self.facts.items()
            if own.get(name) != expected
        ]
        if threads != 1:
            wrong.append(f"it has {threads} threads: start it with --nthreads 1")
        if self.probe is not None and (unseen := _unseen(self.probe)):
            wrong.append(unseen)
        return wrong


def facts() -> dict[str, str]:
    """What the stored bytes depend on in this process, by name.

    Of the processor only its kind counts: the kernel's operations are rounded correctly everywhere
    (docs/accuracy.md).
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
    """Why this worker process is refused; empty if it is admitted."""
    return "".join(_refusal)


def run_if_admitted(call: bytes) -> Any:
    """Call a function pickled with its arguments; raises WorkerRefused on a refused worker.

    The scheduler gives a refused worker no tasks, but may have done so before the worker was judged. Such
    a worker may be unable to unpickle them.
    """
    if _refusal:
        return WorkerRefused(_refusal[0])
    function, *arguments = pickle.loads(call)
    return function(*arguments)


def _digest(package: str) -> str:
    """Digest of the contents of a package's sources; not of their times, which differ between machines."""
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
    """Why the stores' folder is another one or unusable; empty if it is the service's."""
    try:
        from worker import store  # noqa: PLC0415 - see above

        found = store.read_marker(probe.url)
    except Exception as error:  # noqa: BLE001 - without the stores it cannot compute
        return f"it cannot read {probe.url}, where the stores are: {_one_line(error)}"
    if found == probe.content:
        return (
            "" if store.is_writable(probe.url) else f"it cannot write into {probe.url}, where the stores are"
        )
    return f"it does not see the service's stores in {probe.url}: share that folder, under the same path"


def _one_line(error: Exception) -> str:
    """The error on one line; numpy's have many."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
