"""A sweep as a file, as a mode map, and as the store itself over HTTP: the same numbers everywhere."""

import io
import json
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from fastapi.testclient import TestClient
from pyarrow import parquet
from scripted import DEADLINE, Held
from served import RAMP, computing, finished, get, service
from tables import for_each

from kernel.labels import LABELS
from kernel.params import KERNEL_VERSION, Outcome
from service.background import InThisProcess
from service.errors import NoSpace
from service.software import processor, software
from service.views import exports
from service.views.selection import Stored
from worker.sweep import SweepSpec
from worker.sweep.plan import make_plan

#: A checker of the CF conventions: `pip install compliance-checker`.
CHECKER = shutil.which("compliance-checker")


class Done:
    """A finished job, the client that made it, and its store as xarray reads it from the disk."""

    def __init__(self, client: TestClient, folder: Path, spec: Mapping[str, Any] = RAMP) -> None:
        self.client = client
        self.here = finished(client, dict(spec))
        (url,) = folder.rglob("*.zarr")
        self.store = xarray.open_zarr(url, chunks=None).load()

    def netcdf(self) -> xarray.Dataset:
        content = self.client.get(f"{self.here}/export?format=nc").content
        with xarray.open_dataset(io.BytesIO(content), engine="h5netcdf") as dataset:
            return dataset.load()

    def parquet(self, layout: str = "cells") -> Any:
        content = self.client.get(f"{self.here}/export?format=parquet&layout={layout}").content
        return parquet.read_table(io.BytesIO(content))


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Done]:
    folder = tmp_path_factory.mktemp("data")
    with computing(folder, turn_seconds=0.01) as client:
        yield Done(client, folder)


def test_netcdf_holds_what_the_store_holds(done: Done):
    answer = done.client.get(f"{done.here}/export?format=nc")
    assert answer.status_code == 200
    assert answer.headers["Content-Disposition"].endswith('.nc"')
    assert int(answer.headers["Content-Length"]) == len(answer.content)
    assert answer.headers["Bounce-Complete"] == "true"
    dataset = done.netcdf()
    for name, array in done.store.variables.items():
        np.testing.assert_array_equal(dataset[name], array, err_msg=str(name))
        assert dataset[name].dims == array.dims
    assert dataset["flight_time"].attrs["units"] == "rad"
    assert dataset["outcome"].dtype == np.uint8
    assert SweepSpec.from_json(dataset.attrs["spec"]) == SweepSpec(**RAMP)
    flags = dataset.direction_code.attrs
    assert (flags["flag_meanings"], flags["flag_values"].dtype) == ("up down", np.uint8)
    np.testing.assert_array_equal(flags["flag_values"], dataset.direction_code.values)
    assert {name: dataset.attrs[name] for name in done.store.attrs} == done.store.attrs


@pytest.mark.skipif(CHECKER is None, reason="needs compliance-checker, which brings its tables")
def test_netcdf_follows_the_cf_conventions(done: Done, tmp_path: Path):
    (tmp_path / "sweep.nc").write_bytes(done.client.get(f"{done.here}/export?format=nc").content)
    command = [str(CHECKER), "--test=cf:1.11", "--criteria=strict", "sweep.nc"]
    report = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE, check=False
    )
    assert "All tests passed!" in report.stdout, report.stdout


def test_a_file_tells_what_computed_it_alike_in_every_format(done: Done):
    """Texts and numbers only; what the store says, and the run."""
    attributes = done.netcdf().attrs
    for layout in ("cells", "flights"):
        metadata = done.parquet(layout).schema.metadata
        assert {name.decode(): value.decode() for name, value in metadata.items()} == {
            name: str(value) for name, value in attributes.items()
        }
    job = get(done.client, done.here)
    assert all(isinstance(value, str | int | float) for value in attributes.values())
    assert attributes["job"] == job["id"]
    assert attributes["core_seconds"] == job["core_seconds"] > 0
    assert attributes["software"] == f"bouncing-spring {software().release}, kernel version {KERNEL_VERSION}"
    assert json.loads(attributes["libraries"]) == {"python": software().python, **software().libraries}
    assert attributes["processor"] == processor()
    accepted, computing, ended = attributes["history"].splitlines()
    assert accepted == f"{job['created'][:19]}Z accepted"
    assert computing.endswith(f"Z computing with {attributes['software']}")
    assert ended == f"{job['finished'][:19]}Z done"


def test_parquet_holds_a_row_for_every_cell(done: Done):
    table = done.parquet()
    assert table.num_rows == done.store.outcome.size
    names = [outcome.name.lower() for outcome in Outcome]
    for row in table.to_pylist():
        cell = done.store.sel({name: row[name] for name in ("direction", "xi", "omega", "gamma")})
        assert row["outcome"] == names[int(cell.outcome)]
        assert row["flights"] == int(cell.flights)
        kept = min(row["flights"], 8)
        assert row["flight_time"] == cell.flight_time.values[:kept].tolist()
        assert row["takeoff_phase"] == cell.takeoff_phase.values[:kept].tolist()
    assert SweepSpec.from_json(table.schema.metadata[b"spec"]) == SweepSpec(**RAMP)


@pytest.mark.parametrize("format", ["nc", "parquet"])
def test_a_job_not_begun_exports_as_missing_cells(tmp_path: Path, format: str):
    with service(tmp_path, Held(capacity=0)) as client:
        here = client.post("/v1/jobs", json=RAMP).headers["Location"]
        answer = client.get(f"{here}/export?format={format}")
        assert answer.headers["Bounce-Complete"] == "false"
        if format == "parquet":
            table = parquet.read_table(io.BytesIO(answer.content)).to_pydict()
            assert set(table["outcome"]) == {"missing"}
            assert set(map(len, table["flight_time"])) == {0}


