"""Thresholds of one spring, of a grid of springs, and of a sweep: on its grid, refined and predicted."""

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
import xarray
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from kernel.cycles.folds import lifetime
from kernel.cycles.thresholds import EQ_25, Thresholds
from kernel.search import starts_of
from kernel.threshold import threshold
from service.errors import InvalidRequest
from service.formats import Predict
from service.pictures import (
    ATTRACTORS,
    AXES,
    IDEAL,
    draw_incomplete,
    draw_thresholds,
    edges,
    legend_beside,
    values_at,
)
from service.views import orbits, proofs, selection
from service.views.variables import ENERGY, coordinate, dataset, row, variable
from service.views.view import AT_ONCE_SECONDS, SMALL_SECONDS, Call, Estimate, Number, Omega, Query, View, Xi
from worker.analysis.bisection import TYPICAL_CELLS, Refined, Status, by_bisection, endless_rest, on_grid
from worker.analysis.prediction import (
    decides,
    is_ideal,
    of_contact,
    predict,
    predict_each,
    predict_from_cells,
    prediction_seconds,
    search_below,
    search_each,
)
from worker.spec.contact_models import Contact, Rigid
from worker.spec.errors import problems_of
from worker.study.layout import COMPUTED
from worker.sweep import SweepSpec
from worker.sweep.plan import cell_seconds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Number of springs whose thresholds are kept, the last used.
KEPT: Final = 4096

_OF_SEARCH: Final = (
    row("gone", (), "<f8", "Γ just below down at which a torus or aperiodic motion was seen to end"),
    row("rotation", (), "<f8", "turns of a torus for each round of the cycle in it, from 0 to 1/2"),
    row("rotation_error", (), "<f8", "error of the rotation"),
)

_OF_SPRING: Final = (
    row("threshold", (), "<f8", "Γ at which rest ends, Eq. 25", comment="NaN: at none"),
    row("jump", (), "<f8", "Γ of the fold at which flights leap on the way up"),
    row("down", (), "<f8", "lowest Γ at which bouncing persists", comment="NaN: not decided"),
    row("cause", (), "U", "what ends bouncing at down"),
    row("status", (), "U", "how down was found: closed form, continued, searched, or unresolved"),
    row("reason", (), "U", "why down is not decided"),
    row("missed", (), "<f8", "share of all starts of a basin that a search sees with 95 %",
        comment="of starts below the lowest end known, down to 0.3 of it"),
    row("lifetime", (), "<f8", "life of bouncing at Γ = down - delta", "plate periods"),
    row("delta", (), "<f8", "Γ below down"),
    *ENERGY, *_OF_SEARCH, *proofs.OF_THRESHOLD,
)  # fmt: skip


class SearchQuery(orbits.ContactQuery):
    """A contact, and whether to search."""

    search: Annotated[
        bool, Field(description="search for what bounces below, by workers, half a minute a spring")
    ] = False
    effort: Annotated[Number, Field(ge=0, le=100, description="of a search: 100 to 10,000 starts each")] = 50


class SpringQuery(SearchQuery):
    """A spring, its contact, and how far below the fold it bounces."""

    omega: Omega
    xi: Xi
    delta: Annotated[Number, Field(ge=1e-15, le=0.1, description="Γ below `down` with a lifetime")] = 1e-6
    prove: Annotated[bool, Field(description="an upper bound of `down` with a proof")] = False


#: The thresholds of one spring; `unresolved` or `not searched` where the rule does not decide.
predicted: Final = lru_cache(KEPT)(predict)


