"""Studies computed here: chunk by chunk, or in slices with the same parts and pauses on any machine."""

from pathlib import Path
from typing import Any

import pytest
import xarray

from worker import store, work
from worker.studies import run_task, study_of
from worker.study import ChunkOptions, ChunkPaused, ChunkReport, Plan
from worker.study.chunks import with_options


def planned(url: str | Path, spec: Any, shape: tuple[int, ...] | None = None) -> Plan:
    """The chunks of a study, and an empty store for them."""
    study = study_of(spec)
    plan = study.plan(spec, shape)
    store.create(str(url), study.variables(spec, plan.chunk_shape))
    return plan


def compute(url: str | Path, spec: Any, shape: tuple[int, ...] | None = None) -> None:
    """Make a store and compute every chunk of it."""
    for chunk in planned(url, spec, shape):
        report = run_task(spec, chunk, str(url))
        assert sum(report.outcomes) == report.cells == chunk.cells
        assert 0.0 < report.kernel_seconds < report.seconds < 600.0


def computed(url: str | Path, spec: Any, shape: tuple[int, ...] | None = None) -> xarray.Dataset:
    """What is stored of a study."""
    compute(url, spec, shape)
    return xarray.open_zarr(url, chunks=None).load()


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
