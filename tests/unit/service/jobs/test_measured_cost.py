"""The estimated cost of a study: by the speed of earlier jobs of its kind, else by the table."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from ledgers import record
from scripted import small

from service.jobs.prepare import JobPreparer
from service.ledger.model import JobRecord, JobState
from service.settings import Settings
from worker.studies import study_of
from worker.study import Cost
from worker.sweep import SweepSpec
from worker.sweep.plan import make_plan

SPEC = small()
ADAPTIVE = small(refine={"by": "mode", "coarsest": 2}, xi=0.05)


@pytest.fixture
def preparer(tmp_path: Path) -> JobPreparer:
    return JobPreparer(Settings(data=tmp_path))


def by_table(spec: SweepSpec) -> Cost:
    return study_of(spec).estimate(spec, make_plan(spec))


def pace(spec: SweepSpec, seconds: float, expected: float) -> JobRecord:
    """A job of which so many cells took `seconds` that the table says `expected`."""
    table = by_table(spec)
    cells: Any = expected * table.cells / table.core_seconds
    return record(spec, state=JobState.DONE, core_seconds=seconds, cells_timed=cells)


def ratio(
    preparer: JobPreparer, *measured: JobRecord, spec: SweepSpec = SPEC, basis: str = "measured"
) -> float:
    """The cost over that of the table."""
    found, table = preparer.cost(spec, make_plan(spec), measured), by_table(spec)
    assert found.basis == basis
    for name in ("least_core_seconds", "longest_core_seconds"):
        known = getattr(table, name)
        expected = None if known is None else pytest.approx(known * found.core_seconds / table.core_seconds)
        assert getattr(found, name) == expected
    return found.core_seconds / table.core_seconds


def test_what_earlier_jobs_took_over_what_the_table_says_is_the_speed(preparer: JobPreparer):
    assert ratio(preparer, pace(SPEC, 3.0, 1.5)) == pytest.approx(2.0)
    assert ratio(preparer, pace(SPEC, 3.0, 1.0), pace(small(omega=0.9), 1.0, 7.0)) == pytest.approx(0.5)
    assert ratio(preparer, pace(SPEC, 3.0, 1.0), spec=ADAPTIVE) == pytest.approx(3.0)
    assert ratio(preparer, pace(SPEC, 3.0, 1.0), spec=small(settle="auto", until=640)) == pytest.approx(3.0)


def test_the_table_tells_where_no_job_of_this_model_does(preparer: JobPreparer):
    """An adaptive map says nothing, nor does a job that this version does not accept."""
    model = small(model={"kind": "soft"})
    soft, adaptive = pace(model, 3.0, 1.0), pace(ADAPTIVE, 3.0, 1.0)
    old, short = replace(pace(SPEC, 3.0, 1.0), spec='{"gamma": 1.0}'), pace(model, 0.3, 0.1)
    assert [ratio(preparer, *jobs, basis="table") for jobs in ((), (short,), (adaptive,), (old,))] == [
        1.0
    ] * 4
    # others tell the speed of the machine
    assert ratio(preparer, soft, adaptive, old, basis="table") == pytest.approx(3.0)
    assert ratio(preparer, soft, adaptive, old, pace(SPEC, 1.0, 4.0)) == pytest.approx(0.25)
