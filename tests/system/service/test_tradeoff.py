"""The costs and errors of contact models, measured on every line of cells."""

from typing import Any

import pytest

from service.tradeoff import (
    SETUPS,
    Measurement,
    Setup,
    measure,
)
from worker.spec.contact_models import CONTACT_MODELS

#: Those against a hard plate, but for the stepped ones, which take long.
CHEAP = tuple(setup for setup in SETUPS if setup.purpose == "plate" and setup.model != "stepped")


@pytest.fixture(scope="module")
def measured() -> list[Measurement]:
    return [measure(setup) for setup in CHEAP]


def row_of(rows: list[Measurement], model: str, **settings: Any) -> Measurement:
    settings = {"model": model, **settings}
    (row,) = (row for row in rows if all(getattr(row, name) == value for name, value in settings.items()))
    return row


def test_a_soft_contact_becomes_a_hard_plate_in_proportion_to_its_depth(measured: list[Measurement]):
    for d in (1e-2, 1e-3, 1e-4, 1e-5):
        adhesive = row_of(measured, "soft", penetration=d, adhesive=True)
        assert adhesive.error == pytest.approx(2 * d, rel=0.1)
        assert row_of(measured, "soft", penetration=d, adhesive=False).error < 10 * d * d


def test_a_rigid_plate_is_the_hard_one(measured: list[Measurement]):
    rigid = row_of(measured, "rigid")
    assert rigid.error < 1e-11
    assert rigid.agree > 0.95  # a cell next to where a mode ends may take another


def test_a_ball_is_a_spring_only_where_the_dashpot_locks(measured: list[Measurement]):
    assert row_of(measured, "ball", locked_only=False).error > 1.0
    assert row_of(measured, "ball", locked_only=True).error < 0.03


def test_the_cost_table_agrees_with_the_measurements(measured: list[Measurement]):
    """Up to a factor for the speed of this machine."""
    models = {"ball": {"locked_only": False}, "rigid": {}, "soft": {"penetration": 1e-3, "adhesive": True}}
    factors = {
        model: row_of(measured, model, **settings).cost / CONTACT_MODELS[model].cost_us
        for model, settings in models.items()
    }
    assert max(factors.values()) < 12 * min(factors.values()), factors


def test_more_steps_reduce_the_error_at_the_scheme_s_order():
    """Second order: 2.5 times the steps, an error some 6 times smaller."""
    twenty, fifty = (
        measure(Setup(purpose="adhesive", model="stepped", restitution=0.01, penetration=1e-3,
                     adhesive=True, steps_per_contact=steps, scheme="verlet", locked_only=True))
        for steps in (20, 50)
    )  # fmt: skip
    assert 3.0 < twenty.error / fifty.error < 15.0
