"""Chunks computed in slices, with the same parts and pauses on any machine."""

from typing import Any

import pytest

from worker import work
from worker.studies import run_task
from worker.study import ChunkOptions, ChunkPaused, ChunkReport
from worker.study.chunks import with_options


def cut_finely(monkeypatch: pytest.MonkeyPatch, steps: int) -> None:
    """So that chunks can pause after so many steps."""
    monkeypatch.setattr(work, "FIRST_STEPS", steps)
    monkeypatch.setattr(work, "LOOK_SECONDS", (0.0, 1e9))
    monkeypatch.setattr(work, "KEPT_BYTES", 2**60)


def run_in_slices(spec: Any, chunk: Any, url: str) -> tuple[ChunkReport, int]:
    """A chunk that pauses at every look at the clock; and how often it did."""
    for pauses in range(10_000):
        try:
            with with_options(ChunkOptions(0.0)):
                return run_task(spec, chunk, url), pauses
        except ChunkPaused:
            continue
    raise AssertionError("no end")
