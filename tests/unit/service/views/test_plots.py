"""A job's results as plots: what is drawn by default, and hatches."""

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from studies import spec_of

from service.client import BounceError, Client, Job
from service.pictures import AXES, DIFFER, FLIGHT, HATCH

RAMP = spec_of((0.5, 1.5, 21), [0.6, 0.9, 1.2], 0.05, ramp="both", window=(60, 20, 4))


@pytest.fixture(scope="module")
def job(python_client: Client) -> Job:
    return python_client.submit(RAMP).wait(progress=False)


@pytest.fixture
def ax() -> Axes:
    return Figure().subplots()


def test_what_is_drawn_by_default(job: Job, python_client: Client):
    assert job.plot().get_ylabel() == AXES["omega"]
    two = python_client.submit(RAMP | {"omega": [0.6, 0.7]}).wait(progress=False)
    assert two.plot().get_ylabel() == AXES["omega"]
    one = python_client.submit(RAMP | {"omega": 0.6, "gamma": 1.4, "protocol": {"kind": "rest"}})
    assert one.wait(progress=False).plot().get_xlabel() == AXES["gamma"]
    single = python_client.submit(RAMP | {"omega": 0.6}).wait(progress=False)
    assert single.plot(direction="down").get_ylabel() == "flight time (rad)"
    over_omega = python_client.submit(
        RAMP | {"gamma": 1.4, "protocol": {"kind": "rest"}, "omega": [0.6, 0.7, 0.8]}
    ).wait(progress=False)
    assert over_omega.plot().get_xlabel() == AXES["omega"]
    assert over_omega.plot(along="omega").get_xlabel() == AXES["omega"]
    assert job.plot("diagram", along="omega", gamma=1.5).get_xlabel() == AXES["omega"]
    assert job.plot(along="gamma", omega=0.6).get_ylabel() == FLIGHT
    both = job.plot("diagram", omega=0.6, ax=Figure().subplots())
    assert both.get_legend_handles_labels()[1] == ["ramp up", "ramp down"]
    with pytest.raises(BounceError, match="kind: must be one of diagram, modes, threshold, orbits"):
        job.plot("pie")  # type: ignore[arg-type]
    with pytest.raises(BounceError, match="are drawn in a diagram"):
        job.plot("modes", branches=python_client.orbits(0.6, 0.05, "1-1"))


def test_a_map_is_hatched_where_up_and_down_differ(job: Job, ax: Axes):
    differ = job.modes(hysteresis=True).hysteresis.values > 0
    assert differ.any()
    assert not differ.all()
    job.plot("modes", ax=ax)
    cells, hatched = ax.collections
    assert cells.get_hatch() is None
    assert hatched.get_hatch() == HATCH
    shown = hatched.get_array()
    assert np.array_equal(~np.ma.getmaskarray(shown).reshape(differ.shape), differ)
    legend = ax.get_legend()
    assert legend is not None
    assert legend.get_texts()[-1].get_text() == DIFFER
    plain = Figure().subplots()
    job.plot("modes", ax=plain, hysteresis=False)
    assert len(plain.collections) == 1
