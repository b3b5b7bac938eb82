"""The documents as a reader uses them: their blocks, and sessions that run these in order.

Conventions of the documents. A comment on the line before a fence marks a block:

    <!-- file: NAME -->         the block is the content of a file, which is written where the commands run
    <!-- output -->             the block is the output of the block before it, to the letter
    <!-- not run: REASON -->    the block is only checked for its syntax; `REASON` must be in NOT_RUN

A shell block whose last command is `bounce serve` runs in the background until the end of the document or
until the next such block, as it does in a reader's second terminal.
"""

import os
import re
import select
import shutil
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, Self

import pytest
from paths import CACHE, ROOT
from scripted import DEADLINE, free_port

#: Every document whose blocks run.
DOCUMENTS = ("README.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")))

#: Those whose blocks take longest: in tests/nightly.
LONG = tuple(
    f"docs/{name}.md"
    for name in ("basins", "command-line", "deployment", "proofs", "python-client", "tutorial")
)

_BLOCK = re.compile(
    r"^(?:<!-- (?P<comment>[^\n]*) -->\n)?```(?P<language>[^\n]*)\n(?P<code>.*?)^```$", re.M | re.S
)


class Block(NamedTuple):
    """One fenced block of a document."""

    document: str
    line: int  # of its first line of code, from 1
    language: str
    code: str
    comment: str  # text of the comment before it

    @property
    def location(self) -> str:
        return f"{self.document}:{self.line}"

    @property
    def not_run(self) -> str | None:
        """Why it is not run, or None."""
        return self._after("not run: ")

    @property
    def file(self) -> str | None:
        """The name of the file whose content it is, or None."""
        return self._after("file: ")

    @property
    def serves(self) -> bool:
        """Whether it ends with a service in the foreground."""
        last = self.code.strip().rpartition("\n")[2]
        return self.language == "sh" and bool(re.match(r"(\w+=\S+ )*bounce serve\b", last))

    def _after(self, mark: str) -> str | None:
        return self.comment.removeprefix(mark) if self.comment.startswith(mark) else None


def text(document: str) -> str:
    return (ROOT / document).read_text()


def blocks(document: str) -> list[Block]:
    """The blocks of a document in order."""
    content = text(document)
    return [
        Block(
            document,
            content.count("\n", 0, match.start("code")) + 1,
            match["language"],
            match["code"],
            match["comment"] or "",
        )
        for match in _BLOCK.finditer(content)
    ]


class Failed(AssertionError):
    """A block did not do what its document says."""


