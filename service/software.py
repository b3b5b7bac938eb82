"""Versions of this release, its kernel, Python, and the libraries that results may depend on."""

import json
import platform
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

from pydantic import Field, TypeAdapter

from kernel.params import KERNEL_VERSION

LIBRARIES: Final = ("numpy", "numba", "dask", "distributed", "zarr", "fastapi", "uvicorn")

#: Limit on the runs of a job that are kept; further ones are not recorded.
MAX_RUNS: Final = 100

#: One line, which every format of files can hold: a run may come from another service's file.
_Text = Annotated[str, Field(max_length=200, pattern=r"^\P{C}*$")]

#: Seconds since 1970, up to the year 9999.
_Time = Annotated[float, Field(ge=0.0, lt=253_402_300_800.0)]


@dataclass(frozen=True)
class Run:
    """What computed a job, or a part of it."""

    release: _Text
    python: _Text
    libraries: Annotated[dict[_Text, _Text], Field(max_length=100)]
    processor: _Text
    began: _Time


_RUNS: Final = TypeAdapter(Annotated[list[Run], Field(max_length=MAX_RUNS)])


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


def checked_runs(runs: bytes) -> str:
    """A job's runs, as JSON, from another service. Raises ValueError."""
    return _RUNS.dump_json(_RUNS.validate_json(runs)).decode()


def with_this_run(runs: str, now: float) -> str:
    """A job's runs, as JSON, with the run of this process, unless the last one had the same software."""
    earlier: list[dict[str, Any]] = json.loads(runs)
    here = software()
    run = asdict(Run(here.release, here.python, here.libraries, processor(), now))
    same = earlier and {**earlier[-1], "began": now} == run
    # in the form of an import, so that a file of either job has the same checksum
    return runs if same or len(earlier) >= MAX_RUNS else checked_runs(json.dumps([*earlier, run]).encode())
