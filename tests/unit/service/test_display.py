"""Progress and jobs as people see them: lines, a bar, notes, and HTML in a notebook."""

import io
import re
import sys
import threading
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest
from extras import SYSTEM
from scripted import wait_for

from service.client.display import (
    JobLines,
    PartsLines,
    computed_note,
    display_elapsed,
    display_job,
    display_parts,
    job_html,
    summary,
    time_left,
)
from service.client.models import JobStatus

ID = "0123456789abcdef" * 2


def status(state: str = "running", done: int = 0, percent: float = 0.0, **view: Any) -> JobStatus:
    progress = {
        "chunks_done": 0, "chunks_total": 1, "cells_done": done, "cells_total": 1000, "percent": percent,
    }  # fmt: skip
    job = JobStatus()
    job._update({"id": ID, "state": state, **view, "progress": progress | view.get("progress", {})})
    return job


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


# Notes


def test_a_job_that_is_done_has_no_time_left():
    assert time_left(status(progress={"eta_seconds": 61.0})) == ", 1 min 1 s left"
    for job in (status("done", progress={"eta_seconds": 0.0}), status()):
        assert time_left(job) == ""


def test_an_adaptive_map_tells_how_many_cells_are_computed():
    progress = {"cells_computed": 12, "cells_needed": 1234}
    assert computed_note(status(progress=progress)) == ", 12 of at least 1,234 computed"
    assert computed_note(status("done", progress=progress)) == ", 12 computed"
    assert computed_note(status()) == ""
    assert summary(status("done", 1000, 100.0, name="map", progress=progress)) == (
        "01234567 map: done, 100% (1,000 of 1,000 cells, 12 computed)"
    )


def test_html_has_a_row_for_what_there_is_to_say():
    plain = job_html(status(done=500, percent=50.0))
    assert "<b>sweep</b>" in plain
    assert "<progress value='50' max='100'></progress> 500 of 1,000 (50%)" in plain
    names = re.compile("<th[^>]*>([a-z]+)</th>")
    assert names.findall(plain) == ["job", "state", "cells"]
    told = job_html(
        status("failed", 20, name="mine", notice="a & b", error="<roof>", progress={"cells_settling": 3})
    )
    assert names.findall(told) == ["job", "state", "cells", "notice", "settling", "error"]
    for text in ("<b>mine</b>", "a &amp; b", "3 of 20 cells were still settling", "&lt;roof&gt;"):
        assert text in told


# Lines


def test_a_line_is_due_after_ten_percent_or_ten_seconds_of_progress():
    out, now = io.StringIO(), [0.0]
    lines = JobLines(out, clock=lambda: now[0])
    written: list[float] = []
    for second in range(61):
        now[0] = 100.0 + second
        lines(status(percent=second / 10))
        if len(out.getvalue().splitlines()) > len(written):
            written.append(second)
    assert written == [0, 10, 20, 30, 40, 50, 60]
    for percent, state, due in ((6.0, "queued", True), (16.0, "queued", True), (25.9, "queued", False)):
        before = len(out.getvalue())
        lines(status(state, percent=percent))
        assert (len(out.getvalue()) > before) is due


@pytest.mark.parametrize(("total", "told"), [(20, [0, 2, 4, 6]), (101, [0, 11, 22])])
def test_a_line_of_parts_is_written_for_every_tenth_of_them(total: int, told: list[int]):
    out = io.StringIO()
    lines = PartsLines(out)
    for done in range(told[-1] + 2 if total == 20 else 31):
        lines(done, total)
    assert out.getvalue().splitlines() == [f"computed {done} of {total} parts" for done in told]


def buffered() -> tuple[io.TextIOWrapper, Callable[[], str]]:
    """A stream that keeps what is written until it is flushed, and what has come through."""
    through = io.BytesIO()
    return io.TextIOWrapper(through, write_through=False), lambda: through.getvalue().decode()


def test_lines_are_seen_at_once():
    for report in (
        lambda out: JobLines(out)(status()),
        lambda out: PartsLines(out, "ended", "jobs")(0, 3),
    ):
        out, seen = buffered()
        report(out)
        assert seen().endswith("\n")


@pytest.mark.parametrize("terminal", [True, False])
def test_what_takes_long_is_seen_at_once(monkeypatch: pytest.MonkeyPatch, terminal: bool):
    out, seen = buffered()
    monkeypatch.setattr(out, "isatty", lambda: terminal, raising=False)
    monkeypatch.setattr(sys, "stderr", out)
    with display_elapsed("compiling"):
        wait_for(lambda: "compiling" in seen())
    assert seen() == ("\rcompiling (0 s)\n" if terminal else "compiling\ntook 0 s\n")
    # Nothing goes on counting.
    wait_for(lambda: all(thread.name != "elapsed" for thread in threading.enumerate()))


def test_parts_are_shown_as_asked_for(monkeypatch: pytest.MonkeyPatch):
    out = io.StringIO()
    monkeypatch.setattr(sys, "stderr", out)
    seen: list[tuple[int, int]] = []
    display_parts(lambda done, total: seen.append((done, total)))(1, 2)
    display_parts(False)(1, 2)
    assert (seen, out.getvalue()) == ([(1, 2)], "")
    display_parts(True, "ended", "jobs")(1, 2)
    assert out.getvalue() == "ended 1 of 2 jobs\n"


# A job's progress


def test_a_job_is_shown_as_asked_for(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    out = io.StringIO()
    monkeypatch.setattr(sys, "stderr", out)
    seen: list[JobStatus] = []
    job = status()
    with display_job(seen.append) as show:
        show(job)
    with display_job(False) as show:
        show(job)
    assert (seen, out.getvalue()) == ([job], "")
    with display_job(True) as show:
        show(job)
    assert out.getvalue() == f"{summary(job)}\n"


def test_a_terminal_has_a_bar_with_what_is_known(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    for name, value in (("COLUMNS", "150"), ("TERM", "xterm")):
        monkeypatch.setenv(name, value)
    out, written = Terminal(), Terminal()
    monkeypatch.setattr(sys, "stderr", out)
    monkeypatch.setattr(sys, "stdout", written)
    with display_job(True) as show:
        show(status(done=250, percent=25.0, name="[b]Γ[/b]", progress={"eta_seconds": 61.0}))
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", out.getvalue())
    assert "[b]Γ[/b] " in text  # a name is no markup
    assert "25%" in text
    assert "running, 250 of 1,000 cells, 1 min 1 s left" in text
    assert written.getvalue() == ""
    with display_job(True) as show:
        show(status("[b]odd[/b]", 1000, 100.0))
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", out.getvalue())
    assert f"{ID[:8]} ━" in text
    assert "[b]odd[/b], 1,000 of 1,000 cells" in text


def test_a_notebook_shows_a_job_in_one_place(monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("IPython", reason=SYSTEM)
    from IPython.display import HTML, DisplayHandle

    monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))
    shown: list[tuple[str, str]] = []
    for name in ("display", "update"):
        monkeypatch.setattr(
            DisplayHandle, name, lambda self, content, name=name: shown.append((name, content.data))
        )
    jobs = [status(), status(done=500), status("done", 1000)]
    with display_job(True) as show:
        for job in jobs:
            show(job)
    names = ("display", "update", "update")
    assert shown == [(name, HTML(job_html(job)).data) for name, job in zip(names, jobs, strict=True)]


def test_without_a_standard_error_nothing_is_a_terminal(monkeypatch: pytest.MonkeyPatch):
    """As in a program of Windows without a console."""
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    monkeypatch.setattr(sys, "stderr", None)
    with display_job(True) as show:
        show(status())
