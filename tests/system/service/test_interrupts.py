"""Ctrl-C on a terminal: exit code 130, no traceback, nothing left. More moments: `benchmarks.interrupts`."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from interrupted import Command
from paths import CACHE, ROOT
from scripted import DEADLINE

from benchmarks.interrupts import LONG, queue

Reached = Callable[[Command], bool]


def writes(text: str) -> Reached:
    return lambda command: text in command.output


def has_processes(number: int) -> Reached:
    return lambda command: len(command.processes()) >= number


def has_loaded(library: str) -> Reached:
    return lambda command: library in Path(f"/proc/{command.processes()[0]}/maps").read_text()


@pytest.mark.parametrize(
    ("words", "reached", "is_compiled"),
    [
        pytest.param(("figure", "2"), has_loaded("_multiarray_umath"), True, id="importing"),
        pytest.param(("figure", "2"), has_processes(4), True, id="starting workers"),
        pytest.param(("run", "long.json", "-o", "long.zarr"), writes("compiling"), False, id="compiling"),
        pytest.param(("serve", "--port", "0"), writes("chunks done"), True, id="serving and computing"),
    ],
)
def test_ctrl_c_ends_everything(tmp_path: Path, words: tuple[str, ...], reached: Reached, is_compiled: bool):
    (tmp_path / "long.json").write_text(json.dumps(LONG))
    if words[0] == "serve":
        queue(tmp_path)
    command = Command(words, tmp_path, CACHE if is_compiled else tmp_path / "cache")
    command.wait_for(reached)
    ended = command.interrupt()
    assert ended is not None
    # On an overloaded machine it takes longer; `benchmarks.interrupts` measures.
    assert [fault for fault in ended.faults if not fault.endswith(" s")] == [], ended.output
    assert ended.seconds < 10.0


def test_what_workers_shared_is_removed_without_a_word_whenever_a_command_ends():
    """Ctrl-C may come in the instant between the making of a worker's queues and its start."""
    code = (
        "import multiprocessing, os, sys; from service.cli import entry;"
        "queue = multiprocessing.get_context('spawn').Queue();"
        "sys.stdout.write(queue._rlock._semlock.name);"
        "entry._end_now()"
    )
    # Its standard error closes with the last process that has it: the tracker of what is shared.
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False, timeout=DEADLINE
    )
    assert (done.returncode, done.stderr) == (130, "")
    assert not Path(f"/dev/shm/sem.{done.stdout.removeprefix('/')}").exists()