def compute_spring(study: None, query: SpringQuery, *computed: Any) -> xarray.Dataset:
    """Where one spring begins and ceases to bounce.

    In closed form, of the rigid contact without restitution; with a `model`, by workers that follow the
    contact's own cycles, a second at most once compiled. `down` is the lowest Γ at which bouncing
    persists, by a rule that no search contradicts at its damping: `cause` is `not searched` below that, and
    `unresolved` where the rule does not decide. A slow descent ends there or earlier, where the cycle that it
    is on ends. Below a fold bouncing lives for `lifetime`; the energy balance is that of the cycle at the
    fold. A worker computes what takes longer than a second.

    With `search`, for half a minute, workers start from many states at 30 values of Γ, and follow the cycles
    that their transients pass by, and what survives, down to the end: an upper bound at any damping, with the
    share of starts, `missed`, that a basin must have to be seen with 95 %.
    """
    contact = orbits.contact(query)
    *before, search = computed if query.search else (*computed, None)
    thresholds = before[0] if before else predicted(query.omega, query.xi)
    data: dict[str, Any] = {
        "threshold": thresholds.gamma_th if np.isfinite(thresholds.gamma_th) else np.nan,
        "jump": thresholds.jump, "down": thresholds.down,
        "cause": thresholds.cause, "reason": thresholds.reason, "status": _status(contact, thresholds),
    }  # fmt: skip
    if search is not None:
        data["missed"] = search.missed
    if search is not None and not search.gamma > thresholds.down * _SAME_END:
        gamma, what = (
            (search.gamma, search.what) if np.isfinite(search.gamma) else (thresholds.gamma_th, EQ_25)
        )
        data |= {"down": gamma, "cause": what, "status": "searched", "reason": ""}
        data |= {row.name: getattr(search, row.name) for row in _OF_SEARCH}
    elif thresholds.fold is not None:
        data |= {"lifetime": lifetime(thresholds.fold, query.delta), "delta": query.delta}
        if thresholds.fold.energy is not None:
            data |= {name: values[0] for name, values in thresholds.fold.energy._asdict().items()}
    if query.prove:
        data |= proofs.of_threshold(query.omega, query.xi, thresholds.fold)
    left_out = (() if query.search else _OF_SEARCH) + (() if query.prove else proofs.OF_THRESHOLD)
    rows = [row for row in _OF_SPRING if row not in left_out]
    return dataset(
        {row.name: variable((), data.get(row.name, np.nan), row) for row in rows},
        {name: coordinate(name, getattr(query, name)) for name in ("omega", "xi")},
        {"model": IDEAL if contact is None else orbits.name_of(contact), "complete": True},
    )


def _status(contact: Contact | None, thresholds: Thresholds) -> str:
    """How `down` was found."""
    if not np.isfinite(thresholds.down):
        return "unresolved"
    fold = thresholds.fold
    return "closed form" if contact is None and (fold is None or fold.cycle.word == "s") else "continued"


def _calls(query: SpringQuery) -> list[Call]:
    """The calls of a spring for workers: the prediction, and the search if it is asked for."""
    contact, spring = orbits.contact(query), (query.omega, query.xi)
    calls: list[Call] = [(predict, *spring) if contact is None else (of_contact, contact, *spring)]
    if query.search:
        calls.append((search_below, contact or Rigid(), *spring, query.effort))
    return calls


def spring_parts(study: None, query: SpringQuery) -> Sequence[Call]:
    """The calls of the spring; none if the closed form decides, and is quick."""
    spring = query.omega, query.xi
    in_closed_form = query.model is None and not query.search
    quick = in_closed_form and prediction_seconds(*spring) <= AT_ONCE_SECONDS and decides(*spring)
    return () if quick else _calls(query)


def estimate_spring(spec: None, query: SpringQuery) -> Estimate:
    """One number of each variable. Raises InvalidRequest."""
    contact = orbits.contact(query)
    if query.prove and (contact is not None or query.search):
        raise InvalidRequest.of("prove", "is of the closed form: leave out model and search")
    brief = contact is None and prediction_seconds(query.omega, query.xi) <= SMALL_SECONDS
    return Estimate({}, small=brief and not query.prove)  # proofs set the precision of the whole process


SPRING: Final = View(
    "threshold", "Thresholds of a spring", None, SpringQuery, compute_spring,
    estimate_spring, variables=_OF_SPRING, parts=spring_parts,
)  # fmt: skip


#: A search has found the end of the rule, or a lower one, if it ends below this multiple of it.
_SAME_END: Final = 1.0 + 1e-9
#: Limit on the core-seconds of a grid; those of a spring, followed, or searched with up to 1,000 starts.
MAX_GRID_SECONDS: Final = 4_000.0
_CONTINUED, _SEARCHED = 1.0, 15.0

