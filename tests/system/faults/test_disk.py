"""A full disk: jobs and exports fail with the reason, the service goes on, and resuming finishes the job."""

import os
import resource
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from disks import fill, mounted, read_only, use_up_inodes
from scripted import Held, sweep, wait_for
from served import FIGURE_2, running, service, settings_of

from kernel.params import Outcome
from service.cli.doctor import examine
from service.ledger.model import JobState
from service.views import exports
from worker.executors.dask import Dask
from worker.executors.inline import Inline

LARGE = sweep(gamma={"start": 2.0, "stop": 5.0, "num": 100}, keep=64, observe=200)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 2 MB; skips where none can be mounted."""
    with mounted(tmp_path / "small", "size=2m") as folder:
        yield folder


def test_a_full_disk_fails_the_job_only(small_disk: Path):
    """Ledger and stores are on it; the space that the ledger reserves is enough to record the failure."""
    held = Held(capacity=1)
    with running(small_disk / "data", held, window=1) as service:
        job = service.submit(LARGE)
        wait_for(held.held)
        held.let_go()
        wait_for(lambda: service.job(job).chunks_done == 1 and held.held() == 1)
        ballast = small_disk / "ballast"
        fill(ballast)
        held.let_go()
        job = service.until(job, JobState.FAILED)
        assert "No space left on device" in job.error
        ballast.unlink()
        assert service.submit(LARGE).state is JobState.QUEUED
        held.let_go_until(lambda: service.job(job).state is JobState.DONE)
        assert (service.outcomes(job) != Outcome.MISSING).all()


def test_the_ledger_records_what_happened_while_the_disk_has_no_byte_left(small_disk: Path):
    """Of several jobs, one after the other: what it uses for that is its own, and nobody takes it."""
    held = Held()
    with running(small_disk / "data", held) as service:
        specs = [sweep(omega=omega) for omega in (0.5, 0.6, 0.7)]
        jobs = [service.submit(spec) for spec in specs]
        wait_for(held.held)
        fill(small_disk / "ballast")
        for job in jobs:
            held.let_go_until(lambda job=job: service.job(job).state is JobState.FAILED)
            fill(small_disk / "ballast 2")
            assert "No space left" in (service.job(job).error or "")
        for ballast in small_disk.glob("ballast*"):
            ballast.unlink()
        for spec, job in zip(specs, jobs, strict=True):
            service.submit(spec)
            held.let_go_until(lambda job=job: service.job(job).state is JobState.DONE)


def test_a_disk_without_inodes_can_be_emptied(tmp_path: Path):
    """Not even the cancel flag of the store can be written."""
    with (
        mounted(tmp_path / "few", "size=64m,nr_inodes=600") as folder,
        closing(Inline()) as executor,
        running(folder / "data", executor) as service,
    ):
        jobs = [service.until(service.submit(sweep(omega=omega)), JobState.DONE) for omega in (0.5, 0.6)]
        with pytest.raises(OSError, match="No space left"):
            use_up_inodes(folder)
        for job in jobs:
            service.manager.delete(job.id)
        wait_for(lambda: service.pending_deletions() == 0)
        assert list((folder / "data" / "stores").iterdir()) == []
        service.until(service.submit(sweep()), JobState.DONE)


def test_a_limit_on_file_sizes_fails_the_job_only(tmp_path: Path, cluster: Dask):
    run = cluster._connection.client.run
    with running(tmp_path, cluster) as service:
        run(resource.setrlimit, resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
        try:
            job = service.until(service.submit(LARGE), JobState.FAILED)
        finally:
            run(resource.setrlimit, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
        assert "File too large" in (job.error or "")
        job = service.until(service.submit(LARGE), JobState.DONE)
        assert (service.outcomes(job) != Outcome.MISSING).all()


@pytest.mark.parametrize(("folder", "name"), [("data", "data folder"), ("stores", "folder of the stores")])
def test_nothing_is_accepted_while_a_disk_is_read_only(tmp_path: Path, folder: str, name: str):
    """A job that runs waits for the disk; once it can be written, the service goes on by itself."""
    held, reason = Held(capacity=1), f"the {name} cannot be written: Read-only file system"
    with service(tmp_path / "data", held, stores=str(tmp_path / "stores")) as client:
        here = client.post("/v1/jobs", json=FIGURE_2).headers["Location"]
        wait_for(lambda: held.held() == 1)
        with read_only(tmp_path / folder):
            wait_for(lambda: client.get("/readyz").status_code == 503)
            held.let_go()
            found = examine(settings_of(tmp_path / "data", stores=str(tmp_path / "stores")), None)
            assert "disk" in {finding.subject for finding in found if not finding.ok}
            for answer in (client.get("/readyz"), client.post("/v1/jobs", json={**FIGURE_2, "omega": 0.6})):
                assert (answer.status_code, answer.json()["detail"]) == (503, reason)
            assert [client.get(path).json()["notice"] for path in (here, "/v1/jobs")] == [reason, reason]
        wait_for(lambda: client.get("/readyz").json() == {"status": "ok"})
        held.let_go_until(lambda: client.get(here).json()["state"] == "done")
        assert client.get("/v1/jobs").json()["notice"] is None


@pytest.mark.essential
@pytest.mark.parametrize("format", ["nc", "parquet"])
def test_an_export_leaves_room_for_jobs_and_ledger(small_disk: Path, format: str):
    with service(small_disk / "data", Held(capacity=0)) as client:
        here = client.post("/v1/jobs", json=FIGURE_2).headers["Location"]
        answer = client.get(f"{here}/export?format={format}")
        assert (answer.status_code, "would stay free" in answer.json()["detail"]) == (507, True)
        assert list((small_disk / "data" / "exports").iterdir()) == []


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.99])
def test_an_export_that_fills_the_disk_ends_nothing_but_itself(
    small_disk: Path, monkeypatch: pytest.MonkeyPatch, share: float
):
    """As if others filled the disk after the look at it. The service here is the test's own process.

    The job waits for its first chunks: what is exported are missing cells.
    """
    monkeypatch.setattr(exports, "SPARE", -(2**40))
    ballast, held = small_disk / "ballast", Held()
    with service(small_disk / "data", held) as client:
        here = f"{client.post('/v1/jobs', json=FIGURE_2).headers['Location']}/export?format=nc"
        wait_for(held.held)
        whole = client.get(here)
        assert whole.status_code == 200
        fill(ballast)
        os.truncate(ballast, ballast.stat().st_size - int(share * len(whole.content)))
        answer = client.get(here)
        assert answer.status_code == 507
        assert answer.json()["detail"].startswith("no space left for the export file")
        ballast.unlink()
        assert len(client.get(here).content) == len(whole.content)
        assert list((small_disk / "data" / "exports").iterdir()) == []
