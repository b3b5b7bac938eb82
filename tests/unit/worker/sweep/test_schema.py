"""Layouts of sweeps: shapes, keys, and the texts for people and readers."""

from scripted import small
from tables import for_each

from kernel.params import KERNEL_VERSION, STATE_FIELDS
from worker.study import Array
from worker.sweep import SweepSpec, schema
from worker.sweep.schema import layout

UP_AND_DOWN = {"kind": "ramp", "axis": "gamma", "direction": "both"}


def arrays(spec: SweepSpec) -> dict[str, Array]:
    return {array.name: array for array in schema.arrays(spec)}


def test_a_sweep_stores_what_it_computes():
    usual = ["flight_time", "takeoff_phase", "flights", "bounces", "periods"]
    assert list(arrays(small())) == [*usual, "outcome"]
    assert list(arrays(small(protocol=UP_AND_DOWN))) == [*usual, "end_state", "outcome"]
    assert list(arrays(small(exponents=2))) == [*usual, "lyapunov", "lyapunov_error", "outcome"]
    assert list(arrays(small(refine={"by": "mode"}))) == [*usual, "computed", "outcome"]


def test_the_shapes_of_a_sweep():
    spec = small(protocol=UP_AND_DOWN, exponents=2)
    cut, found = layout(spec, (1, 2, 4)), arrays(spec)
    assert schema.sizes(spec) == {
        "direction": 2, "xi": 2, "omega": 3, "gamma": 10, "flight": 8, "exponent": 2,
        "state": len(STATE_FIELDS),
    }  # fmt: skip
    assert cut.shape(found["flight_time"]) == (2, 2, 3, 10, 8)
    assert cut.chunk_shape(found["flight_time"]) == (1, 1, 2, 4, 8)
    assert cut.chunk_shape(found["lyapunov"]) == (1, 1, 2, 4, 2)
    assert cut.shape(found["outcome"]) == (2, 2, 3, 10)
    assert cut.chunk_bytes == 8 * schema.bytes_per_cell(spec)
    assert cut.inner_shape(found["outcome"]) is None
    assert cut.coords((slice(1, 2), slice(1, 2), slice(2, 3), slice(8, 10))) == (1, 1, 1, 2)
    assert cut.identity == {"job": spec.job_id(KERNEL_VERSION), "chunk_shape": [1, 2, 4]}
    place = slice(1, 2), slice(0, 2), slice(1, 3), slice(2, 10)
    assert cut.describe(place) == "down, gamma 1.5 to 5, omega 0.7 to 1, xi 0.05 to 0.26"


@for_each(
    ("key", "known"),
    [
        ("zarr.json", True), ("outcome/zarr.json", True), ("outcome/c.0.1.0.2", True),
        ("outcome/.zattrs", False), (".spec-0123456789abcdef", False), ("", False),
    ],
)  # fmt: skip
def test_which_files_a_store_has(key, known):
    assert layout(small(), (1, 1, 1)).has_key(key) == known
