"""Thresholds of the rigid plate without restitution in closed form.

What takes AT_ONCE_SECONDS at most is computed while the caller waits, the rest by the workers.
"""

from functools import lru_cache
from typing import Final

from kernel.branches.thresholds import Thresholds
from service.background import Background
from service.jobs.on_demand import OnDemandCache
from worker.analysis.prediction import predict, prediction_seconds

#: Answers kept: the least recently used one makes room.
THRESHOLDS_KEPT: Final = 4096

#: Core-seconds that are computed while the caller waits.
AT_ONCE_SECONDS: Final = 1.0


@lru_cache(THRESHOLDS_KEPT)
def thresholds(omega: float, xi: float) -> Thresholds:
    """The thresholds of one spring; `unresolved` or `not searched` where the rule does not decide."""
    return predict(omega, xi)


def thresholds_of_each(omega: tuple[float, ...], xi: float) -> list[Thresholds]:
    """Those of several springs."""
    return [thresholds(value, xi) for value in omega]


def thresholds_of(on_demand: OnDemandCache, background: Background, omega: float, xi: float) -> Thresholds:
    """`thresholds`, computed by a worker if that takes long. Raises as `OnDemandCache.get`."""
    if prediction_seconds(omega, xi) <= AT_ONCE_SECONDS:
        return background.run(thresholds, omega, xi)
    found: list[Thresholds] = on_demand.get(
        ("threshold", omega, xi), lambda workers: [workers.call(predict, omega, xi)]
    )
    return found[0]
