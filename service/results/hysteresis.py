"""Where a sweep ramped both ways has hysteresis: cells whose attractor going up is not that going down."""

from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome
from kernel.recount import counted
from service.errors import InvalidRequest
from service.results.counting import shortest
from worker.spec import SweepSpec

#: Flights of cells with one mode are those of different cycles if they differ by more than this, rad, when
#: sorted. A cycle is found when its flights repeat within 1e-6 rad; beside a fold they are still 1e-4 away
#: from where they settle.
OTHER_FLIGHTS: Final = 1e-3

#: Outcomes that say nothing of the attractor: such cells are not compared.
_UNKNOWN: Final = (Outcome.MISSING, Outcome.UNRESOLVED, Outcome.DIVERGED, Outcome.SETTLING)


class Hysteresis(IntEnum):
    """How a cell's two directions compare."""

    NONE = 0  # they agree, or one of them is not known
    MODE = 1  # other outcomes or modes
    FLIGHTS = 2  # one mode, other flights


def check_both_ways(spec: SweepSpec) -> None:
    """Raise InvalidRequest for a sweep that is not ramped both ways."""
    if len(spec.directions) < 2:
        way = "from rest" if spec.ramp_axis is None else f"ramped {spec.directions[0]} only"
        rule = f'needs a sweep ramped both ways, with the direction "both"; this one is {way}'
        raise InvalidRequest.of("hysteresis", rule)


def compare(
    spec: SweepSpec,
    up: Mapping[str, NDArray[Any]],
    down: Mapping[str, NDArray[Any]],
    min_flight: float | None,
) -> NDArray[np.uint8]:
    """A `Hysteresis` for each cell, in the shape of `outcome`.

    up, down: `outcome`, `bounces`, `periods` (...) as counted with `min_flight` (rad; None: the sweep's own),
    the stored `flight_time` (..., keep), rad, and `flights` (...). Cells without a cycle both ways agree:
    their flights never repeat.
    """
    known = ~np.isin(up["outcome"], _UNKNOWN) & ~np.isin(down["outcome"], _UNKNOWN)
    same = np.logical_and.reduce([up[name] == down[name] for name in ("outcome", "bounces", "periods")])
    result: NDArray[np.uint8] = np.where(known & ~same, Hysteresis.MODE, Hysteresis.NONE).astype(np.uint8)
    cycles = same & (up["outcome"] == Outcome.PERIODIC)
    limit = shortest(spec, min_flight)
    for bounces in np.unique(up["bounces"][cycles]).tolist():
        cells = cycles & (up["bounces"] == bounces)
        ends = [
            _last(arrays["flight_time"][cells], arrays["flights"][cells], bounces, limit)
            for arrays in (up, down)
        ]
        other = np.max(np.abs(ends[0] - ends[1]), axis=1) > OTHER_FLIGHTS
        result[cells] = np.where(other, Hysteresis.FLIGHTS, Hysteresis.NONE)
    return result


def _last(
    times: NDArray[np.float64], flights: NDArray[np.int32], count: int, min_flight: float
) -> NDArray[np.float64]:
    """(n, count) the last flights that count of stored ones (n, keep), sorted; NaN where there are fewer."""
    counts = counted(times, flights, min_flight)
    order = np.argsort(counts, axis=1, kind="stable")[:, -count:]
    found = np.where(np.take_along_axis(counts, order, 1), np.take_along_axis(times, order, 1), np.nan)
    return np.sort(found, axis=1)
