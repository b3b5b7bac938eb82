"""What the architecture promises to whoever adds something: how little it takes.

The toys in tests/support are registered in the tables and run end to end, through HTTP and the real store.
"""

from pathlib import Path

import pytest
import xarray
from scripted import wait_for
from served import computing, finished, get
from stores import files
from toy_study import TOY

from worker import studies

TOY_JOB = {"name": "divisors", "protocol": {"kind": "divisors"}, "last": 30}


def test_a_kind_of_study_is_five_answers_and_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Damage to it is found and repaired, too."""
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

    intact = files(url)
    (url / "count/c.2").write_bytes(b"damaged")
    (url / "number/zarr.json").unlink()
    with computing(tmp_path) as client:
        assert client.get(f"{here}/zarr/count/c.2").status_code == 503
        wait_for(lambda: files(url) == intact)
