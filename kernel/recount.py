"""Modes of stored flights, with another shortest flight than the one they were classified with."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.modes import find_mode, is_settling
from kernel.numerics.elementary import TWO_PI
from kernel.numerics.jit import allocating, jit
from kernel.params import Outcome

_, PERIODIC, APERIODIC, _, _, _, SETTLING = map(int, Outcome)


class Modes(NamedTuple):
    """Outcome and mode of n cells."""

    outcome: NDArray[np.uint8]  # (n,) an Outcome
    bounces: NDArray[np.int32]  # (n,) flights per cycle, 0 if none was found
    periods: NDArray[np.int32]  # (n,) plate periods per cycle


def counted(
    flight_time: NDArray[np.float64], flights: NDArray[np.int32], shortest: float
) -> NDArray[np.bool_]:
    """(n, keep) which stored flights count: those longer than `shortest`, or all of a cell without any.

    flight_time: (n, keep) rad, NaN beyond flights; flights: (n,) of each cell in its window; shortest: rad.
    """
    stored = (np.arange(flight_time.shape[1]) < flights[:, None]) & np.isfinite(flight_time)
    longer: NDArray[np.bool_] = stored & (flight_time > shortest)
    return np.where(longer.any(axis=1, keepdims=True), longer, stored)


def recount(
    flight_time: NDArray[np.float64], takeoff_phase: NDArray[np.float64], flights: NDArray[np.int32],
    modes: Modes, micro_flight: float, shortest: float,
) -> Modes:  # fmt: skip
    """The modes of n cells if only flights longer than `shortest` (rad) count, from their stored flights.

    flight_time, takeoff_phase: (n, keep) in rad, flights: (n,), as in `params.Line`; modes: as classified
    with `micro_flight` (rad). A cycle must be seen three times in the stored flights. Cells keep outcome and
    mode where no other flights count than before, and aperiodic and settling ones their outcome where no mode
    is found: the kernel has followed them beyond the stored flights.

    Plate periods of take-offs are not stored: a contact between two flights is taken to be shorter than a
    plate period, except where the first classification tells how many periods a cycle has.
    """
    before = counted(flight_time, flights, micro_flight)
    now = counted(flight_time, flights, shortest)
    result = Modes(modes.outcome.copy(), modes.bounces.copy(), modes.periods.copy())
    _recount(flight_time, takeoff_phase, before, now, *modes, *result)
    return result


@allocating
def _recount(
    flight_time: Any, takeoff_phase: Any, before: Any, now: Any,
    outcome: Any, bounces: Any, periods: Any, new_outcome: Any, new_bounces: Any, new_periods: Any,
) -> None:  # fmt: skip
    for cell in range(len(outcome)):
        if outcome[cell] not in (PERIODIC, APERIODIC, SETTLING) or np.all(now[cell] == before[cell]):
            continue
        time, phase, period, place = _select(flight_time[cell], takeoff_phase[cell], now[cell])
        b, p = find_mode(time, phase, period)
        if b == 0:
            if outcome[cell] == PERIODIC:
                new_outcome[cell] = SETTLING if is_settling(time, phase) else APERIODIC
            new_bounces[cell], new_periods[cell] = 0, 0
            continue
        if outcome[cell] == PERIODIC:
            p = _periods(before[cell], place[-1 - b], place[-1], bounces[cell], periods[cell], p)
        new_outcome[cell], new_bounces[cell], new_periods[cell] = PERIODIC, b, p


@allocating
def _select(flight_time: Any, takeoff_phase: Any, counts: Any) -> tuple[Any, Any, Any, Any]:
    """Times, take-off phases and periods of a cell's flights that count, and their places among all."""
    keep = len(flight_time)
    time, phase = np.empty(keep), np.empty(keep)
    period, place = np.empty(keep, dtype=np.int64), np.empty(keep, dtype=np.int64)
    count, turns, landing = 0, 0, 0.0  # landing: rad since the plate period of the last take-off began
    for i in range(keep):
        if math.isnan(flight_time[i]):
            break
        start = takeoff_phase[i]
        if i:  # a contact of no length ends where the flight before it does, up to rounding
            turns += math.ceil((landing - start) / TWO_PI - 1e-9)
        landing = start + flight_time[i]
        if counts[i]:
            time[count], phase[count], period[count], place[count] = flight_time[i], start, turns, i
            count += 1
    return time[:count], phase[:count], period[:count], place[:count]


@jit
def _periods(before: Any, first: int, last: int, bounces: int, periods: int, otherwise: int) -> int:
    """Plate periods from the stored flight `first` to `last`, in cells with the mode (bounces, periods)."""
    n = 0  # flights of the mode in between
    for i in range(first + 1, last + 1):
        if before[i]:
            n += 1
    return periods * n // bounces if n and periods * n % bounces == 0 else otherwise
