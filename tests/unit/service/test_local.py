"""`service.local`: studies computed without a service."""

import shutil
import sys
from contextlib import closing
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow.parquet
import pytest
import xarray
from json_results import from_json
from served import service
from stores import files, store_in
from studies import BASINS, spec_of

from bouncing_spring import thresholds
from kernel.params import KERNEL_VERSION
from service import local
from service.client import Client
from service.client.errors import InvalidSpecification
from service.client.models import JobStatus
from service.errors import DataFolderBusy, InvalidRequest, RunFailed
from worker.executors.inline import Inline
from worker.spec.errors import SpecError
from worker.sweep import SweepSpec

SPEC = spec_of((0.6, 3.0, 25), [0.5, 0.6], 0.26, name="local", window=(30, 20, 4))
ORBITS = {"omega": [0.5, 0.6], "xi": 0.05, "protocol": {"kind": "orbits"}, "points": 40}


def test_a_run_stores_the_bytes_of_a_service_whatever_the_number_of_threads(tmp_path: Path):
    (tmp_path / "data").mkdir()
    with (
        closing(Inline()) as executor,
        service(tmp_path / "data", executor) as http,
        Client("http://localhost", http=cast(Any, http)) as client,
    ):
        job = client.submit(SPEC).wait(progress=False)
    local.run(SPEC, tmp_path / "one.zarr", workers=1, progress=False)
    local.run(SPEC, tmp_path / "three.zarr", workers=3, progress=False)
    stored = files(store_in(tmp_path / "data", job.id))
    assert stored
    assert files(tmp_path / "one.zarr") == files(tmp_path / "three.zarr") == stored
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "one.zarr", "three.zarr"]


def test_a_complete_store_is_returned_and_not_computed_again(tmp_path: Path):
    target = tmp_path / "sweep.zarr"
    local.run(SPEC, target, progress=False)
    before = {path: path.stat().st_mtime_ns for path in target.rglob("*")}
    seen: list[JobStatus] = []
    again = local.run(SweepSpec.parse(SPEC), target, progress=seen.append)
    assert not seen
    assert {path: path.stat().st_mtime_ns for path in target.rglob("*")} == before
    assert again.attrs["job"] == SweepSpec.parse(SPEC).job_id(KERNEL_VERSION)


@pytest.mark.parametrize("format", ["nc", "parquet", "json", "png"])
def test_a_sweep_is_written_as_a_file(tmp_path: Path, format: str):
    output = tmp_path / f"sweep.{format}"
    line = {"along": "gamma", "omega": 0.6}
    job = local.run_to_file(SPEC, output, format, line, progress=False)
    assert (job.state, job.progress.cells_done) == ("done", 50)
    assert list(tmp_path.iterdir()) == [output]
    expected = local.run(SPEC, progress=False)
    content = output.read_bytes()
    match format:
        case "nc":
            with xarray.open_dataset(output, engine="h5netcdf") as written:
                np.testing.assert_array_equal(written.flight_time, expected.flight_time)
        case "parquet":
            np.testing.assert_array_equal(
                pyarrow.parquet.read_table(output)["bounces"], expected.bounces.values.ravel()
            )
        case "json":
            bounces = expected.sel(omega=0.6).bounces.values.ravel().tolist()
            assert from_json(content).bounces.values.tolist() == bounces
        case "png":
            assert content.startswith(b"\x89PNG")


def test_thresholds_of_a_spring_need_no_service(python_client: Client, tmp_path: Path):
    here = thresholds(0.6, 0.05)
    xarray.testing.assert_identical(here, python_client.threshold(0.6, 0.05))
    here.to_netcdf(tmp_path / "a.nc")
    assert thresholds(0.6, 0.05, model="soft").status == "continued"
    with pytest.raises(InvalidRequest, match=r"^xi: must be at least 0, not -1"):
        thresholds(0.6, -1)


# Errors


def test_a_broken_specification_names_field_and_rule_and_leaves_nothing(tmp_path: Path):
    with pytest.raises(SpecError, match=r"gamma.num"):
        local.run(SPEC | {"gamma": {"start": 1, "stop": 2, "num": 0}}, tmp_path / "a.zarr", progress=False)
    with pytest.raises(InvalidSpecification, match="omega: must be finite"):
        local.run(SPEC | {"omega": float("nan")}, tmp_path / "a.zarr", progress=False)
    for workers in (-1, 0, 1.5, "2", 10**9):
        with pytest.raises(InvalidRequest, match="workers: must be a whole number from 1 to 1,024, not"):
            local.run(SPEC, tmp_path / "a.zarr", workers=workers, progress=False)
    with pytest.raises(InvalidRequest, match="store: is a folder of zarr, not"):
        local.run(SPEC, tmp_path / "a.nc", progress=False)
    assert not list(tmp_path.iterdir())


