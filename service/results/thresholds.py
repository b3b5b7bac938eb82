"""Thresholds finer than a sweep's grid, computed by the workers when they are asked for."""

from concurrent.futures import Future
from dataclasses import replace
from typing import Final

import numpy as np

from service.errors import TooLarge
from service.jobs.model import JobRecord
from service.jobs.on_demand import OnDemandCache
from service.results.diagram import Sweep
from service.results.mode_map import Thresholds
from worker.analysis.thresholds import USUAL_CELLS, Refined, refine
from worker.cost import cell_seconds
from worker.executors.base import Executor

#: Values of omega in one call: small enough to share out, large enough to be worth it.
BLOCK: Final = 16

#: Core-seconds one answer may take.
MOST_SECONDS: Final = 60.0


def refined(
    answers: OnDemandCache, job: JobRecord, sweep: Sweep, coarse: Thresholds, tolerance: float
) -> Thresholds:
    """The thresholds of a job to `tolerance` in gamma, from those on its grid.

    Raises TooLarge for more computing than one answer may take, and as `OnDemandCache.get`.
    """
    omegas = len(coarse.omega)
    if not job.chunks_done:
        nothing = np.full(omegas, np.nan)
        return replace(coarse, up=nothing, down=nothing)
    _check_cost(sweep, omegas)
    place = int(np.searchsorted(sweep.spec.axis_values("xi"), coarse.xi))

    def begin(executor: Executor) -> list[Future[Refined]]:
        blocks = [tuple(range(low, min(low + BLOCK, omegas))) for low in range(0, omegas, BLOCK)]
        return [executor.call(refine, sweep.spec, sweep.url, place, block, tolerance) for block in blocks]

    parts = answers.get((job.id, job.chunks_done, place, tolerance), begin)
    up, down = (np.concatenate([getattr(part, name) for part in parts]) for name in Refined._fields)
    return replace(coarse, up=up, down=down)


def _check_cost(sweep: Sweep, omegas: int) -> None:
    each = USUAL_CELLS * cell_seconds(sweep.spec) * len(sweep.spec.directions)
    if omegas * each > MOST_SECONDS:
        raise TooLarge(
            f"tolerance: refining {omegas:,} values of omega takes some {omegas * each:.3g} core-seconds, at "
            f"most {MOST_SECONDS:g} are spent on one answer; a sweep of {int(MOST_SECONDS / each):,} would do"
        )
