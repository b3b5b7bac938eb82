"""What compiling costs: commands with an empty cache, against another checkout's, in turn.

    python -m benchmarks.compiling [--repeat 3] [--against FOLDER] [commands]

Runs `bounce figure 2`, `bounce run` of one `rigid` and of one `soft` sweep, and a process that compiles every
kernel that an image has, each in an empty folder for its cache. Prints the medians of the processor time of
all processes that a command starts, and of the wall time, and each as a share of `bounce figure 2` of the
other checkout (of this one without `--against`). FOLDER is a checkout with an environment of its own in
`.venv`.
"""

import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from benchmarks.measuring import HERE, describe, options, short, table

_GRID: Final[dict[str, Any]] = {"gamma": {"start": 0.5, "stop": 6.0, "num": 111}, "omega": 0.5, "xi": 0.26}
_MODELS: Final[dict[str, Any]] = {
    "rigid": {"kind": "rigid"},
    "soft": {"kind": "soft", "restitution": 0.01, "penetration": 1e-3},
}
COMMANDS: Final = ("figure 2", "rigid", "soft", "all models")


class Cost(NamedTuple):
    """Seconds."""

    processor: float
    wall: float


def words(checkout: Path, command: str, folder: Path) -> list[str]:
    """The command line, which writes into `folder` only."""
    programs = Path(sys.executable).parent if checkout == HERE else checkout / ".venv" / "bin"
    picture = str(folder / "diagram.png")
    if command == "figure 2":
        return [str(programs / "bounce"), "figure", "2", "-o", picture]
    if command in _MODELS:
        (folder / "sweep.json").write_text(json.dumps({**_GRID, "model": _MODELS[command]}))
        return [str(programs / "bounce"), "run", str(folder / "sweep.json"), "-o", picture]
    return [str(programs / "python"), "-m", "worker.kernel_cache"]


def cost(checkout: Path, command: str) -> Cost:
    """What a command costs with an empty cache."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": str(checkout)}
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        line = words(checkout, command, folder)
        subprocess.run(line, env=environment, cwd=folder, capture_output=True, check=True)
        wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return Cost(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall)


def main() -> None:
    """Print the table."""
    given = options(__doc__, commands=list(COMMANDS), repeat=3, against="")
    checkouts = {"this checkout": HERE} | (
        {"the other": Path(given.against).resolve()} if given.against else {}
    )
    print(describe(), flush=True)
    medians = {}
    for command in given.commands:
        costs: dict[str, list[Cost]] = {name: [] for name in checkouts}
        for _ in range(given.repeat):
            for name, checkout in checkouts.items():
                costs[name].append(cost(checkout, command))
        for name, each in costs.items():
            medians[command, name] = Cost(*map(statistics.median, zip(*each, strict=True)))
        print(command, costs, flush=True)
    whole = medians.get(("figure 2", list(checkouts)[-1]))
    rows = []
    for (command, name), spent in medians.items():
        shares = map(short, np.divide(spent, whole)) if whole else ("", "")
        rows.append((command, name, *map(short, spent), *shares))
    heads = ["", "checkout", "processor, s", "wall, s", "share of processor", "share of wall"]
    print("\n" + table(heads, rows))


if __name__ == "__main__":
    main()
