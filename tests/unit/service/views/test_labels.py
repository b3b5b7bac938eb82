"""Labels and exponents in every answer, and how many cells were still settling."""

from typing import Final

import numpy as np
import pytest
from fastapi.testclient import TestClient
from matplotlib.figure import Figure
from served import finished, get, read
from studies import spec_of

from kernel.labels import LABELS
from service.views.registry import VIEWS

#: At Omega = 1, xi = 0.05: a cell at rest, a (1, 2) mode, a torus, chaos (docs/model.md).
SWEEP: Final = spec_of([0.1, 3.0, 3.8, 4.6], [0.9, 1.0], 0.05, window=(300, 300, 16), exponents=2)
EXPECTED: Final = ["at_rest", "periodic", "quasi-periodic", "chaotic"]


@pytest.fixture(scope="module")
def job(client: TestClient) -> str:
    return finished(client, SWEEP)


def test_a_diagram_tells_quasi_periodic_from_chaotic_cells(client: TestClient, job: str):
    found = read(client, f"{job}/diagram", omega=1.0)
    assert [LABELS[code] for code in found.label.values] == EXPECTED
    assert found.lyapunov.dims == ("gamma", "exponent")
    at_rest, periodic, torus, chaos = found.lyapunov.values
    assert max(*at_rest, *periodic) < 0
    assert abs(torus[0]) < 0.01 < chaos[0]
    assert 0.0 < found.lyapunov_error.values[3] < 0.1
    modes = read(client, f"{job}/modes").isel(omega=-1)
    for name in ("label", "lyapunov", "lyapunov_error"):
        assert modes[name].values.tolist() == found[name].values.tolist()
    assert found.label.attrs["flag_meanings"].split() == list(LABELS)
    VIEWS["diagram"].draw(found, figure := Figure())
    flights, exponents = figure.axes
    assert exponents.lines[1].get_ydata().tolist() == found.lyapunov.values[:, 0].tolist()
    assert exponents.get_xlim() == flights.get_xlim()
    hidden = read(client, f"{job}/diagram", omega=1.0, hide="chaotic")
    for name in ("lyapunov", "lyapunov_error"):
        assert np.isnan(hidden[name].values[3]).all()
        np.testing.assert_array_equal(hidden[name].values[:3], found[name].values[:3])


#: Slow settling next to the resonance, and a window too short for it.
SHORT: Final = spec_of((0.6, 1.5, 46), 1.0, 0.01, window=(20, 60, 4))


def test_a_job_says_how_many_cells_were_settling(client: TestClient):
    view = get(client, finished(client, SHORT))
    outcomes = read(client, f"{view['links']['self']}/modes").outcome
    settling = int((outcomes == LABELS.index("settling")).sum())
    assert settling > 0
    assert view["progress"]["cells_settling"] == settling
