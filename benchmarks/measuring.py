"""What benchmarks share: options, tables, the machine's description, alternating runs, a service."""

import argparse
import importlib.metadata
import os
import platform
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from service.client import Client
    from worker.executors.base import Executor

#: The checkout of this file.
HERE = Path(__file__).parents[1]


def options(text: str | None, **defaults: Any) -> argparse.Namespace:
    """The command line of a benchmark, with its docstring as help: an option of the type of each default.

    False: a switch. A tuple: as many values. A list: words of it, all unless some are given. A type: a word
    that must be given.
    """
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in defaults.items():
        flags = ["-o", "--output"] if name == "output" else [f"--{name.replace('_', '-')}"]
        if isinstance(default, type):
            parser.add_argument(name, type=default)
        elif isinstance(default, list):
            parser.add_argument(name, nargs="*", default=default, help=", ".join(default))
        elif default is False:
            parser.add_argument(*flags, action="store_true")
        elif isinstance(default, tuple):
            parser.add_argument(*flags, type=type(default[0]), nargs=len(default), default=default)
        else:
            parser.add_argument(*flags, type=type(default), default=default)
    return parser.parse_args()


def describe(*packages: str) -> str:
    """One line: processor, cores, load, and versions of Python, numpy, numba and `packages`."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.processor()
    versions = [
        f"{package} {importlib.metadata.version(package)}" for package in ("numpy", "numba", *packages)
    ]
    return (
        f"{model}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; "
        f"Python {platform.python_version()}, {', '.join(versions)}"
    )


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table: first column left-aligned, the others right-aligned, padded to equal widths."""
    cells = [[str(cell) for cell in row] for row in (head, *rows)]
    widths = [max(3, *(len(row[column]) for row in cells)) for column in range(len(head))]

    def line(row: Sequence[str]) -> str:
        padded = [row[0].ljust(widths[0])]
        padded += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        return f"| {' | '.join(padded)} |"

    rule = [":" + "-" * (widths[0] - 1), *("-" * (width - 1) + ":" for width in widths[1:])]
    return "\n".join([line(cells[0]), f"| {' | '.join(rule)} |", *map(line, cells[1:])])


def short(value: float, digits: int = 3) -> str:
    """A number with `digits` significant digits; large ones in full, with thousands separators."""
    return f"{value:.{digits}g}" if abs(value) < 10**digits else f"{value:,.0f}"


def seconds(run: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """The time of one run by `clock`."""
    start = clock()
    run()
    return clock() - start


def alternating(
    runs: Sequence[Callable[[], object]], repeat: int, clock: Callable[[], float] = time.process_time
) -> NDArray[np.float64]:
    """Times (repeat, runs) by `clock`, s. The runs alternate; a first round, which may compile, is not timed.

    A change in the machine's speed meets all runs of a round, so ratios within rounds hold on a busy machine.
    """
    for run in runs:
        run()
    return np.array([[seconds(run, clock) for run in runs] for _ in range(repeat)])


def ratio(times: NDArray[np.float64], run: int, over: int = 0) -> float:
    """The median over the rounds of `alternating` of one run's time over another's."""
    return float(np.median(times[:, run] / times[:, over]))


class Running(NamedTuple):
    """A service in this process."""

    client: "Client"
    url: str
    data: Path


@contextmanager
def service(executor: "Executor | None" = None, **settings: Any) -> Iterator[Running]:
    """A service on a free port with a temporary data folder, and two workers unless told otherwise."""
    from service.client import Client
    from service.server import embedded
    from service.settings import read_settings

    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder)
        given = {"workers": 2, **settings} if executor is None else settings
        chosen = read_settings(data=data, host="127.0.0.1", port=0, **given)
        with embedded.running(chosen, executor) as url, Client(url) as client:
            yield Running(client, url, data)
