"""Thresholds of a sweep: on its grid, refined, and predicted."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Any, Final

import numpy as np
import xarray
from numpy.typing import NDArray
from pydantic import Field

from kernel.cycles.folds import lifetime
from kernel.cycles.thresholds import Thresholds
from kernel.threshold import threshold
from service.errors import InvalidRequest
from service.formats import Predict
from service.pictures import IDEAL, Figure, draw_incomplete, draw_thresholds
from service.views import orbits, selection
from service.views.springs.queries import name_of
from service.views.springs.threshold import predicted
from service.views.variables import coordinate, dataset, row, variables
from service.views.view import AT_ONCE_SECONDS, Call, Estimate, Number, Query, View
from worker.analysis.bisection import TYPICAL_CELLS, Refined, Status, by_bisection, endless_rest, on_grid
from worker.analysis.prediction import (
    decides,
    is_ideal,
    predict_each,
    predict_from_cells,
    prediction_seconds,
    search_each,
)
from worker.spec.contact_models import Stepped
from worker.sweep import SweepSpec
from worker.sweep.plan import cell_seconds

#: Values of omega that a call refines: few enough to share out, enough to be worth a call.
BLOCK: Final = 16

#: Limit on the values of omega that are predicted without `all`.
MAX_PREDICTED: Final = 200

#: Typical core-seconds per omega: for following the cycles of three cells, for a search.
_EACH_SECONDS: Final = {"cells": 0.48, "search": 15.0}

#: Limits on the values of omega, and on the core-seconds, of predictions that count as small.
MAX_BRIEF: Final = 4
BRIEF_SECONDS: Final = 0.2

#: Core-seconds of the predictions in a call.
CALL_SECONDS: Final = 1.0

#: Limits on the core-seconds of an answer.
MAX_SECONDS: Final = 60.0
MAX_PREDICTION_SECONDS: Final = 200.0
MAX_SEARCH_SECONDS: Final = 1_000.0

#: Bytes per omega in an answer, with statuses as text.
_PER_OMEGA: Final = 3_000

_ROWS: Final = (
    row("analytic", (), "<f8", "threshold Γ from rest by Eq. 25", comment="NaN: rest never ends, or a ball"),
    row("up", (), "<f8", "lowest Γ that bounces, ascending or from rest"),
    row("down", (), "<f8", "lowest Γ that bounces, descending"),
    row("predicted_jump", (), "<f8", "Γ of the fold at which flights leap"),
    row("predicted_down", (), "<f8", "lowest Γ at which bouncing persists, predicted"),
    row("up_status", (), "U", "why up is a number or NaN"),
    row("down_status", (), "U", "why down is a number or NaN"),
    row("cause", (), "U", "what ends bouncing at predicted_down, or why that is NaN"),
    row("reason", (), "U", "why predicted_down is not decided, or may be lower"),
    row("difference", (), "U", "why down and predicted_down differ"),
)


class ThresholdQuery(Query):
    """The plane of the grid at the nearest value of xi, and what is computed beyond the grid."""

    xi: Number | None = None
    tolerance: Annotated[Number, Field(ge=1e-9, le=1e3)] | None = Field(
        None, description="in Γ: refine the thresholds beyond the grid, from the sweep's stored states"
    )
    predict: Predict = Field("some", description="which thresholds are predicted, see above")
    omega_start: Number | None = None
    omega_stop: Number | None = None
    gamma_start: Annotated[Number | None, Field(description="of a picture: its lowest threshold")] = None
    gamma_stop: Annotated[Number | None, Field(description="of a picture: its highest threshold")] = None


def compute(study: selection.Stored[SweepSpec], query: ThresholdQuery, *computed: Any) -> xarray.Dataset:
    """Where bouncing begins and ends, per Ω.

    The answer is for one ξ, beside Eq. 25 and the closed form. `up` and `down` are values of the grid, or
    with a `tolerance` refined by workers. They are NaN unless their status is `found`:

    - `below the grid`: the lowest Γ bounces already
    - `above the grid`: every cell is at rest
    - `never bounces`: of `up`, every cell is at rest and Eq. 25 is above every Γ that a specification may
      have; of `down`, no cell of the ramp bounces
    - `not ramped`: the sweep does not have this direction
    - `not refined`: the grid holds the change, and refinement reached its limit
    - `missing`, `unresolved`, `diverged`, `settling`: the outcome of the cell that decides, the lowest that
      is not at rest

    `predicted_down` is the lowest Γ at which bouncing persists on the contact that the attribute
    `prediction` names; a descent ends there or earlier, on another cycle. Workers predict what takes longer
    than a second. By `predict` it is:

    - `none`: not predicted
    - `some`: in closed form, for up to 200 values of Ω
    - `all`: in closed form, for every Ω
    - `cells`: from cycles of the sweep's cells; on an ideal plate where the closed form is `unresolved`
    - `search`: searched for where branches of the sweep's contact do not decide
    """
    spec, nearest = study.spec, selection.nearest_index(study.spec, "xi", query.xi)
    omega, xi = spec.axis_values("omega"), nearest.value
    data, complete = on_grid_of(study, nearest.index)
    refined = [part for part in computed if isinstance(part, Refined)]
    if query.tolerance is not None:
        data |= _refined(data, refined)
    predictions = [prediction for part in computed[len(refined) :] for prediction in part]
    if why_not := _left_out(spec, xi, query.predict):
        predictions = [Thresholds(value, xi, np.nan, cause=why_not) for value in omega.tolist()]
    predictions = predictions or [predicted(value, xi) for value in omega.tolist()]
    pairs = zip(data["down"].tolist(), predictions, strict=True)
    analytic = threshold(omega, xi)
    data |= {
        "analytic": np.where((spec.model.kind != "ball") & np.isfinite(analytic), analytic, np.nan),
        "predicted_jump": [prediction.jump for prediction in predictions],
        "predicted_down": [prediction.down for prediction in predictions],
        "cause": [prediction.cause for prediction in predictions],
        "reason": [prediction.reason for prediction in predictions],
        "difference": [_difference(spec, query.tolerance, *pair) for pair in pairs],
    }
    attrs = {"prediction": _prediction(study, query), "model": spec.model.kind, "complete": complete}
    attrs |= query.model_dump(include={"tolerance", "gamma_start", "gamma_stop"}, exclude_none=True)
    window = selection.between(omega, query, "omega_start", "omega_stop")
    return dataset(
        variables(_ROWS, data, ("omega",)),
        {"omega": coordinate("omega", omega), "xi": coordinate("xi", xi)},
        attrs,
    ).isel(omega=slice(window.start, window.stop))


def _prediction(study: selection.Stored[SweepSpec], query: ThresholdQuery) -> str:
    """The contact of a prediction, and how it was made."""
    if query.predict == "search" or (query.predict == "cells" and study.chunks_done):
        how = "searches" if query.predict == "search" else "cycles continued from the sweep's cells"
        return f"{name_of(orbits.contact_of(study.spec))}: {how}; others may reach lower"
    own = study.spec.model
    whose = "the contact of the sweep"
    return f"{IDEAL}: {whose if is_ideal(own) else f'not {whose}, which is {name_of(own)}'}"


def estimate(spec: SweepSpec, query: ThresholdQuery) -> Estimate:
    """All omegas, the outcomes of the plane, and the computing.

    Raises InvalidRequest for a sweep ramped along another axis than gamma, for a contact whose cycles cannot
    be followed, and for more core-seconds than an answer may take.
    """
    if spec.ramp_axis not in (None, "gamma"):
        rule = f"is {spec.ramp_axis}; thresholds in gamma need a sweep from rest or ramped along gamma"
        raise InvalidRequest.of("protocol.axis", rule)
    xi = selection.nearest_index(spec, "xi", query.xi).value
    omegas, gammas = (len(spec.axis_values(axis)) for axis in ("omega", "gamma"))
    if query.tolerance is not None:
        seconds = omegas * TYPICAL_CELLS * cell_seconds(spec, alone=True) * len(spec.directions)
        if seconds > MAX_SECONDS:
            rule = (
                f"refining {omegas:,} values of omega takes about {seconds:.3g} core-seconds, the limit for "
                f"one answer is {MAX_SECONDS:g}: enough for {int(omegas * MAX_SECONDS / seconds):,} values"
            )
            raise InvalidRequest.of("tolerance", rule)
    brief = bool(_left_out(spec, xi, query.predict)) or (
        query.predict == "some" and omegas <= MAX_BRIEF and _seconds(spec, xi, "some")[-1] <= BRIEF_SECONDS
        and all(decides(value, xi) for value in spec.axis_values("omega").tolist())
    )  # fmt: skip
    return Estimate(
        {"omega": omegas}, reads=("omega", "gamma"), small=brief and query.tolerance is None,
        memory=omegas * _PER_OMEGA + min(omegas * gammas, selection.MAX_READ),
    )  # fmt: skip


def parts(study: selection.Stored[SweepSpec], query: ThresholdQuery) -> Sequence[Call]:
    """Refinements, unless the job has not begun, and predictions that take long.

    Raises OutdatedJob for a sweep of another kernel version, whose states this release does not continue.
    """
    spec, nearest = study.spec, selection.nearest_index(study.spec, "xi", query.xi)
    omega = spec.axis_values("omega").tolist()
    calls: list[Call] = []
    if query.tolerance is not None or query.predict == "cells":
        selection.check_kernel(study)
    if query.tolerance is not None and study.chunks_done:
        blocks = (tuple(range(low, min(low + BLOCK, len(omega)))) for low in range(0, len(omega), BLOCK))
        calls += [(by_bisection, spec, study.url, nearest.index, block, query.tolerance) for block in blocks]
    if _left_out(spec, nearest.value, query.predict):
        return calls
    how: Predict = query.predict
    if how == "cells" and not study.chunks_done:
        how = "all"  # before the first chunk there are no cells
    seconds = _seconds(spec, nearest.value, how)
    if how == "some" and seconds[-1] <= AT_ONCE_SECONDS:
        return calls
    call = (seconds // CALL_SECONDS).astype(int)
    for block in (tuple(np.flatnonzero(call == number).tolist()) for number in np.unique(call)):
        values = tuple(omega[i] for i in block)
        if how == "cells":
            calls.append((predict_from_cells, spec, study.url, nearest.index, block, study.complete))
        elif how == "search":
            calls.append((search_each, orbits.contact_of(spec), values, nearest.value))
        else:
            calls.append((predict_each, values, nearest.value))
    return calls


def on_grid_of(study: selection.Stored[SweepSpec], xi: int) -> tuple[dict[str, Any], bool]:
    """The thresholds on the grid in gamma with their statuses, and whether every cell is done."""
    spec = study.spec
    gamma, omega = spec.axis_values("gamma"), spec.axis_values("omega")
    endless = endless_rest(spec, omega, float(spec.axis_values("xi")[xi]))
    data: dict[str, Any] = {}
    for name in ("up", "down"):
        data[name] = np.full(len(omega), np.nan)
        data[f"{name}_status"] = np.full(len(omega), Status.NOT_RAMPED.value, object)
    complete, rows = True, max(1, selection.MAX_READ // len(gamma))
    for direction in spec.directions:
        name = "down" if direction == "down" else "up"
        for low in range(0, len(omega), rows):
            some: selection.Indices = {"xi": xi, "omega": slice(low, low + rows)}
            outcomes = selection.read_direction(study, ["outcome"], direction, some)["outcome"]
            complete = complete and study.is_complete(outcomes)
            for i, outcome in enumerate(outcomes, low):
                bracket = on_grid(outcome, name == "down", bool(endless[i]))
                data[f"{name}_status"][i] = bracket.status.value
                if bracket.status is Status.FOUND and bracket.bouncing is not None:
                    data[name][i] = gamma[bracket.bouncing]
    return data, complete


def _refined(data: dict[str, NDArray[Any]], refined: Sequence[Refined]) -> dict[str, NDArray[Any]]:
    """The refined thresholds in place of those on the grid; missing for a job that has not begun."""
    if refined:
        return {name: np.concatenate([getattr(part, name) for part in refined]) for name in Refined._fields}
    thresholds: dict[str, NDArray[Any]] = {}
    for name in ("up", "down"):
        status = data[f"{name}_status"]
        thresholds[name] = np.full(len(status), np.nan)
        thresholds[f"{name}_status"] = np.where(status == Status.FOUND, Status.MISSING.value, status)
    return thresholds


def _left_out(spec: SweepSpec, xi: float, predict: Predict) -> str:
    """Why nothing is predicted; empty if every omega is predicted. Raises InvalidRequest as `estimate`."""
    if predict in _EACH_SECONDS:
        orbits.contact_of(spec)
    if predict == "none":
        return "not predicted"
    if spec.model.kind == "ball":
        return "not predicted: a ball has no spring"
    omegas = len(spec.axis_values("omega"))
    if predict == "some" and omegas > MAX_PREDICTED:
        return f"not predicted: ask for all above {MAX_PREDICTED} values of omega"
    seconds = _seconds(spec, xi, predict)
    limit = MAX_SEARCH_SECONDS if predict == "search" else MAX_PREDICTION_SECONDS
    if seconds[-1] <= limit:
        return ""
    rule = (
        f"{omegas:,} values of omega take about {seconds[-1]:,.0f} core-seconds, the limit for one "
        f"answer is {limit:g}: enough for {np.searchsorted(seconds, limit, 'right'):,} values"
    )
    if predict == "some":
        return f"not predicted: {rule}"
    raise InvalidRequest.of("predict", f"{rule}; none leaves predictions out")


@lru_cache(64)  # called several times for an answer, 25 ms each for 1,000 omegas
def _seconds(spec: SweepSpec, xi: float, predict: Predict) -> NDArray[np.float64]:
    """Core-seconds of the predictions up to each omega (n,)."""
    beside = _EACH_SECONDS.get(predict, 0.0)
    return np.cumsum([beside + prediction_seconds(omega, xi) for omega in spec.axis_values("omega").tolist()])


def _difference(spec: SweepSpec, spacing: float | None, down: float, prediction: Thresholds) -> str:
    """Why `down` and the prediction differ at one omega; empty if they agree, or one is missing.

    spacing: precision of `down` in gamma; None for that of the grid.
    """
    if not np.isfinite(down - prediction.down):
        return ""
    if spacing is None:
        gamma = spec.axis_values("gamma")
        i = int(np.searchsorted(gamma, down))
        spacing = float(gamma[i] - gamma[i - 1]) if i else 0.0
    above, slack = down - prediction.down, selection.ROUNDING * prediction.down
    if -slack <= above <= spacing + slack:
        return ""
    if isinstance(spec.model, Stepped):
        side = "above" if above > 0.0 else "below"
        return f"{abs(above):.3g} {side} the prediction, which has no time steps"
    if above < 0.0:
        fold, window = prediction.fold, sum(spec.window)
        if fold is not None and (periods := lifetime(fold, -above)) > window:
            return (
                f"bouncing lives about {periods:,.0f} plate periods {-above:.3g} below the fold, longer than "
                f"the window of {window:,}"
            )
        return f"another cycle lives {-above:.3g} below the prediction"
    why = (
        f"the ramp lost the cycle {above:.3g} above the fold: its steps of {spacing:.3g} excite the spring; "
        "take smaller ones, or start on the cycle"
    )
    if prediction.cause == prediction.at_rest:
        why = f"bouncing stops {above:.3g} above where rest ends: it still settles, or its window is short"
    elif spec.axis_values("gamma")[-1] < prediction.jump and down >= prediction.gamma_th - slack:
        why = f"the ramp begins below the jump at {prediction.jump:.6g}, on a cycle that shrinks to rest"
    elif -slack <= down - prediction.gamma_th <= spacing + slack:
        why = (
            f"the ramp ends on another cycle, which shrinks to rest, {above:.3g} above the fold: start it on "
            "the cycle that folds"
        )
    return why


def draw(result: xarray.Dataset, figure: Figure) -> None:
    """Draw the thresholds over Ω, and write where cells are missing."""
    draw_thresholds(axes := figure.subplots(), result)
    if not result.attrs["complete"]:
        draw_incomplete(axes, "cells are not computed yet")


VIEW: Final = View(
    "threshold", "Thresholds of a sweep", SweepSpec, ThresholdQuery, compute, estimate, variables=_ROWS,
    rows="up_status", parts=parts, draw=draw,
)  # fmt: skip
