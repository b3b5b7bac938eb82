"""Deviation of two contact models in the same cells, in rad of flight time."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Line, Outcome, counted_flights

#: Two periodic cells are compared flight by flight over common cycles of up to this many plate periods.
LONGEST_CYCLE: Final = 128

#: Quantiles that compare the distributions of flights that do not repeat.
QUANTILES: Final = np.linspace(0.05, 0.95, 19)

#: A difference of distributions counts beyond this multiple of their scatter, by which two windows of one
#: chaotic cell differ. Of 1,128 such cells 94.2% agree with their own next window at a factor of 2, fewer
#: than a model must (`model_selection.MOST_BEYOND`). At 2.5 it is 97.5%, but one in ten differences between
#: `rigid` and `ball` is missed. This value misses 4 in 100.
SCATTERS: Final = 2.25
#: Parts of a window whose differences give its scatter.
PARTS: Final = 4
#: Fewest flights that give the scatter. Two windows of fewer differ even for one motion.
FEWEST: Final = 4 * PARTS

#: Outcomes whose flights are not compared. Cells still settling are compared like aperiodic ones.
FAILED: Final = (Outcome.UNRESOLVED, Outcome.DIVERGED)

_Array = NDArray[np.float64]


def deviations(exact: Line, other: Line, micro_flight: float, fewest: int = 0) -> _Array:
    """Deviation of the flights of `other` from those of `exact` in each cell (n,), rad.

    Flights of at most `micro_flight`, rad, are ignored unless a cell has no others.

    - `exact` unresolved or diverged: NaN; only `other`: infinite
    - both at rest: 0; one at rest: infinite
    - both periodic: the largest difference of the sorted flights over a common cycle, where a flight without
      a counterpart counts with its whole time; `nearest` where `other` keeps less than a cycle
    - others: the largest difference of quantiles, less the scatter of the shorter window; if that has fewer
      than FEWEST flights and neither cell is periodic, less the range of the longer, or 0 if both have fewer
    - others with a `fewest`: NaN where `other` has fewer than FEWEST flights and `exact` no cycle, or keeps
      only a part, fewer than `fewest`
    """
    cells = range(len(exact.outcome))
    return np.array([_deviation(exact, other, i, micro_flight, fewest) for i in cells])


def percentile(values: _Array, percent: float) -> float | None:
    """The percentile of values (n,), which is one of them; None without values, or if it is not finite."""
    if not len(values):
        return None
    value = float(np.percentile(values, percent, method="higher"))
    return value if math.isfinite(value) else None


def _deviation(exact: Line, other: Line, i: int, micro_flight: float, fewest: int) -> float:
    if exact.outcome[i] in FAILED:
        return math.nan
    if other.outcome[i] in FAILED:
        return math.inf
    resting = [line.outcome[i] == Outcome.AT_REST for line in (exact, other)]
    if any(resting):
        return 0.0 if all(resting) else math.inf
    exact_flights, other_flights = (counted_flights(line, i, micro_flight)[0] for line in (exact, other))
    common = math.lcm(int(exact.periods[i]), int(other.periods[i]))  # 0 if one of them has no cycle
    if not 0 < common <= LONGEST_CYCLE:
        told = 0 if exact.periods[i] else min(fewest, FEWEST)  # of a cycle the flights are known
        least = fewest if other.flights[i] > other.flight_time.shape[1] else told
        few = len(other_flights) < least
        has_cycle = bool(exact.periods[i] or other.periods[i])
        return math.nan if few else _between_distributions(exact_flights, other_flights, has_cycle)
    cycle, kept = exact_flights[-int(exact.bounces[i]) :], other_flights[-int(other.bounces[i]) :]
    if np.any(cycle > micro_flight):  # of a long chatter nothing else may be kept
        kept = kept[kept > micro_flight]
    if len(kept) < other.bounces[i]:
        return nearest(cycle, kept)
    tiles = (common // int(line.periods[i]) for line in (exact, other))
    return sorted_apart(*(np.tile(flights, n) for flights, n in zip((cycle, kept), tiles, strict=True)))


def nearest(cycle: _Array, kept: _Array) -> float:
    """The largest distance of k flights (k,) from the nearest of a cycle's (n,), rad; NaN without any."""
    if not len(cycle) or not len(kept):
        return math.nan
    return float(np.abs(kept[:, np.newaxis] - cycle).min(axis=1).max())


def sorted_apart(exact: _Array, other: _Array) -> float:
    """The largest difference of two sorted sets of flights, rad; the smaller set is filled with zeros."""
    longest = max(len(exact), len(other))
    exact, other = (np.sort(np.pad(flights, (0, longest - len(flights)))) for flights in (exact, other))
    return float(np.max(np.abs(exact - other), initial=0.0))


def _between_distributions(exact: _Array, other: _Array, has_cycle: bool) -> float:
    """has_cycle: whether one of them is periodic, and its few flights are all that it has."""
    few, more = sorted((exact, other), key=len)
    if not len(more) or (len(more) < FEWEST and not has_cycle):
        return 0.0
    if not len(few):
        return math.inf
    distance = float(np.max(np.abs(_quantiles(exact) - _quantiles(other))))
    if len(few) >= FEWEST:
        return max(0.0, distance - SCATTERS * _scatter(few))
    return distance if has_cycle else max(0.0, distance - float(np.ptp(more)))


def _scatter(flights: _Array) -> float:
    """Expected distance between the quantiles of two such windows, estimated from parts of this one."""
    parts = [_quantiles(part) for part in np.array_split(flights, PARTS)]
    distance = max(float(np.max(np.abs(a - b))) for i, a in enumerate(parts) for b in parts[:i])
    return distance / math.sqrt(PARTS)


def _quantiles(flights: _Array) -> _Array:
    return np.asarray(np.quantile(flights, QUANTILES))
