"""From the flights of a window to the mode (bounces, plate periods), or to whether they still settle.

The rules are those of docs/model.md, section 4; `benchmarks.settling` measures them.
"""

import math
from typing import Any, Final

from kernel.numerics.elementary import TWO_PI
from kernel.numerics.jit import jit

#: Flights repeat when their times and take-off phases agree within this, rad: above what is left of the
#: settling in most cells, and far below the differences between the flights of a cycle.
REPEATS: Final = 1e-6

#: A cycle of s flights is taken for the limit of one of k s flights only if the difference of flights s apart
#: falls by more than this part of itself: less may be the rounding of a true cycle of k s flights.
FALLS: Final = 0.01

#: Flights up to this many apart are compared to tell whether they settle. All but some 1 in 100 of the
#: periodic cells have a cycle of at most 24 bounces.
LAGS: Final = 24

#: The fewest flights from which settling can be told: three parts of three flights, for the largest lag.
FEWEST: Final = 12

#: Flights settle where their difference falls below NEAR (rad) and to less than APPROACH of itself from the
#: first third of the flights to the last.
NEAR: Final = 0.1
APPROACH: Final = 0.7

#: They also settle, slowly, where it stays below CLOSE (rad) and rises or falls by more than DRIFT of itself:
#: so close to a cycle the motion is linear, and flights that leave one go to another. On a quasi-periodic
#: attractor the difference stays as it is.
CLOSE: Final = 0.01
DRIFT: Final = 0.05


@jit
def find_cycle(
    flight_time: Any, takeoff_phase: Any, takeoff_period: Any, tolerance: float = REPEATS
) -> tuple[int, int]:
    """The shortest cycle that the last flights follow: (bounces, plate periods), or (0, 0).

    Arrays (n,) in order of time: flight times in rad, take-off phases in rad modulo 2 pi, and plate periods
    since the cell began at take-off; tolerance in rad. A cycle must hold over the last half of the flights
    and occur three times.
    """
    n = len(flight_time)
    for bounces in range(1, n // 3 + 1):
        first = n - max(n // 2, 2 * bounces)
        periods = takeoff_period[n - 1] - takeoff_period[n - 1 - bounces]
        # phases either side of the turn of a period are neighbours
        difference = takeoff_phase[n - 1] - takeoff_phase[n - 1 - bounces]
        if difference > math.pi:
            periods += 1
        elif difference < -math.pi:
            periods -= 1
        if periods < 1:
            continue
        repeats = True
        for i in range(n - 1, first - 1, -1):
            j = i - bounces
            shift = (
                takeoff_phase[i]
                - takeoff_phase[j]
                + TWO_PI * (takeoff_period[i] - takeoff_period[j] - periods)
            )
            if abs(flight_time[i] - flight_time[j]) > tolerance or abs(shift) > tolerance:
                repeats = False
                break
        if repeats:
            return bounces, periods
    return 0, 0


@jit
def find_mode(flight_time: Any, takeoff_phase: Any, takeoff_period: Any) -> tuple[int, int]:
    """The mode (bounces, plate periods) of the flights of a window, or (0, 0): the limit of their cycle.

    Arrays (n,) as in `find_cycle`.
    """
    bounces, periods = find_cycle(flight_time, takeoff_phase, takeoff_period, REPEATS)
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
        falls = middle < first and last < (1.0 - FALLS) ** 2 * first
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
        approaches = last < NEAR**2 and last < APPROACH**2 * first
        return approaches or (first < CLOSE**2 and last < (1.0 - DRIFT) ** 2 * first)
    return first < middle < last < CLOSE**2 and first < (1.0 - DRIFT) ** 2 * last


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
    """The mean square difference (rad**2) of flights `lag` apart, over `part` flights from the `first` on.

    The difference of two flights is the vector of those of their times and of their take-off phases, the
    latter modulo 2 pi.
    """
    total = 0.0
    for i in range(first, first + part):
        time = flight_time[i] - flight_time[i - lag]
        phase = takeoff_phase[i] - takeoff_phase[i - lag]
        # without a branch: on which side of the turn a chaotic flight lies cannot be predicted
        phase -= TWO_PI if phase > math.pi else (-TWO_PI if phase < -math.pi else 0.0)
        total += time * time + phase * phase
    return total / part
