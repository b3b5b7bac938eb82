"""Thresholds of bouncing per Ω: by Eq. 25, to the sweep's grid, and refined beyond it by the workers."""

from concurrent.futures import Future
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, WithJsonSchema

from kernel.threshold import threshold
from service.errors import InvalidRequest, TooLarge
from service.jobs.model import JobRecord
from service.jobs.on_demand import OnDemandCache
from service.results.mode_map import Plane, plane
from service.results.selection import MAX_READ, Sweep, check_points, nearest_index
from worker.analysis.thresholds import BOUNCING, TYPICAL_CELLS, Refined, refine
from worker.cost import cell_seconds
from worker.executors.base import Executor

#: Values of omega that one worker call refines: small enough to share out, large enough to be worth a call.
BLOCK: Final = 16

#: Core-seconds that one answer may take.
MAX_SECONDS: Final = 60.0

_NUMBERS: Final = {"type": "array", "items": {"anyOf": [{"type": "number"}, {"type": "null"}]}}
#: (n,) numbers; NaN is null in JSON.
Numbers = Annotated[NDArray[np.float64], PlainSerializer(np.ndarray.tolist), WithJsonSchema(_NUMBERS)]


class Thresholds(BaseModel):
    """Per Ω of a sweep, at one ξ: where bouncing begins and ends; null where the sweep does not show it."""

    model_config = ConfigDict(arbitrary_types_allowed=True, frozen=True)

    xi: float
    omega: Annotated[Numbers, WithJsonSchema({"type": "array", "items": {"type": "number"}})]
    analytic: Numbers = Field(description="Eq. 25")
    up: Numbers = Field(description="lowest Γ that bounces, ascending or from rest")
    down: Numbers = Field(description="lowest Γ that bounces, descending")
    tolerance: float | None = Field(None, description="of up and down, in Γ; null: the spacing of the grid")
    complete: bool


def on_grid(sweep: Sweep, xi: float | None, max_points: int) -> Thresholds:
    """The thresholds to the grid in gamma, at the grid's xi nearest to `xi`.

    Raises InvalidRequest for a sweep ramped along another axis than gamma and as `selection.nearest_index`,
    TooLarge for more than `max_points` values of omega.
    """
    spec = sweep.spec
    if spec.ramp_axis not in (None, "gamma"):
        rule = f"is {spec.ramp_axis}; thresholds in gamma need a sweep from rest or ramped along gamma"
        raise InvalidRequest.of("protocol.axis", rule)
    omega = spec.axis_values("omega")
    check_points(len(omega), max_points, f"{len(omega):,} values of omega", None)
    value = nearest_index(spec, "xi", xi).value
    unknown = np.full(len(omega), np.nan)
    lowest, complete = {"up": unknown, "down": unknown}, True
    for direction in spec.directions:
        name = "down" if direction == "down" else "up"
        lowest[name], computed = _lowest_bouncing(sweep, xi, direction)
        complete = complete and computed
    return Thresholds(xi=value, omega=omega, analytic=threshold(omega, value), complete=complete, **lowest)


def refined(
    on_demand: OnDemandCache, job: JobRecord, sweep: Sweep, coarse: Thresholds, tolerance: float
) -> Thresholds:
    """`coarse`, refined by the workers to `tolerance` in gamma from the states that the sweep stored.

    Raises TooLarge for more computing than one answer may take, and as `OnDemandCache.get`.
    """
    omegas = len(coarse.omega)
    if not job.chunks_done:
        unknown = np.full(omegas, np.nan)
        return coarse.model_copy(update={"up": unknown, "down": unknown, "tolerance": tolerance})
    _check_cost(sweep, omegas)
    xi = int(np.searchsorted(sweep.spec.axis_values("xi"), coarse.xi))

    def submit(executor: Executor) -> list[Future[Refined]]:
        blocks = [tuple(range(low, min(low + BLOCK, omegas))) for low in range(0, omegas, BLOCK)]
        return [executor.call(refine, sweep.spec, sweep.url, xi, block, tolerance) for block in blocks]

    parts = on_demand.get((job.id, job.chunks_done, xi, tolerance), submit)
    lowest: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in Refined._fields
    }
    return coarse.model_copy(update={**lowest, "tolerance": tolerance})


def _lowest_bouncing(sweep: Sweep, xi: float | None, direction: str) -> tuple[NDArray[np.float64], bool]:
    """(n_omega,) the lowest Γ that bounces, NaN where none does; and whether every cell is computed."""
    omegas, gammas = (len(sweep.spec.axis_values(axis)) for axis in ("omega", "gamma"))
    rows = max(1, MAX_READ // gammas)
    parts = [
        plane(sweep, xi, direction, ("outcome",), slice(low, low + rows)) for low in range(0, omegas, rows)
    ]
    return np.concatenate([_lowest(part) for part in parts]), all(part.complete for part in parts)


def _lowest(part: Plane) -> NDArray[np.float64]:
    bounces = np.isin(part.arrays["outcome"], BOUNCING)
    lowest = part.gamma[np.argmax(bounces, axis=1)]
    return np.where(bounces.any(axis=1), lowest, np.nan)


def _check_cost(sweep: Sweep, omegas: int) -> None:
    seconds = TYPICAL_CELLS * cell_seconds(sweep.spec) * len(sweep.spec.directions)  # per omega
    if omegas * seconds > MAX_SECONDS:
        raise TooLarge(
            f"tolerance: refining {omegas:,} values of omega takes about {omegas * seconds:.3g} "
            f"core-seconds, the limit for one answer is {MAX_SECONDS:g}: "
            f"enough for {int(MAX_SECONDS / seconds):,} values"
        )
