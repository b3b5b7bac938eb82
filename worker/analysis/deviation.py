"""Room: how far two models are apart in the same cells, in rad of flight time. Pure."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Line, Outcome

#: Two cycles are laid beside each other over their least common multiple of plate periods up to this.
LONGEST_CYCLE: Final = 128

#: Where flights do not repeat, what their distribution is told by.
QUANTILES: Final = np.linspace(0.05, 0.95, 19)

#: A distribution drawn again differs by about its own scatter: so many times that is no deviation. With
#: this many, 93 to 96 of 100 chaotic cells are within their tolerance of their own next window.
SCATTERS: Final = 2.0
PARTS: Final = 4

_Array = NDArray[np.float64]


def deviations(exact: Line, other: Line, micro_flight: float) -> _Array:
    """(n,) for each cell, how far `other` is from `exact`; NaN where `exact` has no answer.

    Zero where both rest and infinite where only one does. Both periodic: the largest difference
    between the sorted flights of as many plate periods, a flight that only one has counting
    whole. Else: the largest difference between quantiles of the flights, beyond their scatter.
    """
    return np.array([_deviation(exact, other, i, micro_flight) for i in range(len(exact.outcome))])


def percentile(values: _Array, percent: float) -> float | None:
    """The value that so many percent do not exceed; None where that is not finite, or of nothing."""
    if not len(values):
        return None
    value = float(np.percentile(values, percent, method="higher"))
    return value if math.isfinite(value) else None


def _deviation(exact: Line, other: Line, i: int, micro_flight: float) -> float:
    if exact.outcome[i] >= Outcome.UNRESOLVED:
        return math.nan
    if other.outcome[i] >= Outcome.UNRESOLVED:
        return math.inf
    resting = [line.outcome[i] == Outcome.AT_REST for line in (exact, other)]
    if any(resting):
        return 0.0 if all(resting) else math.inf
    one, two = (_counted(line, i, micro_flight) for line in (exact, other))
    periods = [int(line.periods[i]) for line in (exact, other)]
    both = math.lcm(*periods)  # 0 if one of them has no cycle
    if 0 < both <= LONGEST_CYCLE:
        turns = [both // one for one in periods]
        return _between_cycles(
            np.tile(one[-int(exact.bounces[i]) :], turns[0]), np.tile(two[-int(other.bounces[i]) :], turns[1])
        )
    return _between_distributions(one, two)


def _counted(line: Line, i: int, micro_flight: float) -> _Array:
    """The flights kept of a cell that count."""
    flights = line.flight_time[i, : min(int(line.flights[i]), line.flight_time.shape[1])]
    return flights[flights > micro_flight]


def _between_cycles(one: _Array, two: _Array) -> float:
    longest = max(len(one), len(two))
    one, two = (np.sort(np.pad(flights, (0, longest - len(flights)))) for flights in (one, two))
    return float(np.max(np.abs(one - two)))


def _between_distributions(one: _Array, two: _Array) -> float:
    if not len(one) or not len(two):
        return 0.0 if len(one) == len(two) else math.inf
    distance = float(np.max(np.abs(_quantiles(one) - _quantiles(two))))
    return max(0.0, distance - SCATTERS * _scatter(one))


def _scatter(flights: _Array) -> float:
    """How far two windows as long as this one would be apart, from how far its parts are."""
    if len(flights) < 4 * PARTS:
        return 0.0
    parts = [_quantiles(part) for part in np.array_split(flights, PARTS)]
    apart = max(float(np.max(np.abs(a - b))) for i, a in enumerate(parts) for b in parts[:i])
    return apart / math.sqrt(PARTS)


def _quantiles(flights: _Array) -> _Array:
    return np.asarray(np.quantile(flights, QUANTILES))
