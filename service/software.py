"""Versions of this release, its kernel, Python, and the libraries that results may depend on."""

import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Final, NamedTuple

from kernel.params import KERNEL_VERSION

LIBRARIES: Final = ("numpy", "numba", "dask", "distributed", "zarr", "fastapi", "uvicorn")


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
