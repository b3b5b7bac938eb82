"""Model selection for the contact model `auto`: the cheapest model within a tolerance of the exact one.

A random sample of the sweep's cells is computed with the exact contact of the specification and with every
cheaper model. Flight times are compared flight by flight in cells at rest or periodic, and by distribution in
others. A model is within the tolerance if two conditions hold: with 95 % confidence, by an exact bound, at
most MOST_BEYOND of all cells have flights beyond the tolerance; and no more distributions differ than between
two windows of one contact. On a ramp whole lines are compared, without a bound, because their cells depend on
each other.

Costs come from CONTACT_MODELS and not from the clock, so that a specification always gets the same model. One
model computes the whole sweep: results that jump between regions of different models look like a bifurcation.
"""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from kernel.params import Line, Outcome
from worker.analysis.deviation import deviations, percentile
from worker.analysis.intervals import ENDLESS, bounds, percent
from worker.spec.axes import Strict
from worker.spec.contact_models import CONTACT_MODELS, Auto, Ball, Rigid, Soft
from worker.spec.time_steps import Cells
from worker.sweep import AXES, SweepSpec
from worker.sweep.specification import UNTIL

#: Cells of a sample from rest; lines of a sample on ramps, and cells on each line.
CELLS: Final = 120
LINES: Final = 4
CELLS_ALONG: Final = 12

#: Rank-1 lattice: point k of n lies in stratum k * LATTICE[axis] % n of each axis, so that each stratum has
#: one point. The multipliers are coprime to LINES.
LATTICE: Final = {"gamma": 1, "omega": 13, "xi": 43}

#: Limits on the plate periods and flights of a sample's cells.
MAX_SETTLE: Final = 2_000
MAX_OBSERVE: Final = 1_000
MAX_FLIGHTS: Final = 4_096

#: Flights shorter than both the tolerance and this, rad, are ignored in the comparison.
MAX_MICRO_FLIGHT: Final = 0.1

#: Share of all cells, or of a ramp's sample, that may deviate by more than the tolerance.
MOST_BEYOND: Final = 0.05
#: Share of aperiodic cells whose distribution differs from that of their own next window, see `deviation`.
OWN_SCATTER: Final = 0.058
#: Probability that the bound of one model is too low; two models are judged against the exact one.
BELOW: Final = 0.025

_Array = NDArray[np.float64]


class ModelComparison(Strict):
    """One model compared with the exact contact, over a sample of the sweep's cells; deviations in rad."""

    model: str
    cost: float = Field(description="core-µs per cell per plate period, by the cost table, which decides")
    measured: float | None = Field(description="core-µs per cell per plate period, measured while choosing")
    median: float | None = Field(description="deviation of flight times; null where some cell has none")
    percentile_95: float | None
    cells: int
    drawn: int = Field(0, description="cells drawn, those whose exact run failed included")
    repeating: int = Field(0, description="cells at rest or periodic, compared flight by flight")
    beyond: int = Field(0, description="cells beyond the tolerance, of these and of those that failed")
    most: float | None = Field(
        None, description="largest share of all cells beyond it, with 95 % confidence; null on a ramp"
    )
    unlike: int = Field(0, description="other cells whose distributions differ by more than the tolerance")
    resting: int = Field(0, description="cells at rest on the plate throughout, computed in closed form")


class ModelChoice(Strict):
    """The model chosen for a sweep whose own is `auto`."""

    model: str
    reason: str
    tolerance: float
    table: tuple[ModelComparison, ...]

    def reproducible(self) -> dict[str, Any]:
        """The choice as plain JSON values, without the timings, which are not reproducible."""
        return self.model_dump(mode="json", exclude={"table": {"__all__": {"measured"}}})


def choose(spec: SweepSpec) -> ModelChoice:
    """Choose the model of a sweep whose model is `auto`. Raises TypeError for any other."""
    return chosen(spec, *compared(spec, list(sample(spec))))


def resolved(spec: SweepSpec, choice: ModelChoice) -> SweepSpec:
    """The sweep with the chosen model; the job keeps the id of the sweep with `auto`."""
    return spec.model_copy(update={"model": _candidates(_auto(spec))[choice.model]})


