"""A data folder with results of kernel version 1: they are read, none is continued.

The folder holds two jobs that are done and one that was stopped after 3 of its 12 chunks. 0.2.0 itself
wrote another.
"""

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
import xarray
from earlier_kernel import IDS, earlier_folder
from paths import GOLDEN
from scripted import Held, Scripted, wait_for
from served import get, read, service
from stores import files

from kernel.params import KERNEL_VERSION
from service.jobs.stores.adoption import adopt
from service.jobs.stores.opening import open_ledger
from service.settings import Settings

DONE, INTERRUPTED = (f"/v1/jobs/{IDS[name]}" for name in ("done", "interrupted"))
NOTICE = f"computed by kernel version 1; this release computes version {KERNEL_VERSION}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return earlier_folder(tmp_path)


def store_of(folder: Path, name: str) -> Path:
    return folder / "stores" / f"{IDS[name]}.zarr"


def change_ledger(folder: Path, statement: str, *values: Any) -> None:
    """Change the ledger of the stopped service."""
    with closing(sqlite3.connect(folder / "ledger.sqlite")) as ledger, ledger:
        ledger.execute(statement, values)


# At the start


def test_a_folder_of_0_2_0_is_read_and_its_last_job_starts_anew(tmp_path: Path):
    """Its service was killed during the last of its four jobs; answers.json has what it answered before."""
    with ZipFile(GOLDEN / "data-0.2.0.zip") as archive:
        archive.extractall(tmp_path)
    answers = json.loads((tmp_path / "answers.json").read_text())
    with service(tmp_path / "data", Held()) as client:
        for id, (query, view, values) in ((id, answer.values()) for id, answer in answers.items()):
            result = read(client, f"/v1/jobs/{id}/{view}", **query)
            for name, value in values.items():
                kept = result[name].values[np.isfinite(result[name].values)]
                assert kept.tolist() == np.hstack(value).tolist(), (id, name)
        jobs = {job["id"]: job for job in get(client, "/v1/jobs")["jobs"]}
        [unfinished] = [job for job in jobs.values() if job["state"] == "failed"]
        assert jobs.keys() == {*answers, unfinished["id"], unfinished["replaced_by"]}


def test_the_done_job_is_read_as_it_was_written(folder: Path):
    before = files(store_of(folder, "done"))
    with service(folder, Held()) as client:
        job = get(client, DONE)
        assert (job["state"], job["kernel_version"], job["notice"]) == ("done", "1", NOTICE)
        line = read(client, f"{DONE}/diagram", omega=0.5, xi=0.26)
        assert line.attrs["complete"]
        assert line.sizes["gamma"] == 9
        assert line.lyapunov_error.isnull().all()  # that kernel did not store it
        assert read(client, f"{DONE}/modes").attrs["complete"]
        assert read(client, f"{DONE}/threshold").attrs["complete"]
        opened = xarray.open_zarr(store_of(folder, "done"))
        assert opened.attrs["kernel_version"] == "1"
    assert files(store_of(folder, "done")) == before


def test_arrays_that_have_another_name_since_are_read(folder: Path, tmp_path: Path):
    """That cycles are not the spring's stood in `admissible`; without it each would count as one."""
    job = f"/v1/jobs/{IDS['cycles']}"
    with service(folder, Held()) as client:
        answer = read(client, f"{job}/orbits", omega=0.6, xi=0.05)
        now = read(client, "/v1/orbits", omega=0.6, xi=0.05)
        assert answer.event_violations.values.any()
        np.testing.assert_array_equal(answer.event_violations, now.event_violations)
        assert set(np.unique(answer.violations)) == {0, 2, 3, 7}
        exported = tmp_path / "cycles.nc"
        exported.write_bytes(client.get(f"{job}/export?format=nc").content)
        with xarray.open_dataset(exported, engine="h5netcdf") as dataset:
            np.testing.assert_array_equal(np.squeeze(dataset.violations), answer.violations)
            assert "kernel version 1:" in dataset.source
        assert client.get(f"{job}/zarr/admissible/zarr.json").status_code == 200
    store_of(folder, "cycles").rename(tmp_path / "kept")
    settings = Settings(data=tmp_path / "another")
    with open_ledger(settings) as ledger:
        shutil.copytree(tmp_path / "kept", settings.store_of(f"{IDS['cycles']}.zarr"))
        assert adopt(ledger, settings, IDS["cycles"]).state == "done"


def test_the_interrupted_job_ends_and_another_computes_all_of_it(folder: Path):
    before = files(store_of(folder, "interrupted"))
    with closing(Scripted()) as executor, service(folder, executor) as client:
        old = get(client, INTERRUPTED)
        assert old["state"] == "failed"
        begun = f"kernel version 1 began it, this release computes {KERNEL_VERSION}"
        assert old["error"] == f"{begun}: job {old['replaced_by']} computes all of it anew"
        assert old["notice"] == f"{NOTICE}, as job {old['replaced_by']}"
        refused = client.post(f"{INTERRUPTED}/cancel").json()["detail"]
        assert refused.endswith(f"can be cancelled; job {old['replaced_by']} computes it anew")
        assert read(client, f"{INTERRUPTED}/diagram", omega=0.56, xi=0.05, direction="up").bounces.any()
        here = f"/v1/jobs/{old['replaced_by']}"
        wait_for(lambda: bool(get(client, here)["state"] == "done"))
        new = get(client, here)
        assert (new["kernel_version"], new["notice"], new["replaced_by"]) == (KERNEL_VERSION, None, None)
        assert (new["spec"]["settle"], new["spec"]["until"]) == ("auto", old["spec"]["settle_until"])
        assert all(
            new["spec"][name] == old["spec"][name] for name in new["spec"] if name not in ("settle", "until")
        )
        assert read(client, f"{here}/diagram", omega=0.6, xi=0.1, direction="down").attrs["complete"]
        assert read(client, f"{here}/difference", other=old["id"], xi=0.05, direction="up").attrs
        assert not read(client, f"{INTERRUPTED}/diagram", omega=0.6, xi=0.1, direction="down").attrs[
            "complete"
        ]
    assert sorted(executor.tried) == list(range(new["progress"]["chunks_total"]))
    assert files(store_of(folder, "interrupted")) == before