#: Variables that only one spring has.
_ALONE: Final = {"lifetime", "delta", *(row.name for row in (*ENERGY, *proofs.OF_THRESHOLD))}
_OF_GRID: Final = tuple(row for row in _OF_SPRING if row.name not in _ALONE)

Values = Annotated[str, Field(max_length=4_000, description="values, as 0.45,0.46, or start:stop:number")]


class GridQuery(SearchQuery):
    """Springs, their contact, and whether to search."""

    omega: Values
    xi: Values


def _values(query: GridQuery, name: str) -> NDArray[np.float64]:
    """The values of an axis, written as numbers or start:stop:number. Raises InvalidRequest."""
    text = getattr(query, name)
    try:
        if ":" in text:
            start, stop, number = text.split(":")
            values = np.linspace(float(start), float(stop), min(int(number), int(MAX_GRID_SECONDS) + 1))
        else:
            values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        raise InvalidRequest.of(name, "must be numbers, as 0.45,0.46, or start:stop:number") from None
    if not (len(values) and (np.diff(values) > 0.0).all()):
        raise InvalidRequest.of(name, "must increase")
    return values


def _springs(query: GridQuery) -> list[SpringQuery]:
    """The springs of a grid, omega fastest. Raises InvalidRequest, also for too many."""
    xis, omegas = (_values(query, name).tolist() for name in ("xi", "omega"))
    seconds = _SEARCHED * max(1.0, starts_of(query.effort) / 1_000) if query.search else _CONTINUED
    most = int(MAX_GRID_SECONDS / seconds)
    if len(xis) * len(omegas) > most:
        rule = f"{most:,} springs take {MAX_GRID_SECONDS:,.0f} core-seconds, which is the limit"
        raise InvalidRequest.of("omega", f"must be fewer: {rule}")
    shared = query.model_dump(exclude={"omega", "xi"})
    try:
        return [SpringQuery(omega=omega, xi=xi, **shared) for xi in xis for omega in omegas]
    except ValidationError as error:
        problems = problems_of(error, {"": tuple(SpringQuery.model_fields)})
        raise InvalidRequest("; ".join(map(str, problems)), problems) from error


def grid_parts(study: None, query: GridQuery) -> Sequence[Call]:
    """The calls of all springs; calls of one function stand together."""
    calls = [_calls(spring) for spring in _springs(query)]
    return [call for step in zip(*calls, strict=True) for call in step]


def compute_grid(study: None, query: GridQuery, *computed: Any) -> xarray.Dataset:
    """Where the springs of a grid of Ω and ξ begin and cease to bounce.

    Each as `threshold` of one spring, computed by the workers. With `search`, each is searched for: `missed`
    is the share of all starts of a basin that its search sees with 95 %.
    """
    springs = _springs(query)
    results = [compute_spring(None, spring, *computed[i :: len(springs)]) for i, spring in enumerate(springs)]
    axes = {name: coordinate(name, _values(query, name)) for name in ("xi", "omega")}
    shape = tuple(axis.size for axis in axes.values())
    data = {
        row.name: variable(tuple(axes), np.reshape([x[row.name].values for x in results], shape), row)
        for row in _OF_GRID
        if row.name in results[0]
    }
    return dataset(data, axes, results[0].attrs)


def estimate_grid(spec: None, query: GridQuery) -> Estimate:
    """One number of each variable for each spring. Raises InvalidRequest."""
    orbits.contact(query)
    sizes = {name: len(_values(query, name)) for name in ("xi", "omega")}
    return Estimate(sizes, memory=_PER_OMEGA * len(_springs(query)), small=False)


#: Up to this many values of xi are drawn as lines over omega; more are drawn as a map.
_MOST_LINES: Final = 5