def sample(spec: SweepSpec) -> Iterator[Cells]:
    """A simple random sample of up to CELLS cells from rest, or up to LINES ramps spread over the axes."""
    values = {axis: spec.axis_values(axis) for axis in AXES}
    ramp = spec.ramp_axis
    if ramp is None:
        shape = spec.shape[1:]
        random = np.random.default_rng(int(spec.job_id(""), 16))
        cells = np.sort(random.choice(math.prod(shape), min(CELLS, math.prod(shape)), replace=False))
        chosen = zip(AXES, np.unravel_index(cells, shape), strict=True)
        yield Cells(**{axis: np.ascontiguousarray(values[axis][along]) for axis, along in chosen})
        return
    beside = {axis: 1 if axis == ramp else len(values[axis]) for axis in AXES}
    along = _along(spec, values[ramp])
    lattice = {
        tuple(_middle(k * LATTICE[axis] % LINES, LINES, n) for axis, n in beside.items())
        for k in range(LINES)
    }
    for indices in sorted(lattice):
        fixed = {axis: values[axis][i] for axis, i in zip(AXES, indices, strict=True)}
        yield Cells(**{axis: along if axis == ramp else np.full(len(along), fixed[axis]) for axis in AXES})


def _along(spec: SweepSpec, values: _Array) -> _Array:
    """Up to CELLS_ALONG values of a ramp for each direction, in the order of computing."""
    n = min(len(values), CELLS_ALONG)
    chosen = values[[_middle(k, n, len(values)) for k in range(n)]]
    runs = {"up": chosen, "down": chosen[::-1]}
    return np.concatenate([runs[direction] for direction in spec.directions])


def _middle(part: int, parts: int, length: int) -> int:
    return (2 * part + 1) * length // (2 * parts)


def _candidates(auto: Auto) -> dict[str, Soft | Rigid | Ball]:
    """The models to choose from by kind, cheapest first."""
    models: tuple[Soft | Rigid | Ball, ...] = (Ball(), Rigid(restitution=auto.restitution), auto.exact)
    ordered = sorted(models, key=lambda model: CONTACT_MODELS[model.kind].cost_us)
    return {model.kind: model for model in ordered}


def _auto(spec: SweepSpec) -> Auto:
    if not isinstance(spec.model, Auto):
        raise TypeError(f"the sweep's model is {spec.model.kind}: there is nothing to choose")
    return spec.model


def _shortened(spec: SweepSpec, model: Soft | Rigid | Ball) -> SweepSpec:
    """The sweep with another model, within the limits of a sample; its cells settle as those of the sweep."""
    observe, until = min(spec.observe, MAX_OBSERVE), min(spec.until or UNTIL, UNTIL)
    settle = spec.settle if spec.settle == "auto" else min(spec.settle, MAX_SETTLE)
    micro_flight = max(spec.micro_flight, min(_auto(spec).tolerance, MAX_MICRO_FLIGHT))
    windows = {"settle": settle, "observe": observe, "until": until, "keep": min(8 * observe, MAX_FLIGHTS)}
    return spec.model_copy(update={"model": model, "micro_flight": micro_flight, **windows})


def timed(spec: SweepSpec, lines: Sequence[Cells], least: float = 0.0) -> tuple[list[Line], float]:
    """The record of each line, and core-microseconds per cell per plate period.

    least: core-seconds for which runs are repeated, at least once. The shortest run counts, which other
    processes affect least.
    """
    from worker.sweep.task import run_cells  # noqa: PLC0415 - numba, where `choose` runs: in a worker

    run_cells(spec, [axis[:1] for axis in lines[0]], None)  # compiles
    shortest, total = math.inf, 0.0
    while not total > least:
        began = time.thread_time()
        records = [run_cells(spec, line, None) for line in lines]
        seconds = time.thread_time() - began
        shortest, total = min(shortest, seconds), total + seconds
    cells = sum(len(line.gamma) for line in lines)
    return records, shortest / cells / sum(spec.window) * 1e6


