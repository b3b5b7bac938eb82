"""Versions of this release, its kernel, Python, and the libraries that results may depend on."""

import json
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

from kernel.params import KERNEL_VERSION

LIBRARIES: Final = ("numpy", "numba", "dask", "distributed", "zarr", "fastapi", "uvicorn")

#: Runs of a job on different software that are kept, the first ones.
MAX_RUNS: Final = 100


class Software(NamedTuple):
    """What runs in this process."""

    release: str
    kernel_version: str
    python: str
    libraries: dict[str, str]


@cache
def software() -> Software:
    """The versions of what is installed."""
    libraries = {name: version(name) for name in LIBRARIES}
    return Software(version("bouncing-spring"), KERNEL_VERSION, platform.python_version(), libraries)


@cache
def processor() -> str:
    """Kind of processor, and its name where Linux tells it: `x86_64, AMD EPYC 7B13`."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return ", ".join(filter(None, (platform.machine(), next(names, ""))))


def with_this_run(runs: str, now: float) -> str:
    """A job's runs, as JSON, with that of this process, unless the last one was on the same software."""
    known: list[dict[str, Any]] = json.loads(runs)
    here = {
        "release": software().release,
        "python": software().python,
        "libraries": software().libraries,
        "processor": processor(),
    }
    same = known and {**known[-1], "began": None} == {**here, "began": None}
    return runs if same or len(known) >= MAX_RUNS else json.dumps([*known, {**here, "began": now}])
