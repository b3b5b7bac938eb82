"""Layouts of sweeps: shapes, keys, and the texts for people and readers."""

from scripted import small

from worker.study import Array
from worker.sweep import SweepSpec, schema

UP_AND_DOWN = {"kind": "ramp", "axis": "gamma", "direction": "both"}


def arrays(spec: SweepSpec) -> dict[str, Array]:
    return {array.name: array for array in schema.arrays(spec)}


def test_a_sweep_stores_what_it_computes():
    usual = ["flight_time", "takeoff_phase", "flights", "bounces", "periods"]
    assert list(arrays(small())) == [*usual, "outcome"]
    assert list(arrays(small(protocol=UP_AND_DOWN))) == [*usual, "end_state", "outcome"]
    assert list(arrays(small(exponents=2))) == [*usual, "lyapunov", "lyapunov_error", "outcome"]
    assert list(arrays(small(refine={"by": "mode"}))) == [*usual, "computed", "outcome"]
