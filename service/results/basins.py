"""The basin of one cell of a stored study: which start reaches which attractor."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.labels import LABELS, UNSTABLE, label_codes
from kernel.params import Outcome
from service.results.selection import Stored, nearest_index, read_stored
from worker.basins.attractors import EXPONENT_WINDOW
from worker.basins.spec import BasinSpec
from worker.spec import AXES

#: The stored arrays of an attractor that answers repeat.
PER_ATTRACTOR: Final = (
    "fraction", "attractor_outcome", "bounces", "periods", "longest_flight", "lifetime", "attractor_state",
    "flight_time", "takeoff_phase",
)  # fmt: skip
#: The stored arrays of a cell with one number.
NUMBERS: Final = ("attractor_count", "undecided", "basin_entropy", "boundary_entropy")


class Basins(Stored[BasinSpec]):
    """Basins of attraction."""


@dataclass(frozen=True)
class Attractor:
    """One attractor of a cell; lengths in plate amplitudes, times in rad."""

    id: int
    fraction: float
    outcome: int
    label: str
    bounces: int
    periods: int
    longest_flight: float
    lifetime: float  # plate periods; inf if no aperiodic motion was seen to end
    state: NDArray[np.float64]
    flight_time: NDArray[np.float64]  # of a window, without NaN
    takeoff_phase: NDArray[np.float64]
    lyapunov: NDArray[np.float64] | None


@dataclass(frozen=True)
class BasinCell:
    """The basin of one cell."""

    gamma: float
    omega: float
    xi: float
    spec: BasinSpec
    map: NDArray[np.uint8]  # (rows, columns) ids; 0: undecided or not computed
    attractors: tuple[Attractor, ...]
    numbers: Mapping[str, float]
    complete: bool


def basin(basins: Basins, gamma: float | None, omega: float | None, xi: float | None) -> BasinCell:
    """The basin of the cell nearest to these values; None is the value of an axis that has only one.

    Raises InvalidRequest as `selection.nearest_index`.
    """
    spec = basins.spec
    values = {"gamma": gamma, "omega": omega, "xi": xi}
    at = {axis: nearest_index(spec, axis, value) for axis, value in values.items()}
    arrays = _read(basins, {axis: at[axis].index for axis in AXES})
    computed = bool(arrays["outcome"] != Outcome.MISSING)
    return BasinCell(
        **{axis: point.value for axis, point in at.items()},
        spec=spec,
        map=arrays["attractor"],
        attractors=_attractors(spec, arrays) if computed else (),
        numbers={name: float(arrays[name]) for name in NUMBERS} if computed else {},
        complete=computed and not basins.repairing,
    )


def _read(basins: Basins, indices: Mapping[str, int]) -> dict[str, NDArray[Any]]:
    spec = basins.spec
    names = ["attractor", *PER_ATTRACTOR, *NUMBERS, "outcome", *(["lyapunov"] if spec.exponents else [])]
    plane = spec.protocol
    return read_stored(
        basins,
        names,
        indices,
        lambda: {
            "outcome": np.array(Outcome.MISSING),
            "attractor": np.zeros((plane.rows, plane.columns), np.uint8),
        },
    )


def _attractors(spec: BasinSpec, arrays: Mapping[str, NDArray[Any]]) -> tuple[Attractor, ...]:
    count = int((arrays["attractor_outcome"] != Outcome.MISSING).sum())
    outcomes = arrays["attractor_outcome"][:count]
    lyapunov = arrays["lyapunov"][:count] if spec.exponents else None
    codes = outcomes if lyapunov is None else label_codes(outcomes, lyapunov, EXPONENT_WINDOW)
    return tuple(
        Attractor(
            id=i + 1,
            fraction=float(arrays["fraction"][i]),
            outcome=int(outcomes[i]),
            label=attractor_label(int(codes[i]), int(arrays["bounces"][i]), int(arrays["periods"][i])),
            bounces=int(arrays["bounces"][i]),
            periods=int(arrays["periods"][i]),
            longest_flight=float(arrays["longest_flight"][i]),
            lifetime=float(arrays["lifetime"][i]),
            state=arrays["attractor_state"][i],
            flight_time=_without_nan(arrays["flight_time"][i]),
            takeoff_phase=_without_nan(arrays["takeoff_phase"][i]),
            lyapunov=None if lyapunov is None else lyapunov[i],
        )
        for i in range(count)
    )


def attractor_label(code: int, bounces: int, periods: int) -> str:
    """rest, a mode as (3,4), or the label of an aperiodic attractor; `code`: an outcome or a label's."""
    if code in (Outcome.PERIODIC, UNSTABLE):
        return f"({bounces},{periods})" + (" unstable" if code == UNSTABLE else "")
    return "rest" if code == Outcome.AT_REST else LABELS[code]


def _without_nan(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values[np.isfinite(values)]
