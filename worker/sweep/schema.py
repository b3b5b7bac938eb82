"""The stored variables of a sweep: names, dimensions, types, units, long names and fill values, once."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from kernel.params import STATE_FIELDS
from worker.spec.contact_models import Stepped
from worker.spec.time_steps import corners, stated
from worker.study.layout import CELL_DIMS, OUTCOME_FLAGS, Array, Layout, array, bytes_of, grid_layout
from worker.sweep.specification import SweepSpec

RECORD: Final = (
    array("flight_time", (*CELL_DIMS, "flight"), "<f8", "flight time, last flights of the window in order",
          "rad"),
    array("takeoff_phase", (*CELL_DIMS, "flight"), "<f8", "plate phase at take-off, modulo 2 pi", "rad"),
    array("flights", CELL_DIMS, "<i4", "flights taken off and landed within the window"),
    array("bounces", CELL_DIMS, "<i4", "mode: bounces in one cycle, 0 if none was found"),
    array("periods", CELL_DIMS, "<i4", "mode: plate periods in one cycle, 0 if none was found"),
)  # fmt: skip
#: The arrays of a cell's mode. A cell that is filled in takes them from another.
MODE_ARRAYS: Final = ("outcome", "bounces", "periods")
END_STATE: Final = array(
    "end_state", (*CELL_DIMS, "state"), "<f8", "state at the end of the window, in the cell's own units",
    None, fields=" ".join(STATE_FIELDS),
)  # fmt: skip
_CERTIFIED: Final = "of certified cells; NaN: not certified"
CERTIFICATE: Final = (
    array("flight_error", CELL_DIMS, "<f8", "bound on the error of each flight time and take-off phase",
          "rad", comment=_CERTIFIED),
    array("multiplier", CELL_DIMS, "<f8", "modulus of the cycle's leading Floquet multiplier",
          comment=f"margin of stability: 1 at a bifurcation; {_CERTIFIED}"),
    array("multiplier_angle", CELL_DIMS, "<f8", "angle of the cycle's leading Floquet multiplier", "rad",
          comment=f"near a bifurcation: 0 beside a fold, pi beside a flip; {_CERTIFIED}"),
)  # fmt: skip
LYAPUNOV: Final = array(
    "lyapunov", (*CELL_DIMS, "exponent"), "<f8", "Lyapunov exponents, the largest first",
    comment="per plate period, natural logarithm; -inf: a lost direction, NaN: a failed run",
)  # fmt: skip
LYAPUNOV_ERROR: Final = array(
    "lyapunov_error", CELL_DIMS, "<f8", "standard error of the largest Lyapunov exponent",
    comment="per plate period, by means over overlapping thirds of the window; NaN: a lost direction, a "
    "failed run, or observe below 40",
)  # fmt: skip
COMPUTED: Final = array(
    "computed", CELL_DIMS, "|u1", "whether the cell was computed", None,
    flag_values=[0, 1], flag_meanings="taken_from_its_block computed",
    comment="0: outcome and mode are those of the nearest computed corner or centre of its block",
)  # fmt: skip
#: Written last: a cell with an outcome has all other values.
OUTCOME: Final = array(
    "outcome", CELL_DIMS, "|u1", "what became of the cell", **OUTCOME_FLAGS,
    comment="3 % of aperiodic cells are periodic in the end, chaotic transients; where no cell is certified, "
    "a start exactly on an unstable cycle is periodic",
)  # fmt: skip


#: Every array that a sweep may have.
ARRAYS: Final = (*RECORD, *CERTIFICATE, LYAPUNOV, LYAPUNOV_ERROR, END_STATE, COMPUTED, OUTCOME)


def arrays(spec: SweepSpec) -> Iterator[Array]:
    """The arrays of a sweep in the order they are written; `end_state` only for ramps."""
    yield from RECORD
    if spec.certifies:
        yield from CERTIFICATE
    if spec.exponents:
        yield LYAPUNOV
        yield LYAPUNOV_ERROR
    if spec.ramp_axis is not None:
        yield END_STATE
    if spec.fills_in:
        yield COMPUTED
    yield OUTCOME


def sizes(spec: SweepSpec) -> dict[str, int]:
    """Length of every dimension of a sweep."""
    return dict(zip(CELL_DIMS, spec.shape, strict=True)) | {
        "flight": spec.keep,
        "exponent": spec.exponents,
        "state": len(STATE_FIELDS),
    }


def bytes_per_cell(spec: SweepSpec) -> int:
    """Stored bytes per cell of a sweep before compression."""
    return bytes_of(arrays(spec), sizes(spec))


def layout(spec: SweepSpec, chunk_shape: tuple[int, ...]) -> Layout:
    """Layout of a sweep's store with chunks of `chunk_shape` cells along (xi, omega, gamma)."""
    # zarr has no stable form of fixed-length text
    directions = {"direction": np.array(spec.directions, dtype=np.dtypes.StringDType())}
    title, model = "bouncing spring", spec.model.kind
    whole = grid_layout(spec, chunk_shape, tuple(arrays(spec)), sizes(spec), {}, title, model, directions)
    if isinstance(spec.model, Stepped):
        steps = stated(spec.model, corners(spec))
        return replace(whole, attributes={**whole.attributes, "time_steps": steps})
    return whole
