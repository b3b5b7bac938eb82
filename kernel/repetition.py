"""Cycles that the last flights of a run follow so closely that its other cycles are known (`settle_early`).

The rule is that of docs/model.md, section 4; `benchmarks.early` measures it.
"""

import math
from typing import Any, Final

import numpy as np

from kernel.numerics.elementary import TWO_PI
from kernel.numerics.jit import allocating, jit

#: Flights repeat when their times and take-off phases agree within this, rad. They may also drift by no more
#: than this until the run's end.
AGREE: Final = 1e-10

#: The last flights must follow a cycle so many times, which gives one difference fewer between its turns.
TURNS: Final = 5

#: Cycles of up to this many flights are looked for.
LONGEST: Final = 24

#: After every so many flights.
CHECK: Final = 8

#: Differences may grow by this, rad, from one turn to the next: it is rounding.
ROUNDING: Final = 1e-13


@jit
def find_repetition(
    time: Any, phase: Any, period: Any, first: int, size: int, recorded: int, left: int
) -> tuple[int, int]:
    """The shortest cycle that the last flights of a run repeat: (flights, plate periods), or (0, 0).

    The arrays and `first`, `size` are a ring buffer as in `cell.Flights`, of which `recorded` flights were
    written; `left`: plate periods of the run that are left.

    Over TURNS turns of the cycle, all flights agree within AGREE with those of the turn before. Let a_k be
    the largest difference of one turn from that before it. The flights of the turns that are left then differ
    from those of the last by at most a_k n, n being their number, or by the sum of a geometric series, if a
    has fallen throughout: its ratio is taken to be the largest of those measured. The cycle is accepted if
    that is at most AGREE, and if a does not grow beyond rounding.
    """
    kept = min(recorded, size)
    last = recorded - 1
    for flights in range(1, min(LONGEST, kept // TURNS) + 1):
        newest, before = first + last % size, first + (last - flights) % size
        if abs(time[newest] - time[before]) > AGREE:
            continue
        # phases either side of the turn of a period are neighbours
        periods = period[newest] - period[before] + round((phase[newest] - phase[before]) * (1.0 / TWO_PI))
        if periods < 1:
            continue
        if _drift(time, phase, period, first, size, last, flights, periods, left) <= AGREE:
            return flights, periods
    return 0, 0


@jit
def _drift(
    time: Any, phase: Any, period: Any, first: int, size: int, last: int, flights: int, periods: int,
    left: int,
) -> float:  # fmt: skip
    """A bound on how far the flights of the turns that are left are from those of the last, rad.

    Infinite if the flights do not repeat.
    """
    ratio, older = 0.0, -1.0
    for turn in range(TURNS - 2, -1, -1):
        change = 0.0  # the largest difference from the turn before
        for i in range(last - (turn + 1) * flights + 1, last - turn * flights + 1):
            j, k = first + i % size, first + (i - flights) % size
            shift = phase[j] - phase[k] + TWO_PI * (period[j] - period[k] - periods)
            change = max(change, abs(time[j] - time[k]), abs(shift))
            if change > AGREE:
                return math.inf
        if older >= 0.0:
            if change > older + ROUNDING:
                return math.inf
            ratio = max(ratio, change / older if older > 0.0 else math.ceil(change))
        older = change
    turns = float(left // periods + 1)
    return older * (min(turns, ratio / (1.0 - ratio)) if ratio < 1.0 else turns)


@allocating
def repeat_flights(
    time: Any, phase: Any, period: Any, first: int, size: int, recorded: int, flights: int, periods: int,
    turns: int, settle: int, begun: bool,
) -> int:  # fmt: skip
    """Record the last `flights` flights `turns` times more, each turn `periods` plate periods later.

    As the run would: those that take off before the plate period `settle` are left out and, unless the window
    has `begun` already, those recorded before it are forgotten. Returns how many are recorded then.
    """
    cycle = np.empty((flights, 2))
    takeoff = np.empty(flights, dtype=np.int64)
    early = 0  # flights that take off before the window
    for i in range(flights):
        slot = first + (recorded - flights + i) % size
        cycle[i, 0], cycle[i, 1], takeoff[i] = time[slot], phase[slot], period[slot]
        early += min(max(-((takeoff[i] - settle) // periods) - 1, 0), turns)
    base, total = recorded if begun else 0, turns * flights
    for n in range(max(early, total - size), total):
        slot, i = first + (base + n - early) % size, n % flights
        time[slot], phase[slot] = cycle[i, 0], cycle[i, 1]
        period[slot] = takeoff[i] + (n // flights + 1) * periods
    return base + total - early
