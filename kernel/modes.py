"""From flights to the mode (bounces, plate periods), in the paper's notation."""

import math
from typing import Any, Final

from kernel.numerics.elementary import TWO_PI
from kernel.numerics.jit import jit

#: Flights repeat when their times and take-off phases agree within this, rad: above what is left of the
#: settling in most cells, and far below the differences between the flights of a cycle.
REPEATS: Final = 1e-6


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
