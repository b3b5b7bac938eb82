"""A job's specification is parsed once and its plan made once, however many requests need them."""

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from ledgers import record
from scripted import Held, small, sweep
from served import computing, finished, get, service

from service.jobs import prepare
from service.jobs.prepare import JobPreparer
from service.settings import Settings
from worker import studies
from worker.analysis.model_selection import ModelChoice
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


def test_a_service_that_starts_again_prepares_a_job_once(tmp_path: Path, calls: Counter[str]):
    with service(tmp_path, Held()) as client:
        here = client.post("/v1/jobs", json=sweep().as_submitted()).headers["Location"]
    calls.clear()
    with computing(tmp_path) as client:
        assert finished(client, sweep().as_submitted()) == here  # the request itself: one of each
        get(client, f"{here}/diagram", along="gamma")
    assert calls == {"parsed": 2, "planned": 2}


# The preparer alone


@pytest.fixture
def preparer(tmp_path: Path) -> JobPreparer:
    return JobPreparer(Settings(data=tmp_path))


def test_a_chosen_model_takes_the_place_of_auto_in_what_is_computed(preparer: JobPreparer):
    spec = small(model={"kind": "auto", "restitution": 0.0})
    before = preparer.prepare(record(spec))
    choice = ModelChoice(model="rigid", reason="because", tolerance=1e-3, table=())
    after = preparer.prepare(record(spec, choice=choice.model_dump_json()))
    assert before.spec.model.kind == before.submitted.model.kind == after.submitted.model.kind == "auto"
    assert after.spec.model.kind == "rigid"
    assert after.attributes == {"model": "rigid", "choice": choice.reproducible()}


def test_many_at_once_get_one_value(preparer: JobPreparer, calls: Counter[str]):
    job, prepared = record(small()), []
    threads = [threading.Thread(target=lambda: prepared.append(preparer.prepare(job))) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(prepared) == 16
    assert len({id(value) for value in prepared}) == 1
    assert calls == {"parsed": 1, "planned": 1}


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
