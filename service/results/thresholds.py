"""Thresholds of bouncing per Ω: by Eq. 25, to the sweep's grid, and refined beyond it by the workers."""

from concurrent.futures import Future
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, WithJsonSchema

from kernel.threshold import threshold
from service.errors import InvalidRequest, TooLarge
from service.jobs.model import JobRecord
from service.jobs.on_demand import Caller, OnDemandCache
from service.results.mode_map import plane
from service.results.selection import MAX_READ, Sweep, check_kernel, check_points, nearest_index
from worker.analysis import thresholds
from worker.analysis.thresholds import TYPICAL_CELLS, Refined, Status, endless_rest, refine
from worker.cost import cell_seconds

#: Values of omega that one worker call refines: small enough to share out, large enough to be worth a call.
BLOCK: Final = 16

#: Core-seconds that one answer may take.
MAX_SECONDS: Final = 60.0

_NUMBERS: Final = {"type": "array", "items": {"anyOf": [{"type": "number"}, {"type": "null"}]}}
#: (n,) numbers; NaN is null in JSON.
Numbers = Annotated[NDArray[np.float64], PlainSerializer(np.ndarray.tolist), WithJsonSchema(_NUMBERS)]


class Thresholds(BaseModel):
    """Per Ω of a sweep, at one ξ: where bouncing begins and ends; null unless the status is `found`.

    `below the grid`: the lowest Γ bounces already. `above the grid`: every cell is at rest. `never bounces`:
    of `up`, every cell is at rest and Eq. 25 is above every Γ that a specification may have; of `down`, no
    cell of the ramp bounces. `not ramped`: the sweep does not have this direction. `not refined`: the grid
    holds the change, and refinement reached its limit. `missing`, `unresolved`, `diverged`, `settling`: the
    outcome of the cell that decides, the lowest that is not at rest, which does not tell whether it bounces.
    """

    model_config = ConfigDict(arbitrary_types_allowed=True, frozen=True)

    xi: float
    omega: Annotated[Numbers, WithJsonSchema({"type": "array", "items": {"type": "number"}})]
    analytic: Numbers = Field(description="Eq. 25")
    up: Numbers = Field(description="lowest Γ that bounces, ascending or from rest")
    down: Numbers = Field(description="lowest Γ that bounces, descending")
    up_status: list[Status]
    down_status: list[Status]
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
    results: dict[str, Any] = {}
    for name in ("up", "down"):
        results[name] = np.full(len(omega), np.nan)
        results[f"{name}_status"] = [Status.NOT_RAMPED] * len(omega)
    complete = True
    for direction in spec.directions:
        name = "down" if direction == "down" else "up"
        results[name], results[f"{name}_status"], computed = _of_direction(sweep, value, direction)
        complete = complete and computed
    return Thresholds(xi=value, omega=omega, analytic=threshold(omega, value), complete=complete, **results)


def refined(
    on_demand: OnDemandCache, job: JobRecord, sweep: Sweep, coarse: Thresholds, tolerance: float
) -> Thresholds:
    """`coarse`, refined by the workers to `tolerance` in gamma from the states that the sweep stored.

    Raises OutdatedJob for a sweep of another kernel version, whose states this one does not continue,
    TooLarge for more computing than one answer may take, and as `OnDemandCache.get`.
    """
    check_kernel(sweep)
    omegas = len(coarse.omega)
    if not job.chunks_done:
        unknown = {"up": np.full(omegas, np.nan), "down": np.full(omegas, np.nan)}
        statuses = {
            name: [Status.MISSING if status is Status.FOUND else status for status in getattr(coarse, name)]
            for name in ("up_status", "down_status")
        }
        return coarse.model_copy(update={**unknown, **statuses, "tolerance": tolerance})
    _check_cost(sweep, omegas)
    xi = int(np.searchsorted(sweep.spec.axis_values("xi"), coarse.xi))

    def submit(workers: Caller) -> list[Future[Refined]]:
        blocks = [tuple(range(low, min(low + BLOCK, omegas))) for low in range(0, omegas, BLOCK)]
        return [workers.call(refine, sweep.spec, sweep.url, xi, block, tolerance) for block in blocks]

    parts = on_demand.get((job.id, job.chunks_done, xi, tolerance), submit)
    joined: dict[str, Any] = {
        name: [value for part in parts for value in getattr(part, name)] for name in Refined._fields
    }
    numbers = {name: np.array(joined[name]) for name in ("up", "down")}
    return coarse.model_copy(update={**joined, **numbers, "tolerance": tolerance})


def _of_direction(sweep: Sweep, xi: float, direction: str) -> tuple[NDArray[np.float64], list[Status], bool]:
    """(n_omega,) the lowest Γ that bounces, NaN unless found; the statuses; whether all is computed."""
    gamma = sweep.spec.axis_values("gamma")
    endless = endless_rest(sweep.spec, sweep.spec.axis_values("omega"), xi)
    rows = max(1, MAX_READ // len(gamma))
    lowest, statuses, complete = np.full(len(endless), np.nan), [], True
    for low in range(0, len(endless), rows):
        part = plane(sweep, xi, direction, ("outcome",), slice(low, low + rows))
        complete = complete and part.complete
        for i, row in enumerate(part.arrays["outcome"], low):
            found = thresholds.on_grid(row, direction == "down", bool(endless[i]))
            statuses.append(found.status)
            if found.status is Status.FOUND:
                lowest[i] = gamma[found.bouncing]
    return lowest, statuses, complete


def _check_cost(sweep: Sweep, omegas: int) -> None:
    seconds = TYPICAL_CELLS * cell_seconds(sweep.spec, alone=True) * len(sweep.spec.directions)  # per omega
    if omegas * seconds > MAX_SECONDS:
        raise TooLarge(
            f"tolerance: refining {omegas:,} values of omega takes about {omegas * seconds:.3g} "
            f"core-seconds, the limit for one answer is {MAX_SECONDS:g}: "
            f"enough for {int(MAX_SECONDS / seconds):,} values"
        )