class Session:
    """A folder with a fresh HOME in which the blocks of one document run, one after the other.

    Shell blocks share one bash, Python blocks one interpreter: what one defines, the next may use. The ports
    that documents name are replaced by free ones.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "work"
        self._logs = folder / "logs"
        home = folder / "home"
        for path in (self._folder, self._logs, home):
            path.mkdir()
        (home / ".curlrc").write_text("fail\n")  # so that curl's exit status reports an error
        self._ports = {"8000": str(free_port()), "8786": str(free_port())}
        self._environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("BOUNCE_")},
            "HOME": str(home),
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "NUMBA_CACHE_DIR": str(CACHE),
            "NO_PROXY": "127.0.0.1",
            "BOUNCE_PORT": self._ports["8000"],
            "BOUNCE_URL": f"http://127.0.0.1:{self._ports['8000']}",
        }
        self._shell = _Interpreter(["bash"], self._folder, self._environment)
        self._python: _Interpreter | None = None
        self._service: int | None = None
        self._log: Path | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end_service()
        for interpreter in (self._python, self._shell):
            if interpreter is not None:
                interpreter.close()

    def run(self, block: Block) -> None:
        """Run a block, write its file, or compare its output. Raises Failed."""
        if block.not_run is not None:
            return
        if block.file is not None:
            self.file(block.file).write_text(block.code)
        elif block.comment == "output":
            if self.output().strip() != block.code.strip():
                raise Failed(f"{block.location} shows\n{block.code}\nbut what is printed is\n{self.output()}")
        elif block.serves:
            self._serve(block)
        elif block.language == "sh":
            command = "set -euo pipefail; source {script} >{log} 2>&1 </dev/null; echo done"
            self._run_in(self._shell, block, command)
        elif block.language == "python":
            if self._python is None:
                self._python = _Interpreter([sys.executable, "-uc", _RUNNER], self._folder, self._environment)
            self._run_in(self._python, block, '["{script}", "{log}", "{location}"]')

    def output(self) -> str:
        """The output of the last block."""
        return self._log.read_text() if self._log else ""

    def file(self, name: str) -> Path:
        """A file in the folder where the blocks run."""
        return Path(self._shell.execute("pwd")) / name

    def _script(self, block: Block) -> Path:
        code = block.code
        for printed, taken in self._ports.items():
            code = code.replace(f"127.0.0.1:{printed}", f"127.0.0.1:{taken}")
            code = code.replace(f"--port {printed}", f"--port {taken}")
        script = self._logs / f"{block.line}.{block.language}"
        script.write_text(code)
        self._log = self._logs / f"{block.line}.out"
        return script

    def _run_in(self, interpreter: "_Interpreter", block: Block, command: str) -> None:
        script = self._script(block)
        assert self._log is not None
        answer = interpreter.execute(command.format(script=script, log=self._log, location=block.location))
        if answer != "done":
            raise Failed(f"{block.location} {answer or 'failed'}:\n{block.code}\n{self.output()}")

    def _serve(self, block: Block) -> None:
        self._end_service()
        script = self._script(block)
        # With job control the block has a process group of its own, in which SIGINT is not ignored. Its
        # shell outlives SIGTERM, so that it ends after all that it started.
        background = f"(set +e; trap : TERM; source {script}; wait) >{self._log} 2>&1 </dev/null &"
        self._service = int(self._shell.execute(f"set -m; {background} SERVICE=$!; set +m; echo $SERVICE"))
        give_up = time.monotonic() + DEADLINE
        while not self._ready():
            if time.monotonic() > give_up or not _alive(self._service):
                raise Failed(f"{block.location}: the service does not start:\n{block.code}\n{self.output()}")
            time.sleep(0.1)

    def _ready(self) -> bool:
        try:
            with urllib.request.urlopen(f"{self._environment['BOUNCE_URL']}/readyz", timeout=5) as answer:
                return bool(answer.status == 200)
        except (urllib.error.URLError, OSError):
            return False

    def _end_service(self) -> None:
        if self._service is None:
            return
        group, self._service = self._service, None
        _signal(group, signal.SIGTERM)
        answer = self._shell.execute(f"wait {group} || true; echo done")
        _signal(group, signal.SIGKILL)
        if answer not in ("done", ""):  # empty: the shell ended with a block that failed
            raise Failed(f"the service does not stop: {answer}")


#: Runs scripts in one namespace; a line on standard input names the script, its log, and its location.
_RUNNER = """
import contextlib, json, sys, traceback
names = {"__name__": "__main__"}
for line in sys.stdin:
    script, log, location = json.loads(line)
    with open(log, "w") as out, contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            exec(compile(open(script).read(), location, "exec"), names)
            answer = "done"
        except BaseException:
            traceback.print_exc()
            answer = "raised"
    print(answer, flush=True)
"""


class _Interpreter:
    """A process that reads commands from standard input and answers each with a line."""

    def __init__(self, command: list[str], folder: Path, environment: Mapping[str, str]) -> None:
        self._process = subprocess.Popen(
            command, cwd=folder, env=dict(environment), text=True, start_new_session=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        assert self._process.stdin
        assert self._process.stdout
        self._commands, self._answers = self._process.stdin, self._process.stdout

    def execute(self, command: str, seconds: float = DEADLINE) -> str:
        """The line that answers a command; empty if the process ended instead."""
        try:
            self._commands.write(f"{command}\n")
            self._commands.flush()
        except BrokenPipeError:
            return ""
        readable, _, _ = select.select([self._answers], [], [], seconds)
        return self._answers.readline().strip() if readable else f"took longer than {seconds:g} s"

    def close(self) -> None:
        with suppress(BrokenPipeError):
            self._commands.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            _signal(self._process.pid, signal.SIGKILL)
            self._process.wait()
        self._answers.close()


def _alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def _signal(group: int, number: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        os.killpg(group, number)


def runnable() -> list[str]:
    """The documents with blocks that run."""
    return [name for name in DOCUMENTS if any(block.language in ("sh", "python") for block in blocks(name))]


def run_in_order(session: Session, document: str) -> None:
    """Run all blocks of a document; without curl, all but those that need it, and skip the test then."""
    left_out = []
    for block in blocks(document):
        if "curl " in block.code and block.language == "sh" and shutil.which("curl") is None:
            left_out.append(block.location)
        else:
            session.run(block)
    if left_out:
        pytest.skip(f"curl is missing: {', '.join(left_out)} did not run, the rest did")
