"""A service without HTTP in a process that a test kills: `python service_life.py FOLDER SPEC`.

Forks a child for every run of the service, so that kernels are loaded once. Reads lines of JSON from
standard input: `[STEP, TIMES, SECONDS]` starts a run that kills itself the TIMES-th time it reaches STEP
(`-`: never), or after SECONDS. Prints one line of JSON per run: how it ended, and which chunks it
computed. A run that finishes the job ends by itself.
"""

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from worker.kernel_cache import use_cache

use_cache()

from service.jobs import supervisor  # noqa: E402 - the cache comes first
from service.jobs.manager import JobManager  # noqa: E402
from service.ledger.ledger import Ledger  # noqa: E402
from service.ledger.model import UNFINISHED  # noqa: E402
from service.ledger.transactions import WriteTransaction  # noqa: E402
from service.settings import Settings  # noqa: E402
from worker import work  # noqa: E402
from worker.executors import inline  # noqa: E402
from worker.store import store as stored  # noqa: E402
from worker.sweep import SweepSpec  # noqa: E402


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def before(owner: Any, name: str, act: Callable[[], None]) -> None:
    real = getattr(owner, name)
    setattr(owner, name, lambda *given, **more: (act(), real(*given, **more))[1])


def after(owner: Any, name: str, act: Callable[[], None]) -> None:
    real = getattr(owner, name)
    setattr(owner, name, lambda *given, **more: (real(*given, **more), act())[0])


#: Where the process is killed, in the order a job reaches these steps.
STEPS: dict[str, Callable[[Callable[[], None]], None]] = {
    "store laid out": lambda act: after(supervisor.store, "create", act),
    "chunk given out": lambda act: before(inline, "run_task", act),
    "chunk computed": lambda act: before(work.store, "write_chunk", act),
    "chunk half written": lambda act: before(stored.backend, "place", act),
    "chunk synced": lambda act: after(work.store, "write_chunk", act),
    "chunk reported": lambda act: after(inline, "run_task", act),
    "in the transaction": lambda act: after(WriteTransaction, "mark_done", act),
    "chunk marked": lambda act: after(supervisor.JobRun, "mark_saved", act),
    "job ends": lambda act: after(WriteTransaction, "finish", act),
}


def live(folder: Path, spec: SweepSpec, step: str, times: int, output: int) -> None:
    """One run of the service, in a forked child: until the job has ended, or the step is reached."""
    real = inline.run_task

    def run_task(spec: SweepSpec, chunk: Any, url: str) -> Any:
        os.write(output, f"{chunk.index}\n".encode())
        return real(spec, chunk, url)

    inline.run_task = run_task
    if step in STEPS:
        left = iter(range(times - 1, -1, -1))
        STEPS[step](lambda: die() if next(left, 0) == 0 else None)
    settings = Settings(data=folder, heartbeat_seconds=0.1)
    executor = inline.Inline()
    with Ledger(settings.ledger_path) as ledger:
        manager = JobManager(ledger, executor, settings)
        manager.start()
        job = manager.submit(spec).job
        while (current := ledger.find(job.id)) is not None and current.state in UNFINISHED:
            time.sleep(0.005)
        manager.stop()
    os.write(output, f"{current.state if current else 'gone'}\n".encode())


def main() -> None:
    folder, spec = Path(sys.argv[1]), SweepSpec.from_file(sys.argv[2])
    for line in sys.stdin:
        step, times, seconds = json.loads(line)
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reader)
            try:
                live(folder, spec, step, times, writer)
            finally:
                os._exit(0)
        os.close(writer)
        if seconds is not None:
            threading.Timer(seconds, os.kill, [child, signal.SIGKILL]).start()
        with os.fdopen(reader) as lines:
            words = lines.read().split()
        _, status = os.waitpid(child, 0)
        killed = os.WIFSIGNALED(status)
        ended = None if killed or not words else words[-1]
        chunks = [int(word) for word in words if word.isdigit()]
        sys.stdout.write(json.dumps({"killed": killed, "state": ended, "chunks": chunks}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
