"""Ctrl-C on a terminal, and SIGTERM: exit code 128 + the signal, no traceback, nothing left."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from interrupted import Command
from paths import CACHE, ROOT
from scripted import DEADLINE
from studies import spec_of

from service.jobs.manager import JobManager
from service.jobs.stores.opening import open_ledger
from service.settings import Settings
from worker.executors.inline import Inline
from worker.sweep import SweepSpec

#: Computes for minutes.
LONG = spec_of((1.0, 6.0, 20_000), [0.5, 0.6], 0.26, name="long", settle=20_000)

RUN = ("run", "long.json", "-o", "long.zarr")

Reached = Callable[[Command], bool]


def queue(folder: Path) -> None:
    """Have a job for a service to compute in its data folder."""
    settings = Settings(data=folder / "bounce-data")
    settings.data.mkdir(mode=0o700)
    with open_ledger(settings) as ledger, closing(Inline()) as executor:
        JobManager(ledger, executor, settings).submit(SweepSpec(**LONG))


def writes(text: str) -> Reached:
    return lambda command: text in command.output


def has_loaded_numpy(command: Command) -> bool:
    return "_multiarray_umath" in Path(f"/proc/{command.processes()[0]}/maps").read_text()


def has_processes(command: Command) -> bool:
    return len(command.processes()) >= 4


@pytest.mark.parametrize(
    ("words", "reached", "is_compiled", "number"),
    [
        pytest.param(("figure", "2"), has_loaded_numpy, True, signal.SIGINT, id="importing"),
        pytest.param(("figure", "2"), has_processes, True, signal.SIGINT, id="starting workers"),
        pytest.param(RUN, writes("compiling"), False, signal.SIGTERM, id="compiling"),
        pytest.param(("serve", "--port", "0"), writes("chunks done"), True, signal.SIGINT, id="serving"),
        pytest.param(("serve", "--port", "0"), writes("chunks done"), True, signal.SIGHUP, id="hung up"),
    ],
)
def test_a_signal_ends_everything(
    tmp_path: Path, words: tuple[str, ...], reached: Reached, is_compiled: bool, number: int
):
    (tmp_path / "long.json").write_text(json.dumps(LONG))
    if words[0] == "serve":
        queue(tmp_path)
    command = Command(words, tmp_path, CACHE if is_compiled else tmp_path / "cache")
    command.wait_for(reached)
    ended = command.interrupt(number)
    assert ended.faults == [], ended.output
    assert ended.seconds < 10.0 * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def ran(code: str) -> subprocess.CompletedProcess[str]:
    """A process that ran this code; its standard error ends with the last process that has it."""
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=DEADLINE)


def test_a_signal_within_a_finalizer_ends_a_command():
    """The import system has finalizers, in which Python ignores what is raised."""
    code = (
        "import signal, threading, weakref; from service.cli import entry;"
        "signal.signal(signal.SIGINT, entry._end);"
        "owner = threading.Event();"
        "reference = weakref.ref(owner, lambda _: signal.raise_signal(signal.SIGINT));"
        "del owner;"
        "threading.Event().wait(60)"
    )
    done = ran(code)
    assert (done.returncode, done.stderr.strip()) == (130, "")


def test_what_workers_shared_is_removed_without_a_word_whenever_a_command_ends():
    """Ctrl-C may come in the instant between the making of a worker's queues and its start."""
    code = (
        "import multiprocessing, os, sys; from service.cli import entry;"
        "queue = multiprocessing.get_context('spawn').Queue();"
        "sys.stdout.write(queue._rlock._semlock.name);"
        "entry._end_now(130)"
    )
    done = ran(code)
    assert (done.returncode, done.stderr) == (130, "")
    assert not Path(f"/dev/shm/sem.{done.stdout.removeprefix('/')}").exists()
