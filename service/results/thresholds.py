"""Thresholds of bouncing per Ω: by Eq. 25, to the sweep's grid, and refined beyond it by the workers."""

from collections.abc import Sequence
from concurrent.futures import Future
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, WithJsonSchema

from kernel.branches.descent import lifetime
from kernel.branches.thresholds import Thresholds as Prediction
from kernel.threshold import threshold
from service.errors import InvalidRequest, TooLarge
from service.formats import Predict
from service.jobs.model import JobRecord
from service.jobs.on_demand import Caller, OnDemandCache
from service.results.mode_map import plane
from service.results.orbits import thresholds as predicted_thresholds
from service.results.selection import MAX_READ, ROUNDING, Sweep, check_kernel, check_points, nearest_index
from worker.analysis import thresholds
from worker.analysis.prediction import predict_each, predict_from_cells
from worker.analysis.thresholds import TYPICAL_CELLS, Refined, Status, endless_rest, refine
from worker.cost import cell_seconds
from worker.schema import COMPUTED
from worker.spec import SweepSpec
from worker.spec.contact_models import Rigid

#: Values of omega that one worker call refines: small enough to share out, large enough to be worth a call.
BLOCK: Final = 16

#: Values of omega predicted while the caller waits, some 20 ms each.
MAX_PREDICTED: Final = 200

#: Core-seconds that a prediction takes, typically, of one omega; with words of three cells.
PREDICTION_SECONDS: Final = {"all": 0.02, "words": 0.5}

#: Predictions that one worker call computes.
PREDICTED_AT_ONCE: Final = {"all": 50, "words": 2}

#: Core-seconds that one answer may take.
MAX_SECONDS: Final = 60.0
MAX_PREDICTION_SECONDS: Final = 200.0

_NUMBERS: Final = {"type": "array", "items": {"anyOf": [{"type": "number"}, {"type": "null"}]}}
#: (n,) numbers; NaN is null in JSON.
Numbers = Annotated[NDArray[np.float64], PlainSerializer(np.ndarray.tolist), WithJsonSchema(_NUMBERS)]


class Thresholds(BaseModel):
    """Per Ω of a sweep, at one ξ: where bouncing begins and ends; null unless the status is `found`.

    Beside it, where it would begin by the closed form of the rigid contact without restitution, and the
    lowest Γ at which anything bounces for ever on it. A descent ends there or earlier, on another cycle.

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
    predicted_jump: Numbers = Field(description="the fold at which flights leap on the way up")
    predicted_down: Numbers = Field(
        description="the lowest Γ at which anything bounces for ever; null unless the rule decides"
    )
    cause: list[str] = Field(
        description="of predicted_down: Eq. 25, fold (1,k), fold of word zs (2,2) and the like; unresolved, "
        "not searched, not predicted"
    )
    difference: list[str] = Field(description="why `down` and predicted_down differ; empty where they do not")
    prediction: str = Field(description="the contact that is predicted, and whether it is the sweep's")
    up_computed: list[bool] | None = Field(
        None,
        description="of an adaptive map: whether the two cells that `up` lies between were computed, not "
        "taken from their block; null of other sweeps",
    )
    tolerance: float | None = Field(None, description="of up and down, in Γ; null: the spacing of the grid")
    complete: bool


def on_grid(sweep: Sweep, xi: float | None, max_points: int, predict: Predict = "some") -> Thresholds:
    """The thresholds to the grid in gamma, at the grid's xi nearest to `xi`.

    Only with `predict` "some" are they predicted, up to MAX_PREDICTED of them; see `predicted` for all.

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
        found = _of_direction(sweep, value, direction)
        results[name], results[f"{name}_status"] = found.lowest, found.statuses
        complete = complete and found.complete
        if spec.refine is not None:
            results["up_computed"] = found.computed
    coarse = Thresholds(
        xi=value, omega=omega, analytic=threshold(omega, value), complete=complete,
        **results, **_predicted(spec, omega, value, predict),
    )  # fmt: skip
    return _compared(spec, coarse)


