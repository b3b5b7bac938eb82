"""A command on a terminal of its own, ended by Ctrl-C: how it ended, how soon, and its leftovers."""

import fcntl
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from paths import ROOT
from scripted import wait_for

#: Seconds until remaining processes are killed, on an overloaded machine.
LIMIT = 240.0
CTRL_C = b"\x03"
#: Output that nobody wants to read after Ctrl-C.
NOISE = re.compile(r"Traceback|Exception ignored|distributed|Nanny|tornado|leaked|Aborted!", re.IGNORECASE)


class Ended(NamedTuple):
    """How a command ended."""

    code: int | None
    number: int  # of the signal
    seconds: float  # from the signal until it and all that it started had ended
    output: str
    left: tuple[str, ...]  # processes, temporary files, held locks

    @property
    def faults(self) -> list[str]:
        """The faults: code, lines of the output, leftovers."""
        # Before Python has started, the signal itself ends it; a shell says 128 + the signal of that, too.
        faults = [f"exit code {self.code}"] if self.code not in (128 + self.number, -self.number) else []
        faults += sorted({line.strip()[:160] for line in self.output.splitlines() if NOISE.search(line)})
        return faults + [f"left: {name}" for name in self.left]


class Command:
    """`bounce WORDS` in `folder`, with a terminal, temporary files in `folder`/tmp and kernels in `cache`."""

    def __init__(self, words: Sequence[str], folder: Path, cache: Path) -> None:
        self._folder, self._temporary = folder, folder / "tmp"
        self._temporary.mkdir(parents=True, exist_ok=True)
        self._ours, theirs = pty.openpty()
        variables = {"TMPDIR": str(self._temporary), "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "service.cli.entry", *words],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            cwd=folder,
            env=os.environ | variables,
            start_new_session=True,
            preexec_fn=_on_its_terminal,  # noqa: PLW1509
        )
        os.close(theirs)
        self._output = bytearray()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def output(self) -> str:
        """The output so far."""
        return self._output.decode(errors="replace")

    def wait_for(self, condition: Callable[["Command"], bool]) -> None:
        """Wait until the condition holds. Raises AssertionError if the command ends before."""

        def holds() -> bool:
            assert self._process.poll() is None, self.output
            return condition(self)

        wait_for(holds, lambda: self.output)

    def processes(self) -> list[int]:
        """The processes of the command's session that have not ended, itself among them."""
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if fields[0] != "Z" and int(fields[3]) == self._process.pid:
                found.append(int(folder.name))
        return found

    def interrupt(self, number: int) -> Ended:
        """Press Ctrl-C, or send another signal, and wait for the end."""
        if number == signal.SIGINT:
            os.write(self._ours, CTRL_C)
        else:
            self._process.send_signal(number)
        began = time.monotonic()
        while (alive := self.processes()) and time.monotonic() - began < LIMIT:
            self._process.poll()
            time.sleep(0.01)
        seconds = time.monotonic() - began
        left = [f"process {_command_of(process)}" for process in alive]
        for process in alive:
            os.kill(process, 9)
        code = self._process.wait()
        self._close()
        left += [f"temporary {path.name}" for path in sorted(self._temporary.iterdir())]
        left += _locks(self._folder)
        left += [f"file {path.name}" for path in self._folder.rglob(".*.*") if path.parent.name != "stores"]
        return Ended(None if alive else code, number, seconds, self.output, tuple(left))

    def _read(self) -> None:
        try:
            while part := os.read(self._ours, 65536):
                self._output += part
        except OSError:  # the other side has closed
            pass

    def _close(self) -> None:
        self._reader.join(5.0)
        os.close(self._ours)


def _on_its_terminal() -> None:
    """As a shell starts a command: Ctrl-C of its terminal is a signal for all its processes, not ignored."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # a background job of a script ignores it


def _command_of(process: int) -> str:
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode()[:120]
    except OSError:
        return str(process)


def _locks(folder: Path) -> list[str]:
    """Locks below a folder that are still held, and addresses of services."""
    held = [f"address {path}" for path in folder.rglob("service.json")]
    for path in folder.rglob("ledger.lock"):
        with path.open() as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                held.append(f"lock {path.name}")
    return held
