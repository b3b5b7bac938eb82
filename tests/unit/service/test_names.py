"""A job's name is no part of its identity: its store keeps the first one, all that is shown has the last."""

import io
from pathlib import Path

import xarray
from served import computing
from studies import spec_of

from service.client import Client


def test_a_renamed_job_is_read_and_continued_after_a_restart(tmp_path: Path):
    with computing(tmp_path) as http:
        client = Client("http://localhost", http=http)
        job = client.submit(spec_of((0.6, 3.0, 9), 0.5, 0.1, window=(60, 20), name="first"))
        job.wait(progress=False).rename("second")
        before = job.diagram()
    with computing(tmp_path) as http:
        client = Client("http://localhost", http=http)
        job = client.job(job.id)
        assert (job.name, job.spec["name"]) == ("second", "second")
        assert client.submit(job.spec).id == job.id
        assert job.state == "done"
        assert job.open().attrs["title"] == "first"
        xarray.testing.assert_identical(job.diagram(), before)
        job.export(tmp_path / "a.nc")
        job.share(tmp_path / "a.html")
    with xarray.open_dataset(io.BytesIO((tmp_path / "a.nc").read_bytes()), engine="h5netcdf") as exported:
        assert exported.attrs["title"] == "second"
    assert "<h1>second</h1>" in (tmp_path / "a.html").read_text()
    with computing(tmp_path / "elsewhere") as http:
        assert Client("http://localhost", http=http).import_shared(tmp_path / "a.html").name == "second"
