"""A job is prepared once, however many requests need it, and only as what its id says."""

import json
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from ledgers import record
from scripted import small

from kernel.params import KERNEL_VERSION
from service.errors import LedgerUnusable
from service.jobs import prepare
from service.jobs.prepare import JobPreparer, PreparedJob
from service.settings import Settings
from worker import store
from worker.spec.axes import Range
from worker.studies import from_stored
from worker.sweep.plan import make_plan


@pytest.fixture
def preparer(tmp_path: Path) -> JobPreparer:
    return JobPreparer(Settings(data=tmp_path))


def test_a_job_is_parsed_once_while_it_is_one_of_those_used_last(
    preparer: JobPreparer, monkeypatch: pytest.MonkeyPatch
):
    parse = Mock(side_effect=from_stored)
    monkeypatch.setattr(prepare, "from_stored", parse)
    monkeypatch.setattr(prepare, "MAX_JOBS", 3)
    for seq, parsed in ((0, 1), (1, 2), (2, 3), (0, 3), (3, 4), (0, 4), (1, 5)):
        preparer.prepare(record(small(), seq=seq))
        assert parse.call_count == parsed


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"spec": json.dumps(small(xi=0.3).as_submitted())}, "not those of its id: restore a backup"),
        ({"chunks_total": 7}, "not those of its id"),
        ({"spec": "null"}, "this release cannot read"),
        ({"choice": "{}"}, "its choice is none"),
    ],
)
def test_a_row_that_is_not_that_of_its_id_is_never_computed_nor_read(
    preparer: JobPreparer, change: dict[str, Any], reason: str
):
    """A bit of the ledger has flipped: whole chunks would be taken for damaged and removed."""
    with pytest.raises(LedgerUnusable, match=reason):
        preparer.prepare(record(small(), **change))


def test_the_metadata_of_an_earlier_release_are_served(tmp_path: Path):
    spec = small(gamma=Range(start=0.5, stop=5.0, num=64), omega=Range(start=0.5, stop=1.0, num=64), keep=64)
    url, plan = str(tmp_path / "old.zarr"), make_plan(spec, (1, 64, 64))
    job = PreparedJob(spec.job_id(KERNEL_VERSION), spec, spec, plan, url, {})
    _, before = job.layout.cuts
    store.create(url, before)
    key = "flight_time/zarr.json"
    assert job.read_file(key) == store.metadata_of(before)[key] != store.metadata_of(job.layout)[key]
    Path(url, key).write_text("{}")
    with pytest.raises(store.StoreDamaged, match="is not what the store's specification says"):
        job.read_file(key)
