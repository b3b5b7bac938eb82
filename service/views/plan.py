"""The plan of a sweep: what each effort and grid would cost, and how much of its picture would be wrong."""

from collections.abc import Callable, Sequence
from math import inf, prod
from typing import Annotated, Any, Final

import numpy as np
import xarray
from pydantic import Field

from service.errors import InvalidRequest, TooLarge
from service.pictures import ATTRACTORS, Figure
from service.views.variables import dataset, row, variables
from service.views.view import SECONDS, Call, Estimate, Number, Query, View
from worker.analysis.audit import reference_seconds
from worker.analysis.planning import FIRST, FRESH, MORE, Setting, Share, frontier, plan
from worker.spec.errors import SpecTooLarge
from worker.studies import study_of
from worker.study import Plan
from worker.sweep import SweepSpec
from worker.sweep.levels import WHOLE, cells, finest, level
from worker.sweep.specification import EFFORTS

#: Parts of the sweep's cells that the compared grids have.
PARTS: Final = (1.0, 1 / 4, 1 / 16, 1 / 64)
#: Limit on the core-seconds of the pilot points, by their longer computation.
MAX_SECONDS: Final = 60.0
#: By default, the share of the plane that may be wrong.
TOLERANCE: Final = 0.05

_ROWS: Final = (
    row("effort", ("setting",), "U", "windows, by name"),
    row("grid", ("setting",), "U", "cells along ξ, Ω and Γ"),
    row("cells", ("setting",), "<i8", "cells of the sweep"),
    row("seconds", ("setting",), "<f8", "time on this service's workers", "s"),
    row("share", ("setting",), "<f8", "share of the plane that the picture shows wrong"),
    row("low", ("setting",), "<f8", "least share, with 99 % confidence"),
    row("high", ("setting",), "<f8", "most, with 95 % confidence; of candidates for all together"),
    row("bytes", ("setting",), "<i8", "stored bytes before compression"),
    row("frontier", ("setting",), "|b1", "whether no cheaper setting shows less wrong"),
    row("recommended", ("setting",), "|b1", "whether it is the one to take"),
    row("spec", ("setting",), "U", "its specification, as JSON"),
)


class PlanQuery(Query):
    """Limits on the recommended setting."""

    budget: Annotated[Number, SECONDS] | None = Field(
        None, description="s, or a time such as 5m, that it takes at most"
    )
    tolerance: Annotated[Number, Field(gt=0, lt=1)] | None = Field(
        None, description="share that it shows wrong at most; default: 0.05 without a budget"
    )
    seed: Annotated[int, Field(ge=0, lt=2**63, description="of the pilot points")] = 0

    @property
    def limit(self) -> float | None:
        """The tolerance, or its default without a budget."""
        return TOLERANCE if self.tolerance is None and self.budget is None else self.tolerance


def settings_of(
    spec: SweepSpec, pace: Callable[[SweepSpec], float | None], workers: int, check: Callable[[Any], Plan]
) -> list[Setting]:
    """The settings to compare, the most thorough first. Raises SpecInvalid, SpecTooLarge if all are refused.

    pace: returns that of a sweep, or None if it is not known. workers: number that share the work. check:
    returns the plan of a sweep; raises SpecTooLarge for one that is refused.
    """
    chosen: list[Setting] = []
    refusal: SpecTooLarge | None = None
    for effort in reversed(EFFORTS):
        whole = SweepSpec.parse(spec.as_submitted() | EFFORTS[effort])
        measured = pace(whole)
        for part in PARTS:
            steps = WHOLE if part == 1.0 else finest(whole, part * cells(whole, WHOLE))
            if steps is None or any(other.steps == steps for other in chosen if other.spec == whole):
                continue
            thinned = level(whole, steps)
            try:
                taken = study_of(spec).estimate(thinned, check(thinned)).at(measured)
                chosen.append(Setting(whole, steps, taken.seconds_on(workers), taken.bytes, effort))
            except SpecTooLarge as error:
                refusal = refusal or error
    if refusal and not chosen:
        raise refusal
    return chosen