def predicted(
    on_demand: OnDemandCache, job: JobRecord, sweep: Sweep, found: Thresholds, predict: Predict
) -> Thresholds:
    """`found` with the predictions of every omega, computed by the workers: "all" or "words".

    Raises InvalidRequest for words of another contact than the one of the closed form, TooLarge for more
    computing than one answer may take, and as `OnDemandCache.get`.
    """
    spec, omegas = sweep.spec, len(found.omega)
    if predict == "words" and not _is_ideal(spec):
        rule = f"words are of rigid cells with restitution 0; the sweep's contact is {spec.model.kind}"
        raise InvalidRequest.of("predict", rule)
    if predict == "words" and not job.chunks_done:
        predict = "all"
    seconds = PREDICTION_SECONDS[predict]
    if omegas * seconds > MAX_PREDICTION_SECONDS:
        raise TooLarge(
            f"predict: {omegas:,} values of omega take about {omegas * seconds:,.0f} core-seconds, the limit "
            f"for one answer is {MAX_PREDICTION_SECONDS:g}: enough for "
            f"{int(MAX_PREDICTION_SECONDS / seconds):,} values"
        )
    xi = int(np.searchsorted(spec.axis_values("xi"), found.xi))
    size = PREDICTED_AT_ONCE[predict]
    blocks = [tuple(range(low, min(low + size, omegas))) for low in range(0, omegas, size)]

    def submit(workers: Caller) -> list[Future[list[Prediction]]]:
        if predict == "words":
            return [
                workers.call(predict_from_cells, spec, sweep.url, xi, block, sweep.complete)
                for block in blocks
            ]
        values = [tuple(float(found.omega[i]) for i in block) for block in blocks]
        return [workers.call(predict_each, part, found.xi) for part in values]

    key = ("predict", predict, job.id, job.chunks_done if predict == "words" else 0, xi)
    each = [prediction for part in on_demand.get(key, submit) for prediction in part]
    fields: dict[str, Any] = _fields_of(each)
    if predict == "words":
        fields["prediction"] = f"{found.prediction}; words continued from its cells: others may reach lower"
    return _compared(spec, found.model_copy(update=fields))


def refined(
    on_demand: OnDemandCache, job: JobRecord, sweep: Sweep, coarse: Thresholds, tolerance: float
) -> Thresholds:
    """`coarse`, refined by the workers to `tolerance` in gamma from the states that the sweep stored.

    Raises OutdatedJob for a sweep of another kernel version, whose states this one does not continue,
    TooLarge for more computing than one answer may take, and as `OnDemandCache.get`.
    """
    check_kernel(sweep.kernel_version)
    omegas = len(coarse.omega)
    if not job.chunks_done:
        unknown = {"up": np.full(omegas, np.nan), "down": np.full(omegas, np.nan)}
        statuses = {
            name: [Status.MISSING if status is Status.FOUND else status for status in getattr(coarse, name)]
            for name in ("up_status", "down_status")
        }
        updated = coarse.model_copy(update={**unknown, **statuses, "tolerance": tolerance})
        return _compared(sweep.spec, updated)
    _check_cost(sweep, omegas)
    xi = int(np.searchsorted(sweep.spec.axis_values("xi"), coarse.xi))

    def submit(workers: Caller) -> list[Future[Refined]]:
        blocks = [tuple(range(low, min(low + BLOCK, omegas))) for low in range(0, omegas, BLOCK)]
        return [workers.call(refine, sweep.spec, sweep.url, xi, block, tolerance) for block in blocks]

    parts = on_demand.get((job.id, job.chunks_done, xi, tolerance), submit)
    joined: dict[str, Any] = {
        name: [value for part in parts for value in getattr(part, name)] for name in Refined._fields
    }
    changed: dict[str, Any] = (
        joined | {name: np.array(joined[name]) for name in ("up", "down")} | {"tolerance": tolerance}
    )
    if coarse.up_computed is not None:  # refinement computes the cells that decide
        changed["up_computed"] = [status is Status.FOUND for status in joined["up_status"]]
    return _compared(sweep.spec, coarse.model_copy(update=changed))


class _OfDirection(NamedTuple):
    """The thresholds to the grid in one direction, one per Ω."""

    lowest: NDArray[np.float64]  # Γ that bounces, NaN unless found
    statuses: list[Status]
    complete: bool  # whether every cell is done
    computed: list[bool]  # whether both cells beside the threshold were computed, where it was found


