"""Versions of this release, its kernel, Python, and the libraries that results may depend on."""

import json
import platform
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

from kernel.params import KERNEL_VERSION

LIBRARIES: Final = ("numpy", "numba", "dask", "distributed", "zarr", "fastapi", "uvicorn")

#: Limit on the runs of a job that are kept; further ones are not recorded.
MAX_RUNS: Final = 100


class Software(NamedTuple):
    """The versions of the software in this process."""

    release: str
    kernel_version: str
    python: str
    libraries: dict[str, str]


@cache
def software() -> Software:
    """The versions of the installed software."""
    libraries = {name: version(name) for name in LIBRARIES}
    return Software(version("bouncing-spring"), KERNEL_VERSION, platform.python_version(), libraries)


@cache
def processor() -> str:
    """Kind of processor, and on Linux its name: `x86_64, AMD EPYC 7B13`."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return f"{platform.machine()}, {line.partition(':')[2].strip()}"
    return platform.machine()


def with_this_run(runs: str, now: float) -> str:
    """A job's runs, as JSON, with the run of this process, unless the last one had the same software."""
    earlier: list[dict[str, Any]] = json.loads(runs)
    run = software()._asdict() | {"processor": processor()}
    del run["kernel_version"]
    same = earlier and {**earlier[-1], "began": None} == {**run, "began": None}
    return runs if same or len(earlier) >= MAX_RUNS else json.dumps([*earlier, {**run, "began": now}])
