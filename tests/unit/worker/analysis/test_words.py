"""Words continued from cells: which part of a branch belongs to the cycle that a cell settled to."""

from pathlib import Path

import pytest

import worker.analysis.words
from worker import store
from worker.analysis.words import (
    continue_words,
)
from worker.sweep import SweepSpec
from worker.sweep.plan import make_plan
from worker.sweep.schema import layout
from worker.sweep.task import run_chunk


@pytest.mark.parametrize(("most", "followed"), [(2, 2), (1, 1)])
def test_cells_beyond_as_many_branches_as_are_followed_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int, followed: int
):
    """(1,1) twice, on one branch, and its double beyond the flip."""
    spec = SweepSpec(
        gamma=[1.5, 1.6, 2.3], omega=0.5, xi=0.26, model={"kind": "rigid"}, settle=200, observe=40, keep=16
    )
    url, plan = str(tmp_path / "a.zarr"), make_plan(spec)
    store.create(url, layout(spec, plan.chunk_shape))
    run_chunk(spec, plan[0], url)
    monkeypatch.setattr(worker.analysis.words, "MAX_WORDS", most)
    monkeypatch.setattr(worker.analysis.words, "POINTS", 60)
    words = continue_words(spec, url, 0, 0, 0, 4.0, True)
    assert len(words.branches) == len(words.events) == followed
    reason = f"{most} branches were followed before it, the limit"
    assert words.skipped == ((2.3, 2, 2, reason),)[: 2 - followed]
