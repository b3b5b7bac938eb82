"""A result is one module and one row: HTTP, every format, the client and the command follow from it."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
import toy_view
import xarray
from click.testing import CliRunner
from fastapi.testclient import TestClient
from json_results import from_json
from pyarrow import parquet
from served import computing
from studies import spec_of

from service.cli import views as commands
from service.client import Client, Job, UnexpectedAnswer
from service.client.dataset import from_binary
from service.views import client_methods
from service.views.registry import VIEWS

SPEC = spec_of((0.8, 2.6, 5), [0.5, 0.6], 0.26, window=(60, 20))
TOY = toy_view.VIEW.name


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(VIEWS, TOY, toy_view.VIEW)
        with computing(tmp_path_factory.mktemp("data")) as client:
            yield client


@pytest.fixture(scope="module")
def job(service: TestClient) -> Job:
    return Client("http://localhost", http=service).submit(SPEC).wait(progress=False)


def test_a_new_result_is_read_in_every_format(job: Job):
    found = job.result(TOY, xi=0.26)
    assert found["count"].dims == ("gamma", "kind")
    assert found["count"].sum().item() == 10
    assert found.attrs["complete"] == 1
    xarray.testing.assert_identical(from_json(job.result_file(TOY, "json")), found)
    with xarray.open_dataset(io.BytesIO(job.result_file(TOY, "nc")), engine="h5netcdf") as netcdf:
        xarray.testing.assert_equal(netcdf.load(), found)
        assert "_FillValue" not in netcdf.gamma.encoding  # CF: not of a coordinate
    frame = found["count"].to_dataframe().reset_index()
    columns = ["gamma", "kind", "count"]
    csv = pandas.read_csv(io.BytesIO(job.result_file(TOY, "csv")))
    assert csv[columns].to_dict("list") == frame[columns].to_dict("list")
    table = parquet.read_table(io.BytesIO(job.result_file(TOY, "parquet")))
    assert table.select(columns).to_pydict() == frame[columns].to_dict("list")


def test_a_new_result_is_documented(service: TestClient):
    operation = service.get("/openapi.json").json()["paths"][f"/v1/jobs/{{job_id}}/{TOY}"]["get"]
    assert "`count`: cells with this outcome" in operation["description"]
    assert {each["name"] for each in operation["parameters"]} >= {"xi", "format"}
    assert f"def {TOY}(" in client_methods.source()


def test_a_new_result_has_a_command(
    service: TestClient, job: Job, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setattr("service.client.Client", lambda url, token: Client("http://localhost", http=service))
    namespace: dict[str, Any] = {}
    exec(client_methods.source(), namespace)
    monkeypatch.setattr(commands, "ResultMethods", namespace["ResultMethods"])
    command = commands.command(TOY)
    shown = CliRunner().invoke(command, [job.id])
    assert (shown.exit_code, len(shown.stdout.splitlines())) == (0, 5 * 7 + 2), shown.output
    path = tmp_path / "outcomes.csv"
    assert CliRunner().invoke(command, [job.id, "--xi", "0.26", "-o", str(path)]).exit_code == 0
    assert path.read_bytes() == job.result_file(TOY, "csv")


def test_a_variable_added_to_the_schema_is_in_every_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """No reader lists the variables: the schema and the kernel's record are all that know of it."""
    added = toy_view.add_stored_variable(monkeypatch)
    with computing(tmp_path) as service:
        job = Client("http://localhost", http=service).submit(SPEC).wait(progress=False)
        found = job.diagram(omega=0.5)
        np.testing.assert_array_equal(found.contacts, found.flights + 1)
        assert found.contacts.attrs == added.attrs
        xarray.testing.assert_identical(from_json(job.result_file("diagram", "json", omega=0.5)), found)
        csv = pandas.read_csv(io.BytesIO(job.result_file("diagram", "csv", omega=0.5)))
        assert (csv.contacts == csv.flights + 1).all()
        for netcdf in (
            job.result_file("diagram", "nc", omega=0.5),
            job.export(tmp_path / "a.nc").read_bytes(),
        ):
            with xarray.open_dataset(io.BytesIO(netcdf), engine="h5netcdf") as dataset:
                np.testing.assert_array_equal(dataset.contacts, dataset.flights + 1)
        # The page lists whatever the answer for one cell has: tests/system/page/test_browser.py looks at it.
        cell = from_binary(job.result_file("diagram", "bin", omega=0.5, start=0.8, stop=0.8))
        assert cell.contacts.attrs == added.attrs
        frame = pandas.read_parquet(job.export(tmp_path / "a.parquet"))
        assert (frame.contacts == frame.flights + 1).all()


def test_a_result_is_limited_before_it_is_computed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(VIEWS, TOY, toy_view.VIEW)
    with computing(tmp_path, max_points=10) as service:
        answer = service.get(f"/v1/jobs/{service.post('/v1/jobs', json=SPEC).json()['id']}/{TOY}")
        assert answer.status_code == 413
        assert "35 points (gamma 5 × kind 7); the limit is 10" in answer.json()["detail"]


def test_the_file_of_the_client_is_current(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delitem(VIEWS, TOY, raising=False)
    assert client_methods.FILE.read_text() == client_methods.source()


@pytest.mark.parametrize(
    "body",
    [b"", b"[]\n", b'{"coords": {}, "data_vars": {"a": 1}, "attrs": {}}\n',
     b'{"coords": {}, "attrs": {}, "data_vars": {"a": {"dims": ["x"], "dtype": "float64", "attrs": {}, '
     b'"data": {"offset": 8, "shape": [1000000000000]}}}}\n'],
)  # fmt: skip
def test_an_answer_that_is_no_result_is_refused(body: bytes):
    with pytest.raises(UnexpectedAnswer):
        from_binary(body)


def test_missing_numbers_and_texts_survive_both_forms():
    found = xarray.Dataset(
        {"a": (("x", "y"), np.array([[1.0, np.nan], [2.0, 3.0]])), "name": ("x", ["up", "down"])},
        {"x": np.array([1, 2], np.int32)}, {"complete": 1, "share": np.nan},
    )  # fmt: skip
    from service.views import encode

    assert b"NaN" not in encode.to_json(found)
    for read in (from_json(encode.to_json(found)), from_binary(encode.to_binary(found))):
        xarray.testing.assert_identical(read, found)
