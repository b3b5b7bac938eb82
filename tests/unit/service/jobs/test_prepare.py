"""A job is prepared once, however many requests need it, and only as what its id says."""

import json
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from ledgers import record
from scripted import small

from service.errors import LedgerUnusable
from service.jobs import prepare
from service.jobs.prepare import JobPreparer
from service.settings import Settings
from worker.studies import from_stored


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


@pytest.mark.parametrize(("change", "reason"), [
    ({"spec": json.dumps(small(xi=0.3).as_submitted())}, "not those of its id: restore a backup"),
    ({"chunks_total": 7}, "not those of its id"),
    ({"spec": "null"}, "this release cannot read"),
    ({"choice": "{}"}, "its choice is invalid"),
])  # fmt: skip
def test_a_row_that_is_not_that_of_its_id_is_never_computed_nor_read(
    preparer: JobPreparer, change: dict[str, Any], reason: str
):
    """A bit of the ledger has flipped: whole chunks would be taken for damaged and removed."""
    with pytest.raises(LedgerUnusable, match=reason):
        preparer.prepare(record(small(), **change))
