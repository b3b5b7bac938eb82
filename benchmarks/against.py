"""This version's kernel against another's, alternating in one run.

    git worktree add ../before COMMIT
    python -m benchmarks.against ../before [--repeat 7] [--processes 3] [--only rest,ramp] [--fixed]

Each version has a process of its own and both compute the same random cells in turn: Gamma 0.3 to 6, Omega
0.2 to 2, xi 0.01 to 1, 200 + 100 plate periods; on a ramp, lines of 50 cells of Gamma. Each ends a cell as it
does by default: once its cycle is certified, or, where it cannot, once its flights surely follow one. With
`--fixed` both compute every cycle. Prints core-microseconds per cell, medians over the repetitions, the
median ratio of the two runs of a repetition, which holds on a busy machine too, and the share of cells with
the same outcome and mode: chaotic cells may differ where the last digit does. A process may be a tenth faster
or slower throughout, so that the ratio is the median over several pairs of them.
"""

import importlib
import inspect
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

LENGTH = 50
PERIODS = {"settle": 200, "observe": 100}
UNTIL = 5000  # plate periods that a cell still settling may take in all, where cycles are certified
MICRO_FLIGHT = 0.05
SOFT = {"restitution": 0.01, "penetration": 1e-3, "adhesive": True}


class Case(NamedTuple):
    """One row of the table."""

    model: str
    options: dict[str, float | bool]  # of the plate; numbers are for every cell
    cells: int = 0
    lines: int = 0  # of a ramp
    keep: int = 16  # flights; with restitution a cycle has many hops


CASES = {
    "rigid from rest": Case("rigid", {"restitution": 0.0}, 2000),
    "rigid from rest, e = 0.3": Case("rigid", {"restitution": 0.3}, 2000, keep=128),
    "rigid ramp, 200 lines": Case("rigid", {"restitution": 0.0}, lines=200),
    "rigid ramp, 32 lines": Case("rigid", {"restitution": 0.0}, lines=32),
    "rigid ramp, 8 lines": Case("rigid", {"restitution": 0.0}, lines=8),
    "rigid ramp, 1 line": Case("rigid", {"restitution": 0.0}, lines=1),
    "soft, adhesive, d = 1e-3": Case("soft", SOFT, 2000),
    "soft, adhesive, d = 1e-6": Case("soft", SOFT | {"penetration": 1e-6}, 2000),
    "soft, nonadhesive, d = 1e-3": Case("soft", SOFT | {"adhesive": False}, 2000),
    "soft ramp, 100 lines": Case("soft", SOFT, lines=100),
    "soft ramp, 16 lines": Case("soft", SOFT, lines=16),
    "soft ramp, 4 lines": Case("soft", SOFT, lines=4),
    "ball, e = 0.3": Case("ball", {"restitution": 0.3}, 2000, keep=128),
}


def cells_of(case: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gamma, Omega and xi of a case's cells, the same in every version."""
    random = np.random.default_rng(1)
    n = case.lines or case.cells
    gamma, omega, xi = random.uniform(0.3, 6, n), random.uniform(0.2, 2, n), 10 ** random.uniform(-2, 0, n)
    if not case.lines:
        return gamma, omega, xi
    ramp = np.tile(np.linspace(0.3, 6, LENGTH), n)
    return ramp, np.repeat(omega, LENGTH), np.repeat(xi, LENGTH)


def ending(run: Any, case: Case) -> dict[str, Any]:
    """The options of `run`, a version's LineRun, by which it ends a case's cells by default."""
    names = inspect.signature(run).parameters
    if "certify" in names:
        return {"certify": True, "settle_until": UNTIL}
    return {"settle_early": not case.lines} if "settle_early" in names else {}


def runner(case: Case, fixed: bool) -> Callable[[], Any]:
    """Computes a case with the kernel that is imported: the record of its cells."""
    line = importlib.import_module("kernel.line")
    model = importlib.import_module(f"kernel.models.{case.model}")
    cells = cells_of(case)
    n = len(cells[0])
    plate = model.plate(**{k: v if isinstance(v, bool) else np.full(n, v) for k, v in case.options.items()})
    options: dict[str, Any] = {"keep": case.keep, "micro_flight": MICRO_FLIGHT, **PERIODS}
    options |= {} if fixed else ending(line.LineRun, case)
    options |= {"start": [None] * case.lines} if case.lines else {}
    return lambda: line.run_line(*cells, plate=plate, carry=bool(case.lines), **options)


def answer(tree: str, fixed: bool) -> None:
    """The process of one version: computes the cases named on its input, one line each."""
    sys.path.insert(0, tree)
    runs: dict[str, Callable[[], Any]] = {}
    for name in map(str.strip, sys.stdin):
        if name not in runs:
            runs[name] = runner(CASES[name], fixed)
            runs[name]()  # compiles
        began = time.process_time()
        record = runs[name]()
        seconds = time.process_time() - began
        modes = [getattr(record, field).tolist() for field in ("outcome", "bounces", "periods")]
        print(json.dumps({"seconds": seconds, "modes": modes}), flush=True)


class Version:
    """A version's process."""

    def __init__(self, tree: Path, fixed: bool) -> None:
        command = [sys.executable, __file__, "--answer", str(tree.resolve()), *["--fixed"] * fixed]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def run(self, name: str) -> dict[str, Any]:
        """Seconds and modes of a case."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(name + "\n")
        self._process.stdin.flush()
        answered: dict[str, Any] = json.loads(self._process.stdout.readline())
        return answered

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def main() -> None:
    """Print the table."""
    from benchmarks.measuring import HERE, describe, options, ratio, short, table

    given = options(__doc__, tree=Path, repeat=7, processes=3, only="", fixed=False)
    names = [name for name in CASES if any(word in name for word in given.only.split(","))]
    print(describe(), flush=True)
    times: dict[str, list[Any]] = {name: [] for name in names}
    same: dict[str, float] = {}
    for _ in range(given.processes):
        versions = [Version(tree, given.fixed) for tree in (given.tree, HERE)]
        for name in names:
            runs = [[version.run(name) for version in versions] for _ in range(given.repeat)]
            times[name].append([[run["seconds"] for run in both] for both in runs])
            modes = (np.equal(*pair) for pair in zip(*(run["modes"] for run in runs[0]), strict=True))
            same[name] = np.logical_and.reduce(list(modes)).mean()
        for version in versions:
            version.close()
    rows = []
    for name in names:
        cells = len(cells_of(CASES[name])[0])
        ratios = sorted(ratio(np.array(process), 1) for process in times[name])
        medians = np.median(times[name], axis=(0, 1)) / cells * 1e6
        spread = f"{ratios[0]:.2f} to {ratios[-1]:.2f}"
        rows.append((name, *map(short, medians), f"{np.median(ratios):.2f}", spread, f"{same[name]:.1%}"))
    print(
        table(
            ["", "before, µs a cell", "now, µs a cell", "ratio", "of processes", "same outcome and mode"],
            rows,
        )
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--answer"]:
        answer(sys.argv[2], "--fixed" in sys.argv)
    else:
        main()
