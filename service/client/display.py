"""How a wait shows itself: a bar on a terminal or in a notebook, plain lines anywhere else, or nothing.

All of it goes to standard error, so that standard output stays fit for a pipe.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final, TextIO, TypeAlias

if TYPE_CHECKING:
    from service.client.job import Job

Show: TypeAlias = Callable[["Job"], None]

#: Is told how many parts of an answer are computed, and of how many.
Parts: TypeAlias = Callable[[int, int], None]

#: A plain line is written every so many percent, and every so many seconds in between.
LINE_PERCENT: Final = 10.0
LINE_SECONDS: Final = 10.0


@contextmanager
def display(progress: bool | Show) -> Iterator[Show]:
    """A function that shows the job it is given: `progress` itself if callable, nothing if False."""
    if callable(progress):
        yield progress
    elif not progress:
        yield lambda job: None
    elif _is_terminal(sys.stderr) or "ipykernel" in sys.modules:
        with _bar() as show:
            yield show
    else:
        yield Lines(sys.stderr)


def counting(progress: bool | Parts) -> Parts:
    """The same for an answer that workers compute: `progress` itself if callable, else lines or nothing."""
    if callable(progress):
        return progress
    return Count(sys.stderr) if progress else lambda done, total: None


class Count:
    """A line at first and every `LINE_PERCENT` of the parts."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._last: int | None = None

    def __call__(self, done: int, total: int) -> None:
        """Write a line for so many parts of all if one is due."""
        if self._last is None or (done - self._last) * 100.0 >= LINE_PERCENT * total:
            self._last = done
            print(f"computed {done} of {total} parts", file=self._out, flush=True)


class Lines:
    """One line when the state changes, and every `LINE_PERCENT` or `LINE_SECONDS` while work goes on."""

    def __init__(self, out: TextIO, clock: Callable[[], float] = time.monotonic) -> None:
        self._out = out
        self._clock = clock
        self._last: tuple[str, float] | None = None
        self._written = 0.0

    def __call__(self, job: "Job") -> None:
        """Write a line for this job if one is due."""
        if self._is_due(job):
            self._last, self._written = (job.state, job.progress.percent), self._clock()
            print(summary(job), file=self._out, flush=True)

    def _is_due(self, job: "Job") -> bool:
        if self._last is None or self._last[0] != job.state:
            return True
        ahead = job.progress.percent - self._last[1]
        return ahead >= LINE_PERCENT or (ahead > 0 and self._clock() - self._written >= LINE_SECONDS)


def summary(job: "Job") -> str:
    """A job in one line: short id, name, state, how far, how long still."""
    done = job.progress
    parts = [f"{job.id[:8]} {job.name}".rstrip() + f": {job.state}"]
    parts.append(f"{done.whole_percent}% ({done.cells_done:,} of {done.cells_total:,} cells)")
    if not job.finished and done.eta_seconds is not None:
        parts.append(f"{duration(done.eta_seconds)} left")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """Seconds as a person says them: 8 s, 2 min 5 s, 3 h 20 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600:,} h {whole % 3600 // 60} min"


@contextmanager
def _bar() -> Iterator[Show]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("", total=None, note="")

        def show(job: "Job") -> None:
            done = job.progress
            left = "" if job.finished or done.eta_seconds is None else f", {duration(done.eta_seconds)} left"
            progress.update(
                task,
                description=job.name or job.id[:8],
                completed=done.cells_done,
                total=done.cells_total,
                note=f"{job.state}, {done.cells_done:,} of {done.cells_total:,} cells{left}",
            )

        yield show


def _is_terminal(stream: TextIO) -> bool:
    return stream is not None and stream.isatty()
