"""Adaptive maps through a service that listens."""

from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from scripted import DEADLINE
from served import computing_at
from studies import spec_of

from kernel.params import KERNEL_VERSION, Outcome
from service.client.client import Client

SPACE = spec_of((0.4, 2.4, 49), (0.4, 1.0, 41), 0.05, name="thresholds and modes", window=(300, 60, 8))

MAP: dict[str, Any] = {**SPACE, "refine": {"by": "mode", "coarsest": 8}}


def test_the_client_refines_a_window(tmp_path: Path):
    with computing_at(tmp_path) as address, Client(address) as client:
        estimate = client.estimate(MAP)
        assert estimate.computed_cells is not None
        job = client.submit(MAP).wait(progress=False)
        modes = job.modes()
        assert modes.attrs["computed_share"] == pytest.approx(float(modes.computed.mean()))
        assert "computed" in job.diagram(omega=0.6)
        assert job.threshold().up_computed.dtype == bool
        window = job.refine(gamma=(0.6, 1.1), omega=(0.5, 0.7), by="bouncing").wait(progress=False)
        assert window.spec["parent"] == job.id != window.id
        assert set(np.unique(window.modes().outcome)) <= {int(outcome) for outcome in Outcome}
        view = httpx2.get(f"{address}/v1/jobs/{window.id}", timeout=DEADLINE).json()
        assert view["kernel_version"] == KERNEL_VERSION
