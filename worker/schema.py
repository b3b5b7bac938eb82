"""Room: every array a store holds, declared once: name, dimensions, type, units, meaning.

Imports numpy, kernel.params and worker.spec; knows nothing of zarr.
"""

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from kernel.params import STATE_FIELDS, Outcome
from worker.spec import SweepSpec

#: The four dimensions that make a cell's address, slowest first.
CELL_DIMS: Final = ("direction", "xi", "omega", "gamma")


class Array(NamedTuple):
    """One stored array. `fill` is what a cell not computed yet reads as."""

    name: str
    dims: tuple[str, ...]
    dtype: str
    fill: float | int
    attrs: dict[str, Any]

    @property
    def extra_dims(self) -> tuple[str, ...]:
        """The dimensions beyond the cell's own; a chunk spans them whole."""
        return self.dims[len(CELL_DIMS) :]


class Coordinate(NamedTuple):
    """The values along one dimension."""

    name: str
    attrs: dict[str, Any]


_OUTCOMES: Final[dict[str, Any]] = {
    "flag_values": [int(outcome) for outcome in Outcome],
    "flag_meanings": " ".join(outcome.name.lower() for outcome in Outcome),
}


_NAN: Final = float("nan")
_COUNT: Final[dict[str, Any]] = {"units": "1"}
_ANGLE: Final[dict[str, Any]] = {"units": "rad"}


def _array(name: str, dtype: str, long_name: str, attrs: dict[str, Any], extra: str = "") -> Array:
    dims = (*CELL_DIMS, extra) if extra else CELL_DIMS
    return Array(name, dims, dtype, _NAN if dtype == "<f8" else 0, {"long_name": long_name, **attrs})


RECORD: Final = (
    _array("flight_time", "<f8", "flight time, last flights of the window in order", _ANGLE, "flight"),
    _array("takeoff_phase", "<f8", "plate phase at take-off, modulo 2 pi", _ANGLE, "flight"),
    _array("flights", "<i4", "flights taken off and landed within the window", _COUNT),
    _array("bounces", "<i2", "mode: bounces in one cycle, 0 if none was found", _COUNT),
    _array("periods", "<i2", "mode: plate periods in one cycle, 0 if none was found", _COUNT),
)
END_STATE: Final = _array(
    "end_state", "<f8", "state at the end of the window, in the cell's own units",
    {"fields": " ".join(STATE_FIELDS)}, "state",
)  # fmt: skip
#: Written last, so that a cell which has an outcome has everything else too.
OUTCOME: Final = _array("outcome", "|u1", "what became of the cell", _COUNT | _OUTCOMES)

COORDINATES: Final = (
    Coordinate("direction", {"long_name": "protocol: from rest, or the ramp's direction"}),
    Coordinate("xi", {"long_name": "damping ratio of the spring", "units": "1"}),
    Coordinate("omega", {"long_name": "plate frequency over the spring's natural frequency", "units": "1"}),
    Coordinate("gamma", {"long_name": "plate acceleration over gravity", "units": "1"}),
)


def arrays(spec: SweepSpec) -> Iterator[Array]:
    """The arrays a sweep stores; only ramps keep the state they carry on from."""
    yield from RECORD
    if spec.ramp_axis is not None:
        yield END_STATE
    yield OUTCOME


def sizes(spec: SweepSpec) -> dict[str, int]:
    """Length of every dimension."""
    return dict(zip(CELL_DIMS, spec.shape, strict=True)) | {"flight": spec.keep, "state": len(STATE_FIELDS)}


def bytes_per_cell(spec: SweepSpec) -> int:
    """Bytes one cell takes before compression."""
    length = sizes(spec)
    return sum(
        np.dtype(array.dtype).itemsize * int(np.prod([length[dim] for dim in array.extra_dims], dtype=int))
        for array in arrays(spec)
    )