def _of_direction(sweep: Sweep, xi: float, direction: str) -> _OfDirection:
    gamma = sweep.spec.axis_values("gamma")
    endless = endless_rest(sweep.spec, sweep.spec.axis_values("omega"), xi)
    rows = max(1, MAX_READ // len(gamma))
    names = ("outcome",) if sweep.spec.refine is None else ("outcome", COMPUTED.name)
    lowest, statuses, complete = np.full(len(endless), np.nan), [], True
    both_computed = []
    for low in range(0, len(endless), rows):
        part = plane(sweep, xi, direction, names, slice(low, low + rows))
        complete = complete and part.complete
        was_computed = part.arrays.get(COMPUTED.name, np.ones_like(part.arrays["outcome"]))
        for i, row in enumerate(part.arrays["outcome"], low):
            found = thresholds.on_grid(row, direction == "down", bool(endless[i]))
            statuses.append(found.status)
            both_computed.append(False)
            if found.status is Status.FOUND and found.bouncing is not None:
                lowest[i] = gamma[found.bouncing]
                both_computed[-1] = bool(
                    np.all(was_computed[i - low, found.bouncing - 1 : found.bouncing + 1])
                )
    return _OfDirection(lowest, statuses, complete, both_computed)


def _is_ideal(spec: SweepSpec) -> bool:
    """Whether a sweep's contact is that of the closed form."""
    return isinstance(spec.model, Rigid) and spec.model.restitution == 0.0


def _predicted(spec: SweepSpec, omega: NDArray[np.float64], xi: float, predict: Predict) -> dict[str, Any]:
    """The fields that the closed form fills in."""
    prediction = "rigid, restitution 0: the contact of the sweep"
    if not _is_ideal(spec):
        prediction = f"rigid, restitution 0: not the contact of the sweep, which is {spec.model.kind}"
    if predict == "some" and len(omega) <= MAX_PREDICTED:
        fields = _fields_of([predicted_thresholds(float(value), xi) for value in omega])
    else:
        why = "not predicted"
        if predict == "some":
            why = f"not predicted: ask for all above {MAX_PREDICTED} values of omega"
        none = np.full(len(omega), np.nan)
        fields = {"predicted_jump": none, "predicted_down": none, "cause": [why] * len(omega)}
    return {**fields, "difference": [""] * len(omega), "prediction": prediction}


def _fields_of(found: Sequence[Prediction]) -> dict[str, Any]:
    """The fields of predictions, one per omega."""
    return {
        "predicted_jump": np.array([each.jump for each in found]),
        "predicted_down": np.array([each.down for each in found]),
        "cause": [each.cause for each in found],
    }


def _compared(spec: SweepSpec, found: Thresholds) -> Thresholds:
    """With the reasons why what the sweep found differs from what is predicted."""
    texts = [_difference(spec, found, i) for i in range(len(found.omega))]
    return found.model_copy(update={"difference": texts})


def _difference(spec: SweepSpec, found: Thresholds, i: int) -> str:
    """Why `down` and predicted_down differ at one omega; empty where they agree or one is missing."""
    down, predicted = float(found.down[i]), float(found.predicted_down[i])
    if not np.isfinite(down - predicted):
        return ""
    spacing = found.tolerance
    if spacing is None:
        gamma = spec.axis_values("gamma")
        at = int(np.searchsorted(gamma, down))
        spacing = float(gamma[at] - gamma[at - 1]) if at else 0.0
    above = down - predicted
    slack = ROUNDING * predicted
    if -slack <= above <= spacing + slack:
        return ""
    if above < 0.0:
        return _below(float(found.omega[i]), found.xi, -above, spec.settle + spec.observe)
    if found.cause[i].startswith("fold"):
        return (
            f"the ramp lost the cycle {above:.3g} above the fold: its steps of {spacing:.3g} excite the "
            "spring; take smaller ones, or start on the cycle"
        )
    return f"the sweep stops bouncing {above:.3g} above Eq. 25: it still settles, or its window is short"


def _below(omega: float, xi: float, delta: float, window: int) -> str:
    """Why a sweep bounces below the prediction by delta."""
    fold = predicted_thresholds(omega, xi).fold
    if fold is not None and (periods := lifetime(fold, delta)) > window:
        return (
            f"bouncing lives about {periods:,.0f} plate periods {delta:.3g} below the fold, longer than the "
            f"window of {window:,}"
        )
    return f"another cycle than those of one bounce lives {delta:.3g} below the prediction"


def _check_cost(sweep: Sweep, omegas: int) -> None:
    seconds = TYPICAL_CELLS * cell_seconds(sweep.spec, alone=True) * len(sweep.spec.directions)  # per omega
    if omegas * seconds > MAX_SECONDS:
        raise TooLarge(
            f"tolerance: refining {omegas:,} values of omega takes about {omegas * seconds:.3g} "
            f"core-seconds, the limit for one answer is {MAX_SECONDS:g}: "
            f"enough for {int(MAX_SECONDS / seconds):,} values"
        )
