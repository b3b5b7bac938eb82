"""The costs and errors of contact models that `bounce tradeoff` measures: what its picture says of them."""

import pytest
import xarray

from service.figures import tradeoff
from service.figures.tradeoff import SETTINGS, Setting
from worker.spec.contact_models import CONTACT_MODELS, Soft, Stepped

#: Those against a hard plate, but for the stepped ones, which take long.
CHEAP = [s for s in SETTINGS if s.purpose == "plate" and s.contact.kind != "stepped"]


@pytest.fixture(scope="module")
def measured() -> xarray.Dataset:
    found = tradeoff.measure(CHEAP, lambda done: None)
    return found.set_index(setting="contact")


def test_a_soft_contact_becomes_a_hard_plate_in_proportion_to_its_depth(measured: xarray.Dataset):
    for d in (1e-2, 1e-3, 1e-4, 1e-5):
        adhesive = measured.sel(setting=f"soft, d = {d:g}")
        assert float(adhesive["error"]) == pytest.approx(2 * d, rel=0.1)
        assert float(measured.sel(setting=f"soft, d = {d:g}, nonadhesive")["error"]) < 10 * d * d


def test_a_rigid_plate_is_the_hard_one(measured: xarray.Dataset):
    rigid = measured.sel(setting="rigid")
    assert float(rigid["error"]) < 1e-11
    assert float(rigid["share"]) < 0.05  # a cell next to where a mode ends may take another


def test_a_ball_is_a_spring_only_where_the_dashpot_locks(measured: xarray.Dataset):
    assert float(measured.sel(setting="ball")["error"]) > 1.0
    assert float(measured.sel(setting="ball, locked dashpot")["error"]) < 0.03


def test_the_cost_table_agrees_with_the_measurements(measured: xarray.Dataset):
    """Up to a factor for the speed of this machine."""
    names = {"ball": "ball", "rigid": "rigid", "soft": "soft, d = 0.001"}
    factors = [
        float(measured.sel(setting=name)["cost"]) / CONTACT_MODELS[model].cost_us
        for model, name in names.items()
    ]
    assert max(factors) < 12 * min(factors), factors


def test_more_steps_reduce_the_error_at_the_scheme_s_order():
    """Second order: 2.5 times the steps, an error some 6 times smaller."""
    soft = Soft(penetration=1e-3).model_dump(exclude={"kind"})
    both = [Setting("adhesive", Stepped(**soft, steps_per_contact=n), locked=True) for n in (20, 50)]
    twenty, fifty = tradeoff.measure(both, lambda done: None)["error"].values
    assert 3.0 < twenty / fifty < 15.0