def draw_grid(result: xarray.Dataset, figure: "Figure") -> None:
    """Draw the lowest Γ at which bouncing persists: a line over omega for each of a few xi, or a map.

    Diamonds: searched. Dashed: Eq. 25. White on a map: not decided.
    """
    axes = figure.subplots()
    axes.set_xlabel(AXES["omega"])
    omega = result.omega.values
    if result.sizes["xi"] > _MOST_LINES:
        ends = edges(omega), edges(result.xi.values)
        shown = axes.pcolormesh(*ends, result.down.values, rasterized=True)
        figure.colorbar(shown, label=r"lowest $\Gamma$ at which bouncing persists")
        axes.set_ylabel(AXES["xi"])
        axes.set_title("white: not decided", fontsize=10)
        return
    for i in range(result.sizes["xi"]):
        line, colour = result.isel(xi=i), ATTRACTORS[i]
        searched = line.status.values == "searched"
        down = line.down.values
        axes.plot(omega, down, "-", color=colour, linewidth=1.2, label=values_at(line, ["xi"]))
        axes.plot(omega[~searched], down[~searched], ".", color=colour)
        axes.plot(omega[searched], down[searched], "D", color=colour, fillstyle="none", markersize=5)
        axes.plot(omega, line.threshold.values, "--", color=colour, linewidth=0.9)
    axes.set_ylabel(r"lowest $\Gamma$ at which bouncing persists")
    legend_beside(axes, axes.get_legend_handles_labels()[0])
    searched_for = "; diamonds: searched for" if (result.status.values == "searched").any() else ""
    axes.set_title(f"dashed: Eq. 25{searched_for}", fontsize=10)


GRID: Final = View(
    "thresholds", "Thresholds of a grid of springs", None, GridQuery, compute_grid, estimate_grid,
    variables=_OF_GRID, rows="status", printed=("cause",), parts=grid_parts, draw=draw_grid,
)  # fmt: skip


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
_PER_OMEGA: Final = 1_000