def parts(settings: Sequence[Setting], query: PlanQuery) -> Sequence[Call]:
    """The pilot points. Raises InvalidRequest for a ramp, whose cells depend on each other, and TooLarge."""
    if settings[0].spec.ramp_axis is not None:
        rule = "must be rest: cells of a ramp depend on those before; compute it with a budget, or audit it"
        raise InvalidRequest.of("protocol.kind", rule)
    seconds = (FIRST + MORE + FRESH) * reference_seconds(settings[0].spec)
    if seconds > MAX_SECONDS:
        rule = f"its pilot points take about {seconds:,.0f} core-seconds, the limit is {MAX_SECONDS:g}"
        raise TooLarge(f"{rule}: a cheaper contact, such as rigid or soft, has a plan")
    return [(plan, tuple(settings), query.budget, query.limit, query.seed)]


def compute(settings: Sequence[Setting], query: PlanQuery, result: tuple[list[Share], int]) -> xarray.Dataset:
    """The table of a plan."""
    shares, chosen = result
    specs = [level(setting.spec, setting.steps) for setting in settings]
    data: dict[str, Any] = {
        "effort": [setting.effort for setting in settings],
        "grid": [" × ".join(map(str, spec.shape[1:])) for spec in specs],
        "cells": [prod(spec.shape) for spec in specs],
        "seconds": [setting.seconds for setting in settings],
        "share": [share.share for share in shares],
        "low": [share.low for share in shares],
        "high": [share.high for share in shares],
        "bytes": [setting.bytes for setting in settings],
        "frontier": frontier(settings, shares),
        "recommended": [i == chosen for i in range(len(settings))],
        "spec": [spec.model_dump_json() for spec in specs],
    }
    attrs: dict[str, Any] = {"points": shares[chosen].points, "seed": query.seed, "complete": True}
    limits = [f"a budget of {query.budget:g} s"] if settings[chosen].seconds > (query.budget or inf) else []
    limits += [f"a tolerance of {query.limit:g}"] if shares[chosen].high > (query.limit or 1.0) else []
    rule = f"no setting judged at fresh points surely keeps to {' and '.join(limits)}"
    notes = [f"{rule}; the nearest is recommended"] if limits else []
    notes += ["cells that a map fills in are judged as if computed"] if specs[0].fills_in else []
    attrs |= {"note": "; ".join(notes)} if notes else {}
    return dataset(variables(_ROWS, data), {}, attrs)


def draw(result: xarray.Dataset, figure: Figure) -> None:
    """Draw the share shown wrong over the time of each setting, with the frontier and the recommended one."""
    axes = figure.subplots()
    axes.set(xscale="log", xlabel="time (s)", ylabel="share of the plane shown wrong")
    order = np.argsort(result["seconds"].values)
    seconds, share, low, high = (result[name].values[order] for name in ("seconds", "share", "low", "high"))
    front = result["frontier"].values[order]
    errors = np.clip([share - low, high - share], 0.0, None)
    axes.errorbar(seconds, share, errors, fmt="o", zorder=1, color="0.6", ecolor="0.8", markersize=4)
    axes.plot(seconds[front], share[front], "o-", color=ATTRACTORS[0], markersize=5)
    for i in np.flatnonzero(result["recommended"].values):
        name = f"{result['effort'].values[i]}, {result['grid'].values[i]}"
        point = (result["seconds"].values[i], result["share"].values[i])
        axes.plot(*point, "o", color=ATTRACTORS[1], markersize=8)
        axes.annotate(name, point, (0, 10), textcoords="offset points", ha="right")
    axes.set_ylim(bottom=0.0)


VIEW: Final = View(
    "plan", "Plan of a sweep", None, PlanQuery, compute, lambda spec, query: Estimate({}), variables=_ROWS,
    rows="share", draw=draw,
)  # fmt: skip