def test_a_job_whose_specification_is_refused_today_keeps_no_service_from_starting(folder: Path):
    change_ledger(folder, "UPDATE jobs SET spec = json_set(spec, '$.colour', 'red') WHERE state = 'running'")
    with service(folder, Held()) as client:
        job = get(client, INTERRUPTED)
        assert (job["state"], job["replaced_by"]) == ("failed", None)
        assert "it cannot start anew: colour: is not a field here" in job["error"]


# Requests


def test_resuming_answers_with_the_job_that_starts_it_anew(folder: Path):
    change_ledger(folder, "UPDATE jobs SET state = 'cancelled' WHERE state = 'running'")
    with service(folder, Held(capacity=0)) as client:
        first, again = (client.post(f"{INTERRUPTED}/resume") for _ in range(2))
        new = first.json()
        assert (first.status_code, again.status_code) == (202, 200)
        assert first.headers["Location"] == again.headers["Location"] == f"/v1/jobs/{new['id']}"
        assert new["id"] != IDS["interrupted"]
        assert (new["state"], new["kernel_version"]) == ("queued", KERNEL_VERSION)
        assert new["notice"] == f"starts anew what job {IDS['interrupted']} is: {NOTICE}"
        # asked for again, it says at most that it waits for workers
        assert "starts anew" not in (get(client, first.headers["Location"])["notice"] or "")
        old = get(client, INTERRUPTED)
        assert (old["state"], old["replaced_by"]) == ("cancelled", new["id"])
        assert client.post(f"{first.headers['Location']}/cancel").status_code == 202
        assert client.delete(first.headers["Location"]).status_code == 204
        assert get(client, INTERRUPTED)["replaced_by"] is None
        assert client.post(f"{INTERRUPTED}/resume").status_code == 202


def test_a_done_job_is_not_resumed_and_its_sweep_submitted_again_is_another_job(folder: Path):
    with service(folder, Held(capacity=0)) as client:
        refused = client.post(f"{DONE}/resume")
        assert refused.status_code == 409
        assert "submit the sweep again" in refused.json()["detail"]
        answer = client.post("/v1/jobs", json=get(client, DONE)["spec"])
        assert answer.status_code == 202
        assert answer.json()["id"] != IDS["done"]
        old = get(client, DONE)
        assert (old["state"], old["replaced_by"]) == ("done", answer.json()["id"])


def test_no_number_of_this_kernel_is_added_to_an_earlier_job(folder: Path):
    with service(folder, Held()) as client:
        for path, query in (
            (f"{DONE}/threshold", {"tolerance": 1e-6}),
            (f"{DONE}/trajectory", {"gamma": 2.0, "omega": 0.5}),
        ):
            answer = client.get(path, params=query)
            assert answer.status_code == 409
            assert answer.json()["detail"].startswith(f"the sweep was {NOTICE}: submit the sweep again")


def test_a_store_whose_specification_has_removed_fields_is_adopted(folder: Path, tmp_path: Path):
    settings = Settings(data=tmp_path / "another")
    with open_ledger(settings) as ledger:
        shutil.copytree(store_of(folder, "interrupted"), settings.store_of(f"{IDS['interrupted']}.zarr"))
        job = adopt(ledger, settings, IDS["interrupted"])
    assert (job.id, job.chunks_done, job.kernel_version) == (IDS["interrupted"], 3, "1")


# Damage


def test_a_damaged_chunk_is_given_up(folder: Path):
    chunk = store_of(folder, "done") / "flight_time/c.0.0.0.0.0"
    content = bytearray(chunk.read_bytes())
    content[len(content) // 2] ^= 1
    chunk.write_bytes(content)
    with service(folder, Held(capacity=0)) as client:
        refused = client.get(f"{DONE}/diagram", params={"omega": 0.5})
        assert refused.status_code == 503
        assert "damaged and missing from now on: chunk 0" in refused.json()["detail"]
        job = get(client, DONE)
        assert job["state"] == "failed"
        assert job["error"].startswith("chunk 0 (rest, gamma 1 to 3, omega 0.5 to 1, xi 0.26): its")
        assert NOTICE in job["error"]
        assert [(failure["chunk"], failure["tries"]) for failure in job["failures"]] == [(0, 0)]
        assert job["progress"]["cells_done"] == 0
        line = read(client, f"{DONE}/diagram", omega=0.5)
        assert not line.attrs["complete"]
        assert not line.outcome.any()
        answer = client.post(f"{DONE}/resume")
        assert answer.status_code == 202
        assert answer.json()["id"] == get(client, DONE)["replaced_by"]


def test_damaged_metadata_stay_damaged_and_the_answer_says_so(folder: Path):
    (store_of(folder, "done") / "zarr.json").write_text("{")
    with service(folder, Held()) as client:
        answer = client.get(f"{DONE}/diagram", params={"omega": 0.5})
        assert answer.status_code == 500
        assert answer.json()["detail"] == f"stored results are damaged: the store's metadata ({NOTICE})"
    assert (store_of(folder, "done") / "zarr.json").read_text() == "{"
