"""A job's specification is parsed once and its plan made once, however many requests need them."""

import json
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from ledgers import record
from scripted import small
from served import computing, finished, get

from kernel.params import KERNEL_VERSION
from service.errors import LedgerUnusable
from service.jobs import prepare
from service.jobs.prepare import JobPreparer, PreparedJob
from service.settings import Settings
from worker import store, studies
from worker.spec.axes import Range
from worker.sweep import SweepSpec
from worker.sweep.plan import make_plan


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Counts specifications parsed and plans made outside the tasks of an Inline executor."""
    count: Counter[str] = Counter()

    def counted(name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            count[name] += not threading.current_thread().name.startswith("chunks")
            return real(*arguments, **options)

        return call

    sweep = replace(
        studies.SWEEP, parse=counted("parsed", SweepSpec.parse), plan=counted("planned", make_plan)
    )
    monkeypatch.setattr(studies, "SWEEP", sweep)
    for kind in ("rest", "ramp"):
        monkeypatch.setitem(studies.STUDIES, kind, sweep)
    return count


def test_from_submission_to_export_a_job_is_prepared_once(tmp_path: Path, calls: Counter[str]):
    with computing(tmp_path) as client:
        here = finished(client, small().as_submitted())
        for _ in range(3):
            get(client, here)
        for style in ("json", "csv", "svg"):
            line = {"along": "gamma", "omega": 0.5, "xi": 0.26, "format": style}
            assert client.get(f"{here}/diagram", params=line).status_code == 200
        get(client, f"{here}/threshold", xi=0.26)
        assert client.get(f"{here}/threshold", params={"xi": 0.26, "tolerance": 0.01}).status_code in (
            200,
            202,
        )
        get(client, f"{here}/modes", xi=0.26)
        for kind in ("nc", "parquet"):
            assert client.get(f"{here}/export", params={"format": kind}).status_code == 200
        assert calls == {"parsed": 2, "planned": 2}  # by the submission, and once for all others


# The preparer alone


@pytest.fixture
def preparer(tmp_path: Path) -> JobPreparer:
    return JobPreparer(Settings(data=tmp_path))


@pytest.mark.parametrize(("limit", "value"), [("MAX_JOBS", 3)])
def test_only_the_jobs_used_last_are_kept(
    preparer: JobPreparer, calls: Counter[str], monkeypatch: pytest.MonkeyPatch, limit: str, value: int
):
    jobs = [replace(record(small()), seq=seq, spec=record(small()).spec.ljust(400)) for seq in range(5)]
    assert {len(job.spec) for job in jobs} == {400}
    monkeypatch.setattr(prepare, limit, value)
    for job in jobs[:3]:
        preparer.prepare(job)
    preparer.prepare(jobs[0])  # now the one used last
    preparer.prepare(jobs[3])
    assert calls["parsed"] == 4
    preparer.prepare(jobs[0])
    assert calls["parsed"] == 4
    preparer.prepare(jobs[1])
    assert calls["parsed"] == 5


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
