"""Progress and jobs for people: a bar on a terminal or in a notebook, plain lines elsewhere, HTML for a job.

Progress is written to standard error, so that standard output can be piped.
"""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from html import escape
from typing import Any, Final

from service.client.models import JobStatus
from service.formats import Progress

#: A plain line is written after this many percent, and after this many seconds.
LINE_PERCENT: Final = 10.0
LINE_SECONDS: Final = 10.0


@contextmanager
def display_job(progress: bool | Callable[[Any], None]) -> Iterator[Callable[[Any], None]]:
    """A function that shows a job: `progress` itself if it is a function; if False, one without effect."""
    if callable(progress):
        yield progress
    elif not progress:
        yield lambda job: None
    elif "ipykernel" in sys.modules:
        yield _in_notebook()
    elif _on_terminal():
        with _progress_bar() as show:
            yield show
    else:
        yield _in_lines()


@contextmanager
def display_elapsed(text: str | Callable[[], str], after: float = 0.0) -> Iterator[None]:
    """Report an operation from `after` seconds on, with the seconds so far, and its duration at the end.

    On a terminal the seconds are counted in place; elsewhere a line is written every LINE_SECONDS.
    """
    began, ended = time.monotonic(), threading.Event()
    begin, end, pause = ("\r", "", 1.0) if _on_terminal() else ("", "\n", LINE_SECONDS)

    def elapsed() -> str:
        return duration(time.monotonic() - began)

    def show() -> None:
        if not ended.wait(after):
            display_line(text() if callable(text) else text, end)
            while not ended.wait(pause):
                display_line(f"{begin}{text() if callable(text) else text} ({elapsed()})", end)
            display_line(f"took {elapsed()}" if end else "")

    shown = threading.Thread(target=show, name="elapsed", daemon=True)
    shown.start()
    try:
        yield
    finally:
        ended.set()
        shown.join()


def display_parts(progress: Progress) -> Callable[[int, int], None]:
    """A function that shows an answer in parts: a line first, then every `LINE_PERCENT`."""
    if callable(progress):
        return progress
    last: int | None = None

    def show(done: int, total: int) -> None:
        nonlocal last
        if progress and (last is None or (done - last) * 100.0 >= LINE_PERCENT * total):
            last = done
            display_line(f"computed {done} of {total} parts" if done else "computing")

    return show


def _in_lines() -> Callable[[JobStatus], None]:
    """A function that writes a line when state or progress change, at most one in `LINE_SECONDS`.

    A change of state or by `LINE_PERCENT` is written at once.
    """
    stage: object = None
    line, written, grown = "", 0.0, _Grown()

    def show(job: JobStatus) -> None:
        nonlocal stage, line, written
        now, reason = (job.state, bool(job.compiling), job.progress.percent // LINE_PERCENT), grown(job)
        waited = time.monotonic() - written >= LINE_SECONDS
        if now != stage or (waited and summary(job) != line):
            stage, line, written = now, summary(job), time.monotonic()
            display_line(f"{line}{reason}")

    return show


def summary(job: JobStatus) -> str:
    """A job in one line: short id, name, state, percent, cells, remaining time."""
    progress = job.progress
    title = f"{job.id[:8]} {job.name}".rstrip()
    cells = f"{progress.cells_done:,} of {progress.cells_total:,} cells{computed_note(job)}"
    compiling = f", {job.compiling}" if job.compiling else ""
    return f"{title}: {job.state}, {progress.whole_percent}% ({cells}){time_left(job)}{compiling}"


def computed_note(job: JobStatus) -> str:
    """Computed cells of an adaptive map, and how many it needs at least; else empty."""
    progress = job.progress
    if progress.cells_computed is None:
        return ""
    least = "" if job.finished else f" of at least {progress.cells_needed:,}"
    return f", {progress.cells_computed:,}{least} computed"


def settling_note(job: JobStatus) -> str:
    """Number of cells still settling, and the remedy; empty if there are none."""
    settling = job.progress.cells_settling
    if not settling:
        return ""
    return (
        f"{settling:,} of {job.progress.cells_done:,} cells still settling: "
        "with settle auto, a larger until gives them time"
    )


def time_left(job: JobStatus) -> str:
    """`, 2 min 5 s left`, without an estimate `, for 2 s`; empty for a job that does not run."""
    seconds, started = job.progress.eta_seconds, job.view.get("started")
    if job.state != "running" or (seconds is None and not started):
        return ""
    if seconds is None:
        return f", for {duration(max(time.time() - datetime.fromisoformat(str(started)).timestamp(), 0.0))}"
    return f", {duration(seconds)} left"


class _Grown:
    """Says for some seconds why the time left of a job became twice as long."""

    def __init__(self) -> None:
        self._end, self._until = float("inf"), 0.0

    def __call__(self, job: JobStatus) -> str:
        """The reason, or an empty string."""
        now, seconds = time.monotonic(), job.progress.eta_seconds
        if seconds is not None:
            if seconds > 2.0 * max(self._end - now, 5.0):
                self._until = now + LINE_SECONDS
            self._end = now + seconds
        return ", as other jobs or later cells take longer" if now < self._until and time_left(job) else ""


def duration(seconds: float) -> str:
    """Seconds in readable units: 8 s, 2 min 5 s, 3 h 20 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600:,} h {whole % 3600 // 60} min"


def job_html(job: JobStatus) -> str:
    """A job as a small HTML table with a progress bar, for notebooks; all text is escaped."""
    progress = job.progress
    rows = {
        "job": f"<code>{escape(job.id)}</code>",
        "state": escape(job.state),
        "cells": f"<progress value='{progress.percent:g}' max='100'></progress> "
        f"{progress.cells_done:,} of {progress.cells_total:,} ({progress.whole_percent}%)"
        f"{computed_note(job)}{time_left(job)}",
        "kernel": escape(job.compiling),
        "notice": escape(job.notice or ""),
        "settling": escape(settling_note(job)),
        "error": job.error and f"<pre style='margin:0'>{escape(job.error)}</pre>",
    }
    body = "".join(
        f"<tr><th style='text-align:left'>{name}</th><td>{row}</td></tr>" for name, row in rows.items() if row
    )
    return f"<table><caption><b>{escape(job.name or 'sweep')}</b></caption>{body}</table>"


@contextmanager
def _progress_bar() -> Iterator[Callable[[JobStatus], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task, grown = bar.add_task("", total=None, note=""), _Grown()

        def show(job: JobStatus) -> None:
            progress = job.progress
            cells = f"{progress.cells_done:,} of {progress.cells_total:,} cells"
            bar.update(
                task,
                description=job.name or job.id[:8],
                completed=progress.cells_done,
                total=progress.cells_total,
                note=f"{job.state}, {job.compiling or f'{cells}{time_left(job)}{grown(job)}'}",
            )

        yield show


def _in_notebook() -> Callable[[JobStatus], None]:
    """A function that shows a job as HTML below the cell of a notebook, in place; at its end in a line."""
    from IPython.display import HTML, DisplayHandle

    handle = DisplayHandle()
    handle.display(HTML(""))

    def show(job: JobStatus) -> None:
        ended = f"{escape(summary(job))}<br>{escape(settling_note(job))}"  # the cell may end with the job
        handle.update(HTML(ended if job.finished else job_html(job)))

    return show


def _on_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


def display_line(line: str, end: str = "\n") -> None:
    """Write a line to standard error."""
    if sys.stderr is not None:
        sys.stderr.write(line + end)
        sys.stderr.flush()
