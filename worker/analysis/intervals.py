"""Exact bounds of a share from a simple random sample without replacement (Clopper and Pearson's, finite).

A bound holds whatever the share is. It uses no normal approximation, which fails if few members or none have
a property. For 0 of n the upper bound is the rule of three, 1 - 0.05**(1/n).
"""

import math
from bisect import bisect_left
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import Final

import numpy as np
from numpy.typing import NDArray

#: Probabilities that the lower bound lies above the truth, and that the upper bound lies below it. An
#: interval contains the truth with at least 94 %, "at most" holds with 95 %.
ABOVE, BELOW = 0.01, 0.05
#: A population that no sample distinguishes from an infinite one, such as the points of a plane.
ENDLESS = 10**9
#: A share that is a round number but for this part is not rounded.
_ROUND: Final = 1e-12


def bounds(
    low: int, high: int, sampled: int, population: int, *, below: float = BELOW
) -> tuple[float, float]:
    """Lower and upper bound of the share of a population with a property.

    They are 0 and 1 without a sample, and both 0 without a population.

    low, high: number of the `sampled` members with the property, undecided ones counted as without and with
    it. population: number of members. below: probability that the upper bound is too low.
    """
    if sampled == 0:
        return (0.0, 1.0) if population else (0.0, 0.0)
    fewest, most = low, population - (sampled - high)
    # the fewest members for which a sample has at least `low` with a probability above ABOVE
    lower = fewest + bisect_left(
        range(fewest, most), True, key=lambda n: 1.0 - _at_most(low - 1, sampled, n, population) > ABOVE
    )
    # the most members for which a sample has at most `high` with a probability above BELOW
    upper = fewest + bisect_left(
        range(fewest, most), True, key=lambda n: _at_most(high, sampled, n + 1, population) <= below
    )
    return lower / population, max(upper, high) / population


def covered(sampled: int, population: int, above: int = 0) -> float:
    """Lower bound, with 95 %, of the share of a population at or below a value of a sample.

    above: members of the sample with larger values; by default the value is the largest.
    """
    return 1.0 - bounds(0, above, sampled, population)[1]


def percent(bound: float, *, upper: bool) -> str:
    """A bound of a share in percent, rounded so that it remains one: to two digits, near 100 to three."""
    digits = Context(2 if bound < 0.99 else 3, ROUND_CEILING if upper else ROUND_FLOOR)
    exact = 100.0 * bound * (1.0 - _ROUND if upper else 1.0 + _ROUND)
    return f"{float(digits.create_decimal(exact)):g}"


def _at_most(number: int, sampled: int, having: int, population: int) -> float:
    """Probability that at most `number` of a sample have a property that `having` of the population have."""
    if number < 0:
        return 0.0
    if number >= min(sampled, having):
        return 1.0
    k = np.arange(number + 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        with_it = _log_choose(having, number)[k]
        without = _log_choose(population - having, sampled)[sampled - k]
    logs = with_it + without - _log_choose(population, sampled)[sampled]
    return math.fsum(np.exp(logs[np.isfinite(logs)]))


def _log_choose(n: int, most: int) -> NDArray[np.float64]:
    """Logarithms of the binomial coefficients (n, 0) to (n, most), (most + 1,); -inf beyond n."""
    i = np.arange(most, dtype=np.float64)
    factors = np.where(i < n, (n - i) / (i + 1.0), 0.0)
    return np.concatenate([[0.0], np.cumsum(np.log(factors))])
