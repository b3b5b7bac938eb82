"""Versions of this release, its kernel, Python, and the libraries that results may depend on."""

import platform
from functools import cache
from importlib.metadata import version
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