def test_what_a_killed_export_left_is_swept_at_the_start(tmp_path: Path):
    (tmp_path / "exports").mkdir()
    (tmp_path / "exports" / "half.nc").write_bytes(b"x")
    with service(tmp_path, Held()):
        assert not list(tmp_path.rglob("half.nc"))


def test_a_sweep_too_large_for_one_file_is_refused(tmp_path: Path):
    with service(tmp_path, Held(capacity=0), max_export_bytes=1000) as client:
        here = client.post("/v1/jobs", json=RAMP).headers["Location"]
        answer = client.get(f"{here}/export?format=nc")
        assert answer.status_code == 413
        assert "the limit for one file is 1,000" in answer.json()["detail"]


@pytest.fixture
def whole(done: Done) -> exports.Export:
    """The sweep of `done` as a table."""
    job = done.client.app.state.service.ledger.find(done.here.rsplit("/", 1)[1])  # type: ignore[attr-defined]
    url = done.client.app.state.service.settings.store_of(job.store)  # type: ignore[attr-defined]
    spec = SweepSpec(**RAMP)
    return exports.Export(Stored(spec, url), make_plan(spec, chunk_shape=job.chunk_shape), "parquet")


def test_files_are_written_where_this_user_alone_finds_them(whole: exports.Export, tmp_path: Path):
    folder = tmp_path / "deep" / "exports"
    open_before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(20):
        with exports.make(InThisProcess(), whole, folder) as file:
            assert file.read(4) == b"PAR1"
        assert list(folder.iterdir()) == []
    assert folder.stat().st_mode & 0o7777 == 0o700
    assert len(list(Path("/proc/self/fd").iterdir())) < open_before + 10


def test_only_a_full_disk_is_told_as_one(whole: exports.Export, tmp_path: Path):
    (tmp_path / "full").symlink_to("/dev/full")
    with pytest.raises(NoSpace, match=r"^no space left for the export file: "):
        exports.write(whole, tmp_path / "full")
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError):
        exports.write(whole, tmp_path / "folder")


@for_each(
    "query", ["", "?format=xls", "?format=nc&keep=1", "?format=nc&layout=flights", "?format=parquet&layout=x"]
)
def test_an_export_needs_a_format_and_rows_that_it_has(done: Done, query: str):
    assert done.client.get(f"{done.here}/export{query}").status_code == 422


# The store over HTTP


@pytest.mark.parametrize("linked", ["file", "folder"])
def test_a_link_in_a_store_is_not_followed(tmp_path: Path, linked: str):
    with computing(tmp_path / "data") as client:
        here = finished(client, RAMP)
        (store_,) = tmp_path.rglob("*.zarr")
        secret, file = tmp_path / "secret" / "c.0.0.0.0", store_ / "outcome" / "c.0.0.0.0"
        secret.parent.mkdir()
        secret.write_bytes(b"secret")
        part, target = (file, secret) if linked == "file" else (file.parent, secret.parent)
        part.rename(tmp_path / "aside")
        part.symlink_to(target)
        answer = client.get(f"{here}/zarr/outcome/{file.name}")
        assert (answer.status_code, b"secret" in answer.content) == (503, False)
        assert secret.read_bytes() == b"secret"


ATTRACTORS: dict[str, dict[str, Any]] = {
    "basin": {"protocol": {"kind": "basin", "rows": 8, "columns": 6}, "gamma": [0.6, 1.27], "exponents": 1},
    "multistability": {"protocol": {"kind": "multistability"}, "gamma": [3.4, 3.6]},
}


@pytest.fixture(scope="module", params=ATTRACTORS)
def attractors(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Done]:
    spec = ATTRACTORS[request.param] | {"omega": [0.5], "xi": 0.26, "model": {"kind": "rigid"}, "settle": 200}
    folder = tmp_path_factory.mktemp(request.param)
    with computing(folder) as client:
        yield Done(client, folder, spec)


def test_netcdf_holds_what_is_stored_of_attractors(attractors: Done):
    dataset = attractors.netcdf()
    assert set(dataset.variables) == set(attractors.store.variables)
    for name, array in attractors.store.variables.items():
        np.testing.assert_array_equal(dataset[name], array, err_msg=str(name))
        attrs, units = dataset[name].attrs, array.attrs.get("units", "1")
        if units in ("1", "rad"):
            assert attrs.get("units", "1") == units
        else:  # UDUNITS has no such unit
            assert (attrs["units"], attrs["long_name"]) == ("1", f"{array.attrs['long_name']}, in {units}")


def test_what_is_no_sweep_has_no_page(attractors: Done):
    answer = attractors.client.get(f"{attractors.here}/export?format=html")
    assert answer.status_code == 422
    assert re.search("format: html, a page to share, is for sweeps, not for .*: nc has all", answer.text)


def test_parquet_holds_a_row_for_every_attractor(attractors: Done):
    rows, stored = attractors.parquet().to_pylist(), attractors.store
    assert len(rows) == int(stored.attractor_count.sum())
    for row in rows:
        cell = stored.sel({axis: row[axis] for axis in ("gamma", "omega", "xi")} | {"id": row["id"]})
        assert row["fraction"] == cell.fraction.item()
        assert row["attractor_outcome"] == LABELS[cell.attractor_outcome.item()]
        assert row["attractor_state"] == cell.attractor_state.values.tolist()
        flights = cell.flight_time.values
        assert row["flight_time"] == flights[np.isfinite(flights)].tolist()
        if "starts" in row:
            assert row["starts"] == np.flatnonzero(cell.attractor.values == row["id"]).tolist()
            np.testing.assert_array_equal(row["lyapunov"], cell.lyapunov.values)
