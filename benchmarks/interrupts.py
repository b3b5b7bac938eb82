"""Ctrl-C at random moments of `bounce figure`, `serve`, `run` and `submit --wait`: how it ends, what is left.

    python -m benchmarks.interrupts [--moments 10] [--seed 7] [--warm FOLDER] [commands]

Each command runs on a terminal of its own, half of the times without compiled kernels. It must end within 2 s
with exit code 130, without a traceback or a line of Dask's, and leave no process, no temporary folder and no
lock. `--warm` names a folder of compiled kernels; without one they are compiled first.
"""

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, Final

from benchmarks.machine import describe
from tests.support.interrupted import Command, Ended

#: Computes for minutes.
LONG: Final[dict[str, Any]] = {
    "name": "long",
    "gamma": {"start": 1.0, "stop": 6.0, "num": 20_000},
    "omega": [0.5, 0.6],
    "xi": 0.26,
    "model": {"kind": "rigid"},
    "settle": 20_000,
    "settle_early": False,
}
#: Seconds until a command has done, or has reached what it goes on doing: with compiled kernels, and without.
SPANS: Final = {"figure": (14.0, 40.0), "serve": (14.0, 40.0), "run": (6.0, 25.0), "submit": (3.0, 3.0)}
WORDS: Final = {
    "figure": ("figure", "2"),
    "serve": ("serve", "--port", "0"),
    "run": ("run", "long.json", "-o", "long.zarr"),
    "submit": ("submit", "long.json", "--wait"),
}


def interrupted(name: str, moment: float, folder: Path, cache: Path, **variables: str) -> Ended | None:
    """The end of a command after Ctrl-C at `moment` seconds; None if it had ended before."""
    (folder / "long.json").write_text(json.dumps(LONG))
    if name == "serve":
        queue(folder)
    command = Command(WORDS[name], folder, cache, variables)
    command.sleep(moment)
    return command.interrupt()


def queue(folder: Path) -> None:
    """Have a job for a service to compute in its data folder."""
    from service.jobs.manager import JobManager
    from service.jobs.stores.adoption import open_ledger
    from service.settings import Settings
    from worker.executors.inline import Inline
    from worker.spec import SweepSpec

    settings = Settings(data=folder / "bounce-data")
    settings.data.mkdir(mode=0o700)
    with open_ledger(settings) as ledger, closing(Inline()) as executor:
        JobManager(ledger, executor, settings).submit(SweepSpec(**LONG))


def warmed(cache: Path) -> None:
    """Compile all kernels into a cache."""
    code = f"from worker.kernel_cache import use_cache; use_cache({str(cache)!r})"
    subprocess.run([sys.executable, "-c", code], check=True)


@contextmanager
def serving(folder: Path, cache: Path) -> Iterator[str]:
    """The address of a service, for `submit`."""
    folder.mkdir()
    command = Command(WORDS["serve"], folder, cache)
    try:
        command.wait_for(lambda command: "listens on " in command.output)
        yield command.output.rpartition("listens on ")[2].split()[0]
    finally:
        command.interrupt()


def last_line(ended: Ended | None) -> str:
    """What the command had last written before Ctrl-C, which tells where it was."""
    lines = (ended.output if ended else "").partition("^C")[0].replace("\r", "\n").splitlines()
    return next((line.strip()[:100] for line in reversed(lines) if line.strip()), "nothing")


def main() -> None:
    """Print a table, a row for every moment."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commands", nargs="*", default=list(WORDS))
    parser.add_argument("--moments", type=int, default=10)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--warm", type=Path)
    arguments = parser.parse_args()
    chance = random.Random(arguments.seed)
    print(describe("distributed"), f"load {os.getloadavg()[0]:.1f}", flush=True)
    with ExitStack() as stack:
        root = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        warm = arguments.warm or root / "warm"
        warmed(warm)
        bad = sum(measure(name, arguments.moments, chance, root, warm) for name in arguments.commands)
    print(f"{bad} with a fault")
    sys.exit(bool(bad))


def measure(name: str, moments: int, chance: random.Random, root: Path, warm: Path) -> int:
    """Print the rows of a command; how many have a fault."""
    bad, slowest = 0, 0.0
    with ExitStack() as stack:
        variables = {}
        if name == "submit":
            variables["BOUNCE_URL"] = stack.enter_context(serving(root / "service", warm))
        for number in range(moments):
            cold = bool(number % 2)
            moment = chance.uniform(0.1, SPANS[name][cold])
            folder = root / f"{name}-{number}"
            folder.mkdir()
            cache = folder / "cache" if cold else warm
            ended = interrupted(name, moment, folder, cache, **variables)
            faults: Sequence[str] = ["ended before"] if ended is None else ended.faults
            if ended is not None:
                slowest = max(slowest, ended.seconds)
                bad += bool(faults)
            took = "" if ended is None else f"{ended.seconds:5.2f} s"
            state = "cold" if cold else "warm"
            print(f"{name:<8}{state:<6}at {moment:5.2f} s  {took:<10}{'; '.join(faults) or 'ok'}", flush=True)
            print(f"        last line before: {last_line(ended)}", flush=True)
            shutil.rmtree(folder, ignore_errors=True)
    print(f"{name:<8}slowest {slowest:.2f} s", flush=True)
    return bad


if __name__ == "__main__":
    main()
