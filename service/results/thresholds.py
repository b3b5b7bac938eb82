"""Thresholds of bouncing per Ω: by Eq. 25, to the sweep's grid, and refined beyond it by the workers."""

from collections.abc import Sequence
from concurrent.futures import Future
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, WithJsonSchema

from kernel.branches.descent import Fold, lifetime
from kernel.branches.thresholds import Thresholds as Prediction
from kernel.threshold import threshold
from service.background import Background
from service.errors import InvalidRequest
from service.formats import Predict
from service.jobs.model import JobRecord
from service.jobs.on_demand import Caller, OnDemandCache
from service.results.mode_map import plane
from service.results.orbits import AT_ONCE_SECONDS, thresholds_of_each
from service.results.selection import MAX_READ, ROUNDING, Sweep, check_kernel, check_points, nearest_index
from worker.analysis import thresholds
from worker.analysis.prediction import predict_each, predict_from_cells, prediction_seconds
from worker.analysis.thresholds import TYPICAL_CELLS, Refined, Status, endless_rest, refine
from worker.cost import cell_seconds
from worker.schema import COMPUTED
from worker.spec import SweepSpec
from worker.spec.contact_models import Rigid

#: Values of omega that one worker call refines: small enough to share out, large enough to be worth a call.
BLOCK: Final = 16

#: Values of omega predicted unless all are asked for.
MAX_PREDICTED: Final = 200

#: Core-seconds that following the words of one omega takes, typically, of three cells.
WORDS_SECONDS: Final = 0.48

#: Values of omega, and core-seconds, of predictions that are computed with a small read.
MAX_BRIEF: Final = 4
BRIEF_SECONDS: Final = 0.2

#: Core-seconds of the predictions that one worker call computes.
CALL_SECONDS: Final = 1.0

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


