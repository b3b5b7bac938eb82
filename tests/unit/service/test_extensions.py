"""What the architecture promises to whoever adds something: how little it takes.

The toys in tests/support are registered in the tables and run end to end, through HTTP and the real store.
"""

from pathlib import Path
from typing import Any

import pytest
import toy_model
import xarray
from scripted import wait_for
from served import computing, finished, get, read
from toy_study import TOY

from kernel.params import Outcome
from worker import studies
from worker.cost import FOLLOWED_SHARE
from worker.spec import SweepSpec
from worker.spec.contact_models import CONTACT_MODELS


@pytest.fixture
def glued(monkeypatch: pytest.MonkeyPatch):
    """The toy model in the table, and specifications that know it."""
    monkeypatch.setitem(CONTACT_MODELS, "glued", toy_model.ROW)
    SweepSpec.model_rebuild(force=True)
    yield
    monkeypatch.undo()
    SweepSpec.model_rebuild(force=True)


GLUED: dict[str, Any] = {
    "gamma": {"start": 1.0, "stop": 3.0, "num": 5}, "omega": 0.5, "xi": [0.1, 0.2],
    "model": {"kind": "glued"}, "settle": 3, "observe": 2,
}  # fmt: skip


def test_a_contact_model_is_its_module_and_a_row(tmp_path: Path, glued: None):
    with computing(tmp_path) as client:
        cost = client.post("/v1/jobs", params={"validate_only": "true"}, json=GLUED).json()
        followed = 2 * GLUED["observe"]  # plate periods of a cell without a mode
        assert cost["core_seconds"] == pytest.approx(10 * (5 + FOLLOWED_SHARE * followed) * 0.01e-6)
        here = finished(client, GLUED)
        diagram = read(client, f"{here}/diagram", along="gamma", omega=0.5, xi=0.1)
        assert diagram.outcome.values.tolist() == [Outcome.AT_REST] * 5
        picture = client.get(f"{here}/diagram", params={"omega": 0.5, "xi": 0.1, "format": "svg"})
        assert picture.status_code == 200

        refused = client.post("/v1/jobs", json=GLUED | {"model": {"kind": "glued", "colour": "green"}})
        assert refused.status_code == 422
        assert refused.json()["errors"][0]["field"] == "model.colour"
        unknown = client.post("/v1/jobs", json=GLUED | {"model": {"kind": "glue"}})
        assert "did you mean 'glued'?" in unknown.json()["detail"]


TOY_JOB = {"name": "divisors", "protocol": {"kind": "divisors"}, "last": 30}


def test_a_kind_of_study_is_five_answers_and_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(studies.STUDIES, "divisors", TOY)
    with computing(tmp_path) as client:
        cost = client.post("/v1/jobs", params={"validate_only": "true"}, json=TOY_JOB).json()
        assert (cost["cells"], cost["chunks"]) == (30, 5)
        here = finished(client, TOY_JOB)
        view = get(client, here)
        assert view["progress"]["cells_done"] == 30
        assert view["spec"] == TOY_JOB | {"protocol": {"kind": "divisors", "step": 1}}
        assert finished(client, TOY_JOB | {"name": "another label"}) == here

        (url,) = tmp_path.rglob("*.zarr")
        with xarray.open_zarr(url, chunks=None) as stored:
            assert stored["count"].sel(number=12) == 6
            assert stored["divisor"].sel(number=9).values.tolist() == [1, 3]
            assert stored["count"].attrs["long_name"] == "number of divisors"

        # What reads sweeps says so; what works on any store does.
        assert client.get(f"{here}/diagram").status_code == 422
        assert client.get(f"{here}/zarr/zarr.json").status_code == 200
        assert client.get(f"{here}/zarr/count/c.0").content == (url / "count" / "c.0").read_bytes()


def test_damage_to_a_study_of_any_kind_is_found_and_repaired(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(studies.STUDIES, "divisors", TOY)
    with computing(tmp_path) as client:
        finished(client, TOY_JOB)
    (url,) = tmp_path.rglob("*.zarr")
    intact = {path: path.read_bytes() for path in url.rglob("*") if path.is_file()}
    (url / "count/c.2").write_bytes(b"damaged")
    (url / "number/zarr.json").unlink()
    with computing(tmp_path):
        wait_for(lambda: {path: path.read_bytes() for path in intact if path.is_file()} == intact)