_ROWS: Final = (
    row("analytic", (), "<f8", "threshold Γ from rest by Eq. 25", comment="NaN: rest never ends, or a ball"),
    row("up", (), "<f8", "lowest Γ that bounces, ascending or from rest"),
    row("down", (), "<f8", "lowest Γ that bounces, descending"),
    row("predicted_jump", (), "<f8", "Γ of the fold at which flights leap"),
    row("predicted_down", (), "<f8", "lowest Γ at which bouncing persists, predicted"),
    row("up_status", (), "U", "why up is a number or NaN"),
    row("down_status", (), "U", "why down is a number or NaN"),
    row("cause", (), "U", "what ends bouncing at predicted_down, or why that is NaN"),
    row("difference", (), "U", "why down and predicted_down differ"),
    row("up_computed", (), "|b1", "of an adaptive map: whether both cells beside up were computed"),
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

    At one ξ: as the sweep's cells show it, beside Eq. 25 and the closed form. `up` and `down` are values of
    the grid, or with a `tolerance` refined by workers. They are NaN unless their status is `found`:

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
    why_not = _left_out(spec, xi, query.predict)
    if not (predictions or why_not):
        predictions = [predicted(value, xi) for value in omega.tolist()]
    pairs = zip(data["down"].tolist(), predictions, strict=bool(predictions))
    differences = [_difference(spec, query.tolerance, *pair) for pair in pairs]
    rows = [(x.jump, x.down, x.cause, why) for x, why in zip(predictions, differences, strict=True)]
    rows = rows or [(np.nan, np.nan, why_not, "")] * len(omega)
    columns: Any = zip(*rows, strict=True)
    data |= zip(("predicted_jump", "predicted_down", "cause", "difference"), columns, strict=True)
    analytic = threshold(omega, xi)
    is_spring = spec.model.kind != "ball"
    data["analytic"] = np.where(is_spring & np.isfinite(analytic), analytic, np.nan)
    contact = f"{IDEAL}: the contact of the sweep"
    if not is_ideal(spec.model):
        contact = f"{IDEAL}: not the contact of the sweep, which is {spec.model.kind}"
    if query.predict == "search" or (query.predict == "cells" and study.chunks_done):
        own = orbits.name_of(orbits.contact_of(spec))
        how = "searches" if query.predict == "search" else "cycles continued from the sweep's cells"
        contact = f"{own}: {how}; others may reach lower"
    attrs: dict[str, Any] = {"prediction": contact, "model": spec.model.kind, "complete": complete}
    attrs |= query.model_dump(include={"tolerance", "gamma_start", "gamma_stop"}, exclude_none=True)
    window = selection.between(omega, query, "omega_start", "omega_stop")
    return dataset(
        {row.name: variable(("omega",), data[row.name], row) for row in _ROWS if row.name in data},
        {"omega": coordinate("omega", omega), "xi": coordinate("xi", xi)},
        attrs,
    ).isel(omega=slice(window.start, window.stop))


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
            calls.append((search_each, spec.model, values, nearest.value))
        else:
            calls.append((predict_each, values, nearest.value))
    return calls


def on_grid_of(study: selection.Stored[SweepSpec], xi: int) -> tuple[dict[str, NDArray[Any]], bool]:
    """The thresholds on the grid in gamma with their statuses, and whether every cell is done.

    In an adaptive map also whether both cells beside each threshold were computed.
    """
    spec = study.spec
    gamma, omega = spec.axis_values("gamma"), spec.axis_values("omega")
    endless = endless_rest(spec, omega, float(spec.axis_values("xi")[xi]))
    names = ["outcome", COMPUTED] if spec.fills_in else ["outcome"]
    data: dict[str, NDArray[Any]] = {"up_computed": np.zeros(len(omega), bool)} if spec.fills_in else {}
    for name in ("up", "down"):
        data[name] = np.full(len(omega), np.nan)
        data[f"{name}_status"] = np.full(len(omega), Status.NOT_RAMPED.value, object)
    complete, rows = True, max(1, selection.MAX_READ // len(gamma))
    for direction in spec.directions:
        down = direction == "down"
        name = "down" if down else "up"
        for low in range(0, len(omega), rows):
            part = selection.read_direction(
                study, names, direction, {"xi": xi, "omega": slice(low, low + rows)}
            )
            complete = complete and study.is_complete(part["outcome"])
            for i, outcome in enumerate(part["outcome"], low):
                bracket = on_grid(outcome, down, bool(endless[i]))
                data[f"{name}_status"][i] = bracket.status.value
                if bracket.status is Status.FOUND and bracket.bouncing is not None:
                    data[name][i] = gamma[bracket.bouncing]
                    if COMPUTED in part:
                        beside = part[COMPUTED][i - low, bracket.bouncing - 1 : bracket.bouncing + 1]
                        data["up_computed"][i] = bool(beside.all())
    return data, complete


def _refined(data: dict[str, NDArray[Any]], refined: Sequence[Refined]) -> dict[str, NDArray[Any]]:
    """The refined thresholds in place of those on the grid; missing for a job that has not begun."""
    thresholds: dict[str, NDArray[Any]] = {}
    if refined:
        for name in Refined._fields:
            thresholds[name] = np.concatenate([getattr(part, name) for part in refined])
    else:
        for name in ("up", "down"):
            status = data[f"{name}_status"]
            thresholds[name] = np.full(len(status), np.nan)
            thresholds[f"{name}_status"] = np.where(status == Status.FOUND, Status.MISSING.value, status)
    if "up_computed" in data:  # refinement computes the cells that decide
        thresholds["up_computed"] = thresholds["up_status"] == Status.FOUND
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


@lru_cache(64)  # called several times for an answer
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
    if prediction.cause == EQ_25:
        why = f"the sweep stops bouncing {above:.3g} above Eq. 25: it still settles, or its window is short"
    elif spec.axis_values("gamma")[-1] < prediction.jump and down >= prediction.gamma_th - slack:
        why = f"the ramp begins below the jump at {prediction.jump:.6g}, on a cycle that shrinks to rest"
    return why


def draw(result: xarray.Dataset, figure: "Figure") -> None:
    """Draw the thresholds over Ω, and write where cells are missing."""
    draw_thresholds(axes := figure.subplots(), result)
    if not result.attrs["complete"]:
        draw_incomplete(axes, "cells are not computed yet")


VIEW: Final = View(
    "threshold", "Thresholds of a sweep", SweepSpec, ThresholdQuery, compute, estimate, variables=_ROWS,
    rows="up_status", parts=parts, draw=draw,
)  # fmt: skip
