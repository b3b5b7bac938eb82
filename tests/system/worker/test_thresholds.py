"""Thresholds refined on workers."""

from collections.abc import Iterator

import numpy as np
import pytest
from served import service_at
from studies import spec_of

from kernel.threshold import threshold
from service.client import Client, Job
from worker.executors.dask import Dask


def ramp(direction: str) -> dict[str, str]:
    return {"kind": "ramp", "axis": "gamma", "direction": direction}


SWEEP = spec_of((0.4, 1.2, 81), [0.6, 0.66], [0.05, 0.2], protocol=ramp("both"), window=(100, 20, 4))


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, cluster: Dask) -> Iterator[str]:
    with service_at(tmp_path_factory.mktemp("data"), cluster) as address:
        yield address


@pytest.fixture(scope="module")
def job(address: str) -> Iterator[Job]:
    with Client(address) as client:
        yield client.submit(SWEEP).wait(progress=False)


def test_a_job_refines_its_thresholds_on_the_workers(job: Job):
    for xi in (0.05, 0.2):
        fine, coarse = job.threshold(xi, tolerance=1e-5), job.threshold(xi)
        np.testing.assert_allclose(fine.up, threshold(np.array([0.6, 0.66]), xi), rtol=0, atol=1e-5)
        # the grid has none where the cell that decides is still settling: its bouncing dies
        assert np.all((fine.down <= coarse.down + 1e-5) | (coarse.down_status == "settling"))
        assert fine.attrs["tolerance"] == 1e-5
        assert "tolerance" not in coarse.attrs
    assert float(job.threshold(0.05, tolerance=1e-4).down[0]) == pytest.approx(0.553, abs=1e-3)
