"""Stores that the ledger does not know: never removed, reported, and taken in again as what they are."""

import json
import os
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import zarr
from scripted import Held, Scripted, small, sweep
from served import running
from stores import files, store_in

from kernel.params import Outcome
from service.errors import NotAdoptable
from service.jobs.stores import adoption
from service.jobs.stores.opening import open_ledger
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, JobState
from service.settings import Settings
from worker import store
from worker.executors.inline import Inline
from worker.study.layout import flat_attributes, structured_attributes
from worker.sweep import SweepSpec

RAMP = sweep("ramp", protocol={"kind": "ramp", "axis": "gamma", "direction": "both"})
AUTO = small(name="auto", model={"kind": "auto", "tolerance": 0.5}, gamma=[2.0, 2.5], omega=0.5, xi=0.26)


def forget(folder: Path) -> None:
    """As if the ledger were lost."""
    for path in folder.glob("ledger.sqlite*"):
        path.unlink()


def rows(folder: Path) -> list[tuple[object, ...]]:
    """What the ledger has of jobs and chunks, but times."""
    with closing(sqlite3.connect(folder / "ledger.sqlite")) as ledger:
        jobs = ledger.execute(
            "SELECT id, name, spec, kernel_version, chunk_shape, state, error, chunks_done, chunks_total,"
            " cells_done, cells_total, cells_settling FROM jobs ORDER BY id"
        ).fetchall()
        chunks = ledger.execute(
            "SELECT id, chunk, cells, outcomes FROM chunks JOIN jobs ON job = seq ORDER BY 1, 2"
        ).fetchall()
    return [*jobs, *chunks]


def adopt(folder: Path, job_id: str) -> JobRecord:
    settings = Settings(data=folder)
    with Ledger(settings.ledger_path) as ledger:
        return adoption.adopt(ledger, settings, job_id)


def compute(folder: Path, *specs: SweepSpec) -> list[str]:
    open_ledger(Settings(data=folder)).close()
    with closing(Inline()) as executor, running(folder, executor) as service:
        return [service.until(service.submit(spec), JobState.DONE).id for spec in specs]


def test_a_lost_ledger_is_rebuilt_from_the_stores(tmp_path: Path):
    ids = compute(tmp_path, sweep(), RAMP, AUTO)
    before, stored = rows(tmp_path), files(tmp_path / "stores")
    forget(tmp_path)
    assert [adopt(tmp_path, job_id).state for job_id in ids] == [JobState.DONE] * 3
    assert rows(tmp_path) == before
    with closing(Scripted()) as executor, running(tmp_path, executor) as service:
        assert service.unknown_stores() == []
        assert [service.manager.submit(spec).accepted for spec in (sweep(), RAMP, AUTO)] == [False] * 3
        assert executor.tried == []
    assert files(tmp_path / "stores") == stored


