"""Adaptive maps through the service: answers, windows, estimates, files, repair."""

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from scripted import Held, wait_for
from served import finished, get, read, service
from studies import spec_of

from kernel.labels import CHAOTIC
from kernel.params import Outcome

SPACE = spec_of(
    (0.4, 2.4, 49), (0.4, 1.0, 41), 0.05, name="thresholds and modes", until=5_000, observe=60, keep=8
)
MAP: dict[str, Any] = {**SPACE, "refine": {"by": "mode", "coarsest": 8}}
VAST = spec_of(
    (0.4, 4.4, 10_000), (0.4, 1.4, 10_000), 0.05, until=5_000, observe=60, keep=64, refine={"by": "mode"}
)


@pytest.fixture(scope="module")
def full(client: TestClient) -> str:
    return finished(client, SPACE)


@pytest.fixture(scope="module")
def adaptive(client: TestClient) -> str:
    return finished(client, MAP)


def test_a_mode_map_counts_no_flights_anew(client: TestClient, adaptive: str):
    answer = client.get(f"{adaptive}/modes?min_flight=0.3")
    assert answer.status_code == 422
    assert "min_flight" in answer.text
    assert client.get(f"{adaptive}/modes?min_flight=0.05").status_code == 200


def test_filled_cells_have_the_margin_and_the_label_of_a_computed_cell_of_their_mode(
    client: TestClient, full: str, adaptive: str
):
    whole, part = (read(client, f"{job}/modes", color="multiplier") for job in (full, adaptive))
    filled, certified = ~part.computed.astype(bool), np.isfinite(whole.multiplier)
    same = np.logical_and.reduce([whole[name] == part[name] for name in ("outcome", "bounces", "periods")])
    np.testing.assert_array_equal(part.multiplier.where(~filled), whole.multiplier.where(~filled))
    cells = (filled & same & certified).values
    assert cells.sum() > 100
    assert set(part.multiplier.values[cells]) <= set(part.multiplier.values[~filled.values])
    assert np.median(abs(part.multiplier - whole.multiplier).values[cells]) < 0.1
    assert np.isnan(part.flight_error.values[filled.values]).all()  # no certificate
    assert "computed neighbour" in part.multiplier.attrs["comment"]
    assert "neighbour" not in whole.multiplier.attrs["comment"]
    assert (
        f"{100.0 * part.attrs['computed_share']:.2g} % of the cells computed"
        in part.bounce.plot().get_title()
    )
    assert "computed" not in whole.bounce.plot().get_title()
    chaos = spec_of(
        (4.4, 5.2, 33), (0.5, 0.8, 33), 0.26, window=(50, 50, 8), exponents=1, refine={"by": "mode"}
    )
    job = finished(client, chaos)
    labels = read(client, f"{job}/modes")
    filled = ~labels.computed.astype(bool) & (labels.outcome == Outcome.APERIODIC)
    assert filled.sum() > 100
    assert (labels.label.values[filled.values] == CHAOTIC).mean() > 0.9
    lines = [read(client, f"{job}/diagram", omega=float(omega)).label.values for omega in labels.omega]
    assert (lines == labels.label.values)[filled.values].mean() > 0.9


def test_refined_thresholds_are_those_of_the_full_grid(client: TestClient, full: str, adaptive: str):
    def refined(job: str) -> Any:
        path = f"{job}/threshold?tolerance=0.001"
        wait_for(lambda: client.get(path).status_code == 200)
        return read(client, path)

    whole, part = refined(full), refined(adaptive)
    np.testing.assert_array_equal(part.up_status, whole.up_status)
    np.testing.assert_array_equal(part.up, whole.up)


def test_a_map_of_a_hundred_million_cells_is_planned_in_little_memory(tmp_path: Path):
    with service(tmp_path, Held()) as client:
        tracemalloc.start()
        assert client.post("/v1/jobs?validate_only=true", json=VAST).json()["cells"] == 10**8
        accepted = client.post("/v1/jobs", json=VAST)
        wait_for(lambda: get(client, accepted.headers["Location"])["state"] == "running")
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert accepted.status_code == 202
        assert peak < 500 * 2**20
