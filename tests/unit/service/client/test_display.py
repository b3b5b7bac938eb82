"""Progress and jobs as people see them: lines, a bar, notes, and HTML in a notebook."""

import io
import re
import sys
from types import ModuleType
from typing import Any

import pytest
from extras import SYSTEM

from service.client.display import display_job, job_html
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
    tables = [("update", HTML(job_html(job)).data) for job in jobs[:2]]
    # the cell may end with the job, whose table follows
    assert shown == [("display", ""), *tables, ("update", "01234567: done, 0% (1,000 of 1,000 cells)<br>")]


def test_a_time_left_that_doubles_has_a_reason(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    with display_job(True) as show:
        for percent, left in ((10.0, 60.0), (20.0, 50.0), (30.0, 300.0)):
            show(status(percent=percent, progress={"eta_seconds": left}))
    lines = capsys.readouterr().err.splitlines()
    assert [line.endswith("other jobs or later cells take longer") for line in lines] == [False, False, True]