def on_grid(sweep: Sweep, xi: float | None, max_points: int) -> Thresholds:
    """The thresholds to the grid in gamma, at the grid's xi nearest to `xi`, without predictions.

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
    return Thresholds(
        xi=value, omega=omega, analytic=threshold(omega, value), complete=complete,
        **results, **_not_predicted(spec, len(omega), "not predicted"),
    )  # fmt: skip


def predicted(
    on_demand: OnDemandCache,
    background: Background,
    job: JobRecord,
    sweep: Sweep,
    found: Thresholds,
    predict: Predict,
) -> Thresholds:
    """`found` with the predictions that are asked for, and the reasons why they differ from the sweep.

    What takes longer than AT_ONCE_SECONDS is computed by the workers. With "some", more predictions than
    MAX_PREDICTED, or than one answer may take, are left out, and `cause` says so.

    Raises InvalidRequest for words of another contact than the one of the closed form and for more computing
    than one answer may take, and as `OnDemandCache.get`.
    """
    spec = sweep.spec
    if predict == "words" and not _is_ideal(spec):
        rule = f"words are of rigid cells with restitution 0; the sweep's contact is {spec.model.kind}"
        raise InvalidRequest.of("predict", rule)
    if predict == "none":
        return found
    if predict == "words" and not job.chunks_done:
        predict = "all"
    if predict == "some" and len(found.omega) > MAX_PREDICTED:
        return _left_out(spec, found, f"ask for all above {MAX_PREDICTED} values of omega")
    words = WORDS_SECONDS if predict == "words" else 0.0
    seconds = [words + prediction_seconds(omega, found.xi) for omega in found.omega.tolist()]
    if (total := sum(seconds)) > MAX_PREDICTION_SECONDS:
        fitting = int(np.searchsorted(np.cumsum(seconds), MAX_PREDICTION_SECONDS, "right"))
        rule = (
            f"{len(seconds):,} values of omega take about {total:,.0f} core-seconds, the limit for one "
            f"answer is {MAX_PREDICTION_SECONDS:g}: enough for {fitting:,} values"
        )
        if predict == "some":
            return _left_out(spec, found, rule)
        raise InvalidRequest.of("predict", f"{rule}; none leaves predictions out")
    if predict == "some" and total <= AT_ONCE_SECONDS:
        each = background.run(thresholds_of_each, tuple(found.omega.tolist()), found.xi)
    else:
        each = _by_workers(on_demand, job, sweep, found, predict, seconds)
    return _compared(spec, found, each, words=predict == "words")


def is_brief(sweep: Sweep, xi: float | None, predict: Predict) -> bool:
    """Whether the predictions take some hundredths of a second at most. Raises InvalidRequest."""
    omega = sweep.spec.axis_values("omega")
    if predict in ("all", "words") or MAX_BRIEF < len(omega) <= MAX_PREDICTED:
        return False
    value = nearest_index(sweep.spec, "xi", xi).value
    few = predict == "some" and len(omega) <= MAX_BRIEF
    return not few or sum(prediction_seconds(each, value) for each in omega.tolist()) <= BRIEF_SECONDS


def _by_workers(
    on_demand: OnDemandCache, job: JobRecord, sweep: Sweep, found: Thresholds, predict: Predict,
    seconds: Sequence[float],
) -> list[Prediction]:  # fmt: skip
    """The prediction of every omega. Raises as `OnDemandCache.get`."""
    spec, words = sweep.spec, predict == "words"
    xi = int(np.searchsorted(spec.axis_values("xi"), found.xi))
    call = (np.cumsum(seconds) // CALL_SECONDS).astype(int)
    blocks = [tuple(np.flatnonzero(call == number).tolist()) for number in np.unique(call)]

    def submit(workers: Caller) -> list[Future[list[Prediction]]]:
        if words:
            return [
                workers.call(predict_from_cells, spec, sweep.url, xi, block, sweep.complete)
                for block in blocks
            ]
        values = [tuple(float(found.omega[i]) for i in block) for block in blocks]
        return [workers.call(predict_each, part, found.xi) for part in values]

    key = ("predict", words, job.id, job.chunks_done if words else 0, xi)
    return [prediction for part in on_demand.get(key, submit) for prediction in part]


def refined(
    on_demand: OnDemandCache, job: JobRecord, sweep: Sweep, coarse: Thresholds, tolerance: float
) -> Thresholds:
    """`coarse`, refined by the workers to `tolerance` in gamma from the states that the sweep stored.

    Raises OutdatedJob for a sweep of another kernel version, whose states this one does not continue,
    InvalidRequest for more computing than one answer may take, and as `OnDemandCache.get`.
    """
    check_kernel(sweep.kernel_version)
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
    changed: dict[str, Any] = (
        joined | {name: np.array(joined[name]) for name in ("up", "down")} | {"tolerance": tolerance}
    )
    if coarse.up_computed is not None:  # refinement computes the cells that decide
        changed["up_computed"] = [status is Status.FOUND for status in joined["up_status"]]
    return coarse.model_copy(update=changed)


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


def _not_predicted(spec: SweepSpec, omegas: int, why: str) -> dict[str, Any]:
    """The fields that the closed form fills in, without its numbers."""
    prediction = "rigid, restitution 0: the contact of the sweep"
    if not _is_ideal(spec):
        prediction = f"rigid, restitution 0: not the contact of the sweep, which is {spec.model.kind}"
    none = np.full(omegas, np.nan)
    return {
        "predicted_jump": none, "predicted_down": none, "cause": [why] * omegas,
        "difference": [""] * omegas, "prediction": prediction,
    }  # fmt: skip


def _left_out(spec: SweepSpec, found: Thresholds, why: str) -> Thresholds:
    return found.model_copy(update=_not_predicted(spec, len(found.omega), f"not predicted: {why}"))


def _compared(spec: SweepSpec, found: Thresholds, each: Sequence[Prediction], *, words: bool) -> Thresholds:
    """With the predictions, one per omega, and the reasons why what the sweep found differs from them."""
    fields: dict[str, Any] = {
        "predicted_jump": np.array([prediction.jump for prediction in each]),
        "predicted_down": np.array([prediction.down for prediction in each]),
        "cause": [prediction.cause for prediction in each],
    }
    if words:
        fields["prediction"] = f"{found.prediction}; words continued from its cells: others may reach lower"
    known = found.model_copy(update=fields)
    texts = [_difference(spec, known, i, prediction.fold) for i, prediction in enumerate(each)]
    return known.model_copy(update={"difference": texts})


def _difference(spec: SweepSpec, found: Thresholds, i: int, fold: Fold | None) -> str:
    """Why `down` and predicted_down differ at one omega; empty where they agree or one is missing.

    fold: at which bouncing ends by the prediction.
    """
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
        return _below(fold, -above, spec.settle + spec.observe)
    if found.cause[i].startswith("fold"):
        return (
            f"the ramp lost the cycle {above:.3g} above the fold: its steps of {spacing:.3g} excite the "
            "spring; take smaller ones, or start on the cycle"
        )
    return f"the sweep stops bouncing {above:.3g} above Eq. 25: it still settles, or its window is short"


def _below(fold: Fold | None, delta: float, window: int) -> str:
    """Why a sweep bounces below the prediction by delta."""
    if fold is not None and (periods := lifetime(fold, delta)) > window:
        return (
            f"bouncing lives about {periods:,.0f} plate periods {delta:.3g} below the fold, longer than the "
            f"window of {window:,}"
        )
    return f"another cycle than those of one bounce lives {delta:.3g} below the prediction"


def _check_cost(sweep: Sweep, omegas: int) -> None:
    seconds = TYPICAL_CELLS * cell_seconds(sweep.spec, alone=True) * len(sweep.spec.directions)  # per omega
    if omegas * seconds > MAX_SECONDS:
        rule = (
            f"refining {omegas:,} values of omega takes about {omegas * seconds:.3g} core-seconds, the limit "
            f"for one answer is {MAX_SECONDS:g}: enough for {int(MAX_SECONDS / seconds):,} values"
        )
        raise InvalidRequest.of("tolerance", rule)
