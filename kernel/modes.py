"""The mode (bounces, plate periods) of the flights of a window, or whether they still settle.

The rules are those of docs/model.md, section 4; `benchmarks.settling` measures them.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.numerics.elementary import TWO_PI
from kernel.numerics.jit import allocating, inlined, jit
from kernel.params import Outcome

_, PERIODIC, APERIODIC, _, UNRESOLVED, _, SETTLING = map(int, Outcome)

REPEATS: Final = 1e-6  # rad within which flights agree: above the rest of settling, below all differences
FALLS: Final = 0.01  # part by which a difference must fall to a shorter cycle's; less is rounding
LAGS: Final = 24  # settling is judged by flights up to this many apart; 99 in 100 cycles have at most 24
FEWEST: Final = 12  # fewest flights to judge settling: three parts of three, for the largest lag

#: Flights settle where their difference falls below NEAR (rad) and to less than APPROACH of itself from the
#: first third of the flights to the last.
NEAR: Final = 0.1
APPROACH: Final = 0.7

#: They also settle, slowly, where it stays below CLOSE (rad) and rises or falls by more than DRIFT of itself:
#: so close to a cycle the motion is linear, and flights that leave one go to another. On a quasi-periodic
#: attractor the difference stays as it is.
CLOSE: Final = 0.01
DRIFT: Final = 0.05

# of mean squares
_FALLEN, _NEAR, _APPROACHED = (1.0 - FALLS) ** 2, NEAR**2, APPROACH**2
_CLOSE, _DRIFTED = CLOSE**2, (1.0 - DRIFT) ** 2


class Flights(NamedTuple):
    """The last flights of the cells in some lanes: ring buffers of `size` flights, one after another.

    Functions take where that of their lane begins, first = size * lane. Arrays (lanes * size,).
    """

    time: Any  # float64, rad
    phase: Any  # float64, rad modulo 2 pi, at take-off
    period: Any  # int64, plate periods since the cell began, at take-off
    size: int  # a power of two
    stored: int  # flights stored with the cell


@inlined
def slot(flights: Flights, first: int, n: int) -> int:
    """Index of the n-th flight of a lane whose ring buffer begins at `first`."""
    return first + (n & (flights.size - 1))


@jit
def move_flights(flights: Flights, first: int, other: int) -> None:
    """Move the ring buffer that begins at `first` to `other`."""
    for i in range(flights.size):
        flights.time[other + i], flights.phase[other + i] = flights.time[first + i], flights.phase[first + i]
        flights.period[other + i] = flights.period[first + i]


@jit
def find_cycle(flight_time: Any, takeoff_phase: Any, takeoff_period: Any) -> tuple[int, int]:
    """The shortest cycle that the last flights follow: (bounces, plate periods), or (0, 0).

    Arrays (n,) in order of time: flight times in rad, take-off phases in rad modulo 2 pi, and plate periods
    since the cell began at take-off. A cycle must hold over the last half of the flights, within REPEATS, and
    occur three times.
    """
    n = len(flight_time)
    for bounces in range(1, n // 3 + 1):
        first = n - max(n // 2, 2 * bounces)
        periods = takeoff_period[n - 1] - takeoff_period[n - 1 - bounces]
        # phases either side of the turn of a period are neighbours
        difference = takeoff_phase[n - 1] - takeoff_phase[n - 1 - bounces]
        periods += 1 if difference > math.pi else (-1 if difference < -math.pi else 0)
        if periods < 1:
            continue
        repeats = True
        for i in range(n - 1, first - 1, -1):
            j = i - bounces
            turns = takeoff_period[i] - takeoff_period[j] - periods
            shift = takeoff_phase[i] - takeoff_phase[j] + TWO_PI * turns
            if abs(flight_time[i] - flight_time[j]) > REPEATS or abs(shift) > REPEATS:
                repeats = False
                break
        if repeats:
            return bounces, periods
    return 0, 0


@jit
def find_mode(flight_time: Any, takeoff_phase: Any, takeoff_period: Any) -> tuple[int, int]:
    """The mode (bounces, plate periods) of the flights: the limit of the cycle of `find_cycle`."""
    bounces, periods = find_cycle(flight_time, takeoff_phase, takeoff_period)
    if bounces > 0:
        limit = limit_cycle(flight_time, takeoff_phase, bounces)
        if periods * limit % bounces == 0:
            return limit, periods * limit // bounces
    return bounces, periods


@jit
def limit_cycle(flight_time: Any, takeoff_phase: Any, bounces: int) -> int:
    """The number of flights in the cycle that the last flights converge to: `bounces` or a divisor of it.

    Arrays (n,) as in `find_cycle`, which has found that flights `bounces` apart repeat. A cycle of s flights
    with a multiplier near -1, or another root of unity, is approached from alternating sides, so that flights
    a multiple of s apart repeat before those s apart do. In the normal form of the bifurcation the
    root-mean-square difference a of flights s apart obeys a' = -r a + c a**3, so that 1/a**2 is the sum of a
    constant and an exponential in time: convex where a falls to zero, concave where it falls to the
    difference within a true cycle of `bounces` flights. It is taken over three parts of the last half.
    """
    n = len(flight_time)
    held = min(n, max(n // 2, 2 * bounces) + bounces)  # the last flights, over which the cycle holds
    for lag in range(1, bounces // 2 + 1):
        if bounces % lag != 0:
            continue
        # the differences within a cycle repeat after `bounces` of them; after half of it, lag = bounces / 2
        block = lag if 2 * lag == bounces else bounces
        part = (held - lag) // (3 * block) * block
        if part == 0:
            continue
        first, middle, last = _thirds(flight_time, takeoff_phase, lag, part)
        falls = middle < first and last < _FALLEN * first
        if falls and 1.0 / last - 1.0 / middle >= 1.0 / middle - 1.0 / first:
            return lag
    return bounces


@jit
def is_settling(flight_time: Any, takeoff_phase: Any) -> bool:
    """Whether flights without a cycle still drift towards something, or away from it.

    Arrays (n,) as in `find_cycle`. Compares the root-mean-square difference of flights `lag` apart in three
    equal parts of them, for the lag up to LAGS, and up to n/4, at which it is smallest in the last.
    """
    n = len(flight_time)
    if n < FEWEST:
        return False
    best, last = 0, math.inf
    for lag in range(1, min(LAGS, n // 4) + 1):
        part = (n - lag) // 3
        square = _mean_square(flight_time, takeoff_phase, lag, n - part, part)
        if square < last:
            best, last = lag, square
    if best == 0:
        return False
    first, middle, last = _thirds(flight_time, takeoff_phase, best, (n - best) // 3)
    if last < middle < first:
        approaches = last < _NEAR and last < _APPROACHED * first
        return approaches or (first < _CLOSE and last < _DRIFTED * first)
    return first < middle < last < _CLOSE and first < _DRIFTED * last


@jit
def _thirds(flight_time: Any, takeoff_phase: Any, lag: int, part: int) -> tuple[float, float, float]:
    """`_mean_square` of flights `lag` apart, in each of the last three parts of `part` flights."""
    n = len(flight_time)
    return (
        _mean_square(flight_time, takeoff_phase, lag, n - 3 * part, part),
        _mean_square(flight_time, takeoff_phase, lag, n - 2 * part, part),
        _mean_square(flight_time, takeoff_phase, lag, n - part, part),
    )


@jit
def _mean_square(flight_time: Any, takeoff_phase: Any, lag: int, first: int, part: int) -> float:
    """The mean square difference (rad**2) of flights `lag` apart, over `part` flights from `first` on."""
    total = 0.0
    for i in range(first, first + part):
        time = flight_time[i] - flight_time[i - lag]
        phase = takeoff_phase[i] - takeoff_phase[i - lag]
        # without a branch: on which side of the turn a chaotic flight lies cannot be predicted
        phase -= TWO_PI if phase > math.pi else (-TWO_PI if phase < -math.pi else 0.0)
        total += time * time + phase * phase
    return total / part


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
    with `micro_flight` (rad). A cycle must be seen three times in the stored flights, or be that of a
    periodic cell, once; a periodic cell is unresolved where they are less. Cells keep outcome and mode where
    no other flights count than before, in a whole cycle, and aperiodic and settling ones their outcome where
    no mode is found: the kernel has followed them beyond the stored flights.

    Plate periods of take-offs are not stored: a contact between two flights is taken to be shorter than a
    plate period, except where the first classification tells how many periods a cycle has.
    """
    before = counted(flight_time, flights, micro_flight)
    now = counted(flight_time, flights, shortest)
    result = Modes(modes.outcome.copy(), modes.bounces.copy(), modes.periods.copy())
    _recount(flight_time, takeoff_phase, before, now, *modes, *result)
    # where shorter flights count, also those ahead of a cycle's first
    ahead = (shortest < micro_flight) | ~np.any(flight_time > shortest, axis=1)
    less = (flights > flight_time.shape[1]) & (np.count_nonzero(before, axis=1) < modes.bounces + ahead)
    result.outcome[less], result.bounces[less], result.periods[less] = UNRESOLVED, 0, 0
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
        if outcome[cell] == PERIODIC:
            if b > 0:
                p = _periods(before[cell], place[-1 - b], place[-1], bounces[cell], periods[cell], p)
            else:
                b = _in_cycle(before[cell], now[cell], bounces[cell])
                p = periods[cell] if b > 0 else 0
            new_outcome[cell] = PERIODIC if b > 0 else UNRESOLVED
        elif b > 0:
            new_outcome[cell] = PERIODIC
        new_bounces[cell], new_periods[cell] = b, p


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
def _in_cycle(before: Any, now: Any, bounces: int) -> int:
    """The stored flights that count now in the last cycle of `bounces` that did; 0 if it is not whole."""
    last, seen, count = -1, 0, 0
    for i in range(len(before) - 1, -1, -1):
        if before[i] and last < 0:
            last = i
        elif before[i]:
            seen += 1
        if seen == bounces:
            break
        if last >= 0 and now[i]:
            count += 1
    return count if seen == bounces else 0


@jit
def _periods(before: Any, first: int, last: int, bounces: int, periods: int, otherwise: int) -> int:
    """Plate periods from the stored flight `first` to `last`, in cells with the mode (bounces, periods)."""
    n = 0  # flights of the mode in between
    for i in range(first + 1, last + 1):
        if before[i]:
            n += 1
    return periods * n // bounces if n and periods * n % bounces == 0 else otherwise