def test_only_whole_chunks_are_adopted_and_resuming_computes_the_others(tmp_path: Path):
    [job_id] = compute(tmp_path, RAMP)
    url = store_in(tmp_path, job_id)
    stored = files(url)
    chunks = sorted((url / "outcome").glob("c.*"))
    chunks[1].unlink()
    flights = url / "flight_time" / f"{chunks[2].name}.0"
    content = bytearray(flights.read_bytes())
    content[len(content) // 2] ^= 1
    flights.write_bytes(content)
    (url / "flight_time" / f"{chunks[3].name}.0").unlink()
    outcomes = zarr.open_array(url / "outcome", mode="r+")
    first, last = (0,) * outcomes.ndim, (-1,) * outcomes.ndim
    outcomes[first], outcomes[last] = Outcome.MISSING, 99
    forget(tmp_path)
    job = adopt(tmp_path, job_id)
    assert (job.state, job.chunks_done) == (JobState.FAILED, job.chunks_total - 5)
    assert job.error == (
        f"adopted: {job.chunks_done} of {job.chunks_total} chunks were found whole in its store; "
        "resume it for the rest"
    )
    with closing(Scripted()) as executor, running(tmp_path, executor) as service:
        service.manager.resume(job_id)
        service.until(job, JobState.DONE)
        assert len(executor.tried) == 5
    assert files(url) == stored


def edited(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    def harm(root: Path) -> None:
        content = json.loads(root.read_text())
        attributes = structured_attributes(content["attributes"])
        change(attributes)
        root.write_text(json.dumps(content | {"attributes": flat_attributes(attributes)}))

    return harm


def nested(root: Path) -> None:
    content = json.loads(root.read_text())
    root.write_text(json.dumps(content)[:-1] + ', "deep": ' + "[" * 200_000 + "]" * 200_000 + "}")


def pipe(root: Path) -> None:
    root.unlink()
    os.mkfifo(root)


@pytest.mark.parametrize(("spec", "harm", "reason"), [
    (sweep(), edited(lambda attrs: attrs["spec"].update(omega=0.7)), "its sweep is"),
    (sweep(), edited(lambda attrs: attrs.update(job="0" * 32)), "it names job 000"),
    (sweep(), edited(lambda attrs: attrs.pop("spec")), "it has no attribute 'spec'$"),
    (sweep(), edited(lambda attrs: attrs.update(chunk_shape=[1, 1, 1])), r"\[1, 1, 1\] is not that of"),
    (AUTO, edited(lambda attrs: attrs["choice"].pop("table")), "choice is not the choice of a model$"),
    (AUTO, edited(lambda attrs: attrs["choice"].update(model="none")), "is not the choice of a model$"),
    (sweep(), pipe, "no store here$"),
    (sweep(), nested, "cannot be adopted: .*$"),
])  # fmt: skip
def test_a_pipe_or_a_store_that_contradicts_itself_is_not_adopted(
    tmp_path: Path, spec: SweepSpec, harm: Callable[[Path], None], reason: str
):
    [job_id] = compute(tmp_path, spec)
    harm(store_in(tmp_path, job_id) / "zarr.json")
    forget(tmp_path)
    with pytest.raises(NotAdoptable, match=reason) as refused:
        adopt(tmp_path, job_id)
    assert "\n" not in str(refused.value)
    with Ledger(tmp_path / "ledger.sqlite") as ledger:
        assert ledger.find(job_id) is None


def test_a_job_that_the_ledger_knows_is_not_adopted(tmp_path: Path):
    [job_id] = compute(tmp_path, sweep())
    before = rows(tmp_path)
    with pytest.raises(NotAdoptable, match="the ledger knows this job"):
        adopt(tmp_path, job_id)
    with pytest.raises(NotAdoptable, match="no store here"):
        adopt(tmp_path, "0" * 32)
    assert rows(tmp_path) == before


# What the service does about them: nothing


@pytest.mark.parametrize("jobs_left", [0, 1])
def test_an_unknown_store_is_reported_and_left_alone(
    tmp_path: Path, jobs_left: int, caplog: pytest.LogCaptureFixture
):
    """Beside an empty ledger, and beside one that knows other jobs."""
    known, lost = compute(tmp_path, sweep(), RAMP)
    stores = tmp_path / "stores"
    known, lost = (store_in(tmp_path, job_id).name for job_id in (known, lost))
    (stores / f"{lost}.cancelled").touch()
    (stores / "notes.txt").write_text("somebody's own")
    shutil.copytree(stores / lost, stores / f"{lost}{store.DELETED}")
    with closing(sqlite3.connect(tmp_path / "ledger.sqlite", isolation_level=None)) as ledger:
        ledger.execute("PRAGMA foreign_keys = ON")
        ledger.execute("DELETE FROM jobs WHERE store = ?", [lost])
        if not jobs_left:
            ledger.execute("DELETE FROM jobs")
    stored = files(stores)
    with running(tmp_path, Held(capacity=0)) as service:
        unknown = service.unknown_stores()
    assert files(stores) == stored
    assert unknown == ([lost] if jobs_left else [known, lost])
    assert f"{lost} is unknown to the ledger and left alone" in caplog.text


def test_a_sweep_whose_store_is_unknown_gets_another(tmp_path: Path):
    """A new ledger counts on beyond the stores that are there; adopted is the newest of a job."""
    [job_id] = compute(tmp_path, sweep())
    first = tmp_path / "stores" / f"1-{job_id}.zarr"
    stored = files(first)
    for number in (2, 3):
        forget(tmp_path)
        assert compute(tmp_path, sweep()) == [job_id]
        assert files(first) == files(tmp_path / "stores" / f"{number}-{job_id}.zarr") == stored
    forget(tmp_path)
    assert adopt(tmp_path, job_id).store == f"3-{job_id}.zarr"
    forget(tmp_path)
    assert adopt(tmp_path, f"2-{job_id}").store == f"2-{job_id}.zarr"