def compared(
    spec: SweepSpec, lines: Sequence[Cells]
) -> tuple[dict[str, tuple[float, _Array]], NDArray[np.uint8]]:
    """Compare every model, cheapest first, with the exact contact in the cells of the lines.

    Returns, by kind, core-microseconds per cell per plate period and the deviations (n,), rad; and the exact
    outcomes (n,).
    """
    auto = _auto(spec)
    exact, _ = timed(_shortened(spec, auto.exact), lines)
    models = {}
    for kind, model in _candidates(auto).items():
        run = _shortened(spec, model)
        records, microseconds = timed(run, lines)
        errors = [deviations(*pair, run.micro_flight) for pair in zip(exact, records, strict=True)]
        models[kind] = microseconds, np.concatenate(errors)
    return models, np.concatenate([record.outcome for record in exact])


def chosen(
    spec: SweepSpec, models: Mapping[str, tuple[float, _Array]], outcome: NDArray[np.uint8]
) -> ModelChoice:
    """The cheapest model within the tolerance, else the exact one, from the results of `compared`."""
    auto, table = _auto(spec), [_judged(spec, kind, *model, outcome) for kind, model in models.items()]
    row = next((row for row in table if _is_within(auto, row)), table[-1])
    # the ledger keeps the reason: its wording must not change
    within = f"within {auto.tolerance:g} rad of exact soft in {1.0 - MOST_BEYOND:.0%} of the cells"
    verdict = f"{row.model}: the cheapest {within}"
    if not _is_within(auto, row):
        verdict = f"{row.model}: no model is {within}, and this is the best"
    most = (
        "" if row.most is None else f", at most {percent(row.most, upper=True)} % of all with 95 % confidence"
    )
    flights = f"{row.beyond} of {row.drawn} cells drawn have flights beyond it{most}"
    others = f"{row.unlike} of {row.cells - row.repeating} aperiodic ones another distribution"
    percentiles = ", ".join(f"{model.model} {_in_rad(model.percentile_95)}" for model in table)
    reason = f"{verdict} ({flights}; {others}; 95th percentiles: {percentiles})"
    return ModelChoice(model=row.model, reason=reason, tolerance=auto.tolerance, table=tuple(table))


def _judged(
    spec: SweepSpec, kind: str, microseconds: float, errors: _Array, outcome: NDArray[np.uint8]
) -> ModelComparison:
    """A row of the table, from a model's deviations `errors` (n,) and the exact outcomes (n,) of a sample."""
    compared = ~np.isnan(errors)
    repeating = np.isin(outcome, (Outcome.AT_REST, Outcome.PERIODIC))
    differs = ~(errors <= _auto(spec).tolerance)
    # a cell whose exact run failed may be beyond the tolerance; one that bounces by one contact alone is
    surely = repeating | np.isinf(errors)
    beyond = int(np.count_nonzero(differs & (surely | ~compared)))
    most = None
    if spec.ramp_axis is None:
        most = bounds(beyond, beyond, len(errors), math.prod(spec.shape), below=BELOW)[1]
    return ModelComparison(
        model=kind, cost=CONTACT_MODELS[kind].cost_us, measured=round(microseconds, 3),
        median=percentile(errors[compared], 50.0), percentile_95=percentile(errors[compared], 95.0),
        cells=int(np.count_nonzero(compared)), drawn=len(errors), beyond=beyond, most=most,
        repeating=int(np.count_nonzero(repeating)),
        unlike=int(np.count_nonzero(differs & compared & ~surely)),
        resting=int(np.count_nonzero(outcome == Outcome.AT_REST)),
    )  # fmt: skip


def _is_within(auto: Auto, row: ModelComparison) -> bool:
    if row.most is None:
        return row.percentile_95 is not None and row.percentile_95 <= auto.tolerance
    others = row.cells - row.repeating
    unlike, _ = bounds(row.unlike, row.unlike, others, ENDLESS)
    return row.most <= MOST_BEYOND and (others == 0 or unlike <= OWN_SCATTER)


def _in_rad(percentile: float | None) -> str:
    return "unbounded" if percentile is None else f"{percentile:.2g} rad"
