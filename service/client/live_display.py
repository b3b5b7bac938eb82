"""How jobs look in a notebook."""

from html import escape
from typing import TYPE_CHECKING

from service.client.display import duration

if TYPE_CHECKING:
    from service.client.job import Job


def job_html(job: "Job") -> str:
    """A small table with a bar; whatever came from outside is escaped."""
    rows = {
        "job": f"<code>{escape(job.id)}</code>",
        "state": escape(job.state),
        "cells": _cells(job),
    }
    if job.error:
        rows["error"] = f"<pre style='margin:0'>{escape(job.error)}</pre>"
    body = "".join(
        f"<tr><th style='text-align:left'>{name}</th><td>{row}</td></tr>" for name, row in rows.items()
    )
    return f"<table><caption><b>{escape(job.name or 'sweep')}</b></caption>{body}</table>"


def _cells(job: "Job") -> str:
    done = job.progress
    left = "" if job.finished or done.eta_seconds is None else f", {duration(done.eta_seconds)} left"
    return (
        f"<progress value='{done.percent:g}' max='100'></progress> "
        f"{done.cells_done:,} of {done.cells_total:,} ({done.whole_percent}%){left}"
    )
