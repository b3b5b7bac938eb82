"""Basins as a job: over HTTP, in the client, as a picture."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from served import get, occupied

from service.client import BadRequest, BounceError, Client, Job
from service.pictures import ATTRACTORS, UNDECIDED
from service.views import basins

SPEC: dict[str, Any] = {
    "name": "drops", "gamma": [0.6, 1.27], "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"},
    "protocol": {"kind": "basin", "rows": 16, "columns": 24}, "settle": 200, "exponents": 1,
}  # fmt: skip
#: The two cycles (1,1) at Gamma = 1.27, Omega = 0.5, xi = 0.26: tests/unit/worker/basins/test_basins.py.
FLIGHTS = [4.631301, 3.374643]


@pytest.fixture(scope="module")
def job(python_client: Client) -> Job:
    return python_client.submit(SPEC).wait(progress=False)


@pytest.fixture(scope="module")
def found(job: Job) -> xarray.Dataset:
    return job.basins(1.25)  # the nearest is 1.27


def test_a_cell_that_is_not_computed_yet_is_not_complete(tmp_path: Path):
    with occupied(tmp_path) as service:
        job = service.post("/v1/jobs", json=SPEC).json()
        answer = get(service, f"/v1/jobs/{job['id']}/basins", gamma=1.25)
        assert answer["attrs"]["complete"] is False
        assert answer["dims"]["attractor"] == 0
        assert answer["data_vars"]["undecided"]["data"] is None


def test_what_is_refused(python_client: Client, job: Job):
    with pytest.raises(BounceError, match="basins by result_file"):
        job.plot()
    with pytest.raises(BadRequest, match="gamma: is required"):
        job.basins()
    with pytest.raises(BadRequest, match="gamma: must be within"):
        job.basins(5.0)
    sweep = python_client.submit({"gamma": 1.2, "omega": 0.5, "xi": 0.26, "settle": 1, "observe": 1})
    with pytest.raises(BadRequest, match="this job has no basins: its protocol is rest"):
        sweep.wait(progress=False).basins()


def drawn(shown: xarray.Dataset) -> Axes:
    figure = Figure()
    basins.draw(shown, figure)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    return axes


def legend(shown: xarray.Dataset) -> list[tuple[str, str]]:
    """Colour and text of every entry."""
    entries = drawn(shown).get_legend()
    assert entries is not None
    texts = [text.get_text() for text in entries.get_texts()]
    return [(to_hex(p.get_facecolor()), t) for p, t in zip(entries.get_patches(), texts, strict=True)]


def test_every_start_is_a_pixel_in_the_colour_of_its_attractor(found: xarray.Dataset):
    contact = found.column.assign_attrs(long_name="velocity times omega")
    assert drawn(found.assign_coords(column=contact)).get_xlabel() == "velocity times Ω (rad)"
    (picture,) = drawn(found).collections
    assert np.array_equal(picture.get_array(), found.attractor_of_start)
    colours = [to_hex(colour) for colour in picture.cmap(picture.norm(np.arange(3)))]
    assert colours == [UNDECIDED, *ATTRACTORS[:2]]
    corners = picture.get_coordinates()
    for values, sides in ((found.column, corners[0, :, 0]), (found.row, corners[:, 0, 1])):
        np.testing.assert_allclose(0.5 * (sides[1:] + sides[:-1]), values)


def test_the_legend_names_attractors_and_what_is_undecided(found: xarray.Dataset):
    fractions = [f"{100 * share:.1f} %" for share in found.attractor_fraction.values]
    named = [(ATTRACTORS[i], f"(1,1)  {fractions[i]}, up to {FLIGHTS[i]:.4g} rad") for i in (0, 1)]
    assert legend(found) == named
    assert legend(found.assign(undecided=0.25))[2:] == [(UNDECIDED, "undecided  25.0 %")]
    none = found.isel(attractor=slice(0)).assign(undecided=np.nan)
    assert legend(none) == [(UNDECIDED, "not computed")]
    many = xarray.concat([found] * 10, "attractor", data_vars="minimal", coords="minimal", compat="override")
    texts = [text for _, text in legend(many)]
    assert texts[basins.NAMED :] == ["and 4 more"]
