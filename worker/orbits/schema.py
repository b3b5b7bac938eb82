"""The stored variables of a study of orbits."""

from typing import Final

import numpy as np

from kernel.cycles.events import Kind
from worker.orbits.specification import DIMS, OrbitsSpec
from worker.study.layout import Array, Layout, array, grid_layout, whether_computed

KINDS: Final = tuple(Kind)

_POINT, _EVENT = (*DIMS, "branch", "point"), (*DIMS, "event")
_LENGTH, _SPEED = "plate amplitudes", "plate amplitudes per rad"


def _violations(name: str, dims: tuple[str, ...]) -> Array:
    meanings = "gap_negative_in_flight force_negative_in_contact no_takeoff"
    return array(
        name, dims, "|u1", "why the cycle is not one of the spring",
        flag_masks=[1, 2, 4], flag_meanings=meanings, comment="0: a cycle of the spring",
    )._replace(earlier=name.replace("violations", "admissible"))  # fmt: skip


#: The stored arrays in the order they are written.
ARRAYS: Final = (
    array("gamma", _POINT, "<f8", "plate acceleration over gravity",
          comment="NaN: no point; one between the parts of a branch that leaves gamma_max"),
    array("flight_time", _POINT, "<f8", "flight time", "rad"),
    array("takeoff_phase", _POINT, "<f8", "plate phase at take-off, modulo 2 pi", "rad"),
    array("elongation", _POINT, "<f8", "elongation of the spring at take-off", _LENGTH),
    array("elongation_velocity", _POINT, "<f8", "velocity of the elongation at take-off", _SPEED),
    array("impact_velocity", _POINT, "<f8", "velocity of the gap before landing", _SPEED),
    array("multiplier", _POINT, "<c16", "Floquet multiplier, the larger in modulus"),
    array("other_multiplier", _POINT, "<c16", "the other Floquet multiplier"),
    array("stable", _POINT, "|b1", "whether both multipliers are inside the unit circle"),
    _violations("violations", _POINT),
    array("event_kind", _EVENT, "|u1", "kind of event",
          flag_values=list(range(len(KINDS) + 1)), flag_meanings=" ".join(["none", *KINDS])),
    array("event_gamma", _EVENT, "<f8", "plate acceleration over gravity"),
    array("event_bounces", _EVENT, "<i4", "bounces of the cycle"),
    array("event_periods", _EVENT, "<i4", "plate periods of the cycle"),
    array("event_flight_time", _EVENT, "<f8", "flight time", "rad"),
    _violations("event_violations", _EVENT),
    array("event_count", DIMS, "<i4", "events of the cell, also those beyond the dimension event"),
    whether_computed(DIMS, "unresolved"),
)  # fmt: skip


def sizes(spec: OrbitsSpec) -> dict[str, int]:
    return {"branch": len(spec.modes), "point": spec.points, "event": spec.events}


def layout(spec: OrbitsSpec, chunk_shape: tuple[int, ...]) -> Layout:
    """Layout of the store with chunks of `chunk_shape` cells along (xi, omega)."""
    names = np.array(spec.modes, dtype=np.dtypes.StringDType())
    branch = {"branch": (names, {"long_name": "mode of the branch: bounces-periods"})}
    title, model = "bouncing spring: cycles in closed form", "rigid, restitution 0"
    return grid_layout(spec, chunk_shape, ARRAYS, sizes(spec), branch, title, model)