def test_a_run_that_died_when_its_store_was_moved_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    target = tmp_path / "sweep.zarr"
    with monkeypatch.context() as patch:
        patch.setattr(local, "sync", lambda folder: sys.exit(130))
        with pytest.raises(SystemExit):
            local.run(SPEC, target, progress=False)
    before = files(target)
    shutil.rmtree(target)
    local.run(SPEC, target, progress=False)
    assert files(target) == before
    assert list(tmp_path.iterdir()) == [target]


def test_a_run_whose_folder_is_moved_ends(tmp_path: Path):
    folder = local.partial_of(tmp_path / "sweep.zarr")

    def move(_: JobStatus) -> None:
        folder.rename(tmp_path / "moved")

    with pytest.raises(RunFailed, match="the folder of the run was moved, removed"):
        local.run(SPEC | {"settle": 100_000}, tmp_path / "sweep.zarr", progress=move)


def test_what_is_there_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = tmp_path / "a.zarr"
    file.write_text("mine")
    with pytest.raises(FileExistsError, match="not the store of this study"):
        local.run(SPEC, file, progress=False)
    assert file.read_text() == "mine"
    link = tmp_path / "link.zarr"
    link.symlink_to(tmp_path / "nowhere")
    with pytest.raises(FileExistsError, match="not the store of this study"):
        local.run(SPEC, link, progress=False)
    assert link.is_symlink()
    local.run(SPEC, tmp_path / "b.zarr", progress=False)
    with pytest.raises(FileExistsError, match="not the store of this study"):
        local.run(SPEC | {"settle": 31}, tmp_path / "b.zarr", progress=False)
    monkeypatch.setattr(local, "KERNEL_VERSION", "another")
    with pytest.raises(FileExistsError, match=f"kernel version {KERNEL_VERSION} computed it"):
        local.run(SPEC, tmp_path / "b.zarr", progress=False)


def test_a_run_goes_on_under_another_name_and_with_its_axes_spelled_out(tmp_path: Path):
    spelled = SPEC | {"name": "b", "gamma": SweepSpec(**SPEC).axis_values("gamma").tolist()}
    for spec, budget in ((SPEC, 50.0), (spelled, 50.0), (spelled, None)):
        with local.computed(spec, tmp_path, progress=False, budget=budget) as done:
            assert done.record.name == "local"
    with pytest.raises(FileExistsError, match="holds a run of another specification"):
        local.computed(SPEC | {"settle": 31}, tmp_path, progress=False).__enter__()


def test_complex_arrays_are_written_as_their_parts(tmp_path: Path):
    job = local.run_to_file(ORBITS, tmp_path / "a.nc", "nc", progress=False)
    assert (job.state, job.progress.cells_done) == ("done", 2)
    stored = local.run(ORBITS, progress=False).multiplier
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as dataset:
        np.testing.assert_array_equal(dataset.multiplier_real, stored.real)
        np.testing.assert_array_equal(dataset.multiplier_imag, stored.imag)


def test_a_study_is_written_as_what_shows_it_which_is_checked_before_computing(tmp_path: Path):
    basins = BASINS | {"gamma": 2.3, "omega": 0.5, "protocol": {"kind": "basin", "rows": 4, "columns": 4}}
    grid = SPEC | {"omega": [0.5, 0.6], "xi": 0.26}
    for name, spec, line, column in (
        ("map", grid, {}, ",bounces,periods"),
        ("line", grid, {"omega": 0.6}, "flight,"),
        ("basin", basins, {}, "attractor_fraction"),
    ):
        local.run_to_file(spec, tmp_path / name, "csv", line, progress=False)
        assert column in (tmp_path / name).read_text().partition("\n")[0]
        (tmp_path / name).unlink()
    for spec, line in ((grid | {"xi": [0.1, 0.26]}, {}), (basins, {"along": "gamma"})):
        with pytest.raises(InvalidRequest, match=r"^(xi: is required|along: is not a parameter here)"):
            local.run_to_file(spec, tmp_path / "a.png", "png", line, progress=False)
    assert not list(tmp_path.iterdir())
    local.run_to_file(basins, tmp_path / "a.nc", "nc", progress=False)
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as dataset:
        np.testing.assert_array_equal(dataset.attractor, local.run(basins, progress=False).attractor)


def test_two_processes_do_not_compute_the_same_store(tmp_path: Path):
    folder = local.partial_of(tmp_path / "a.zarr")
    with local.computed(SPEC, folder, progress=False), pytest.raises(DataFolderBusy):
        local.run(SPEC, tmp_path / "a.zarr", progress=False)
