"""Room: which contact model is enough for a sweep: what `auto` means.

A sample of the sweep's own cells, or on a ramp of its own lines, is computed by the exact
contact the specification gives and by every cheaper model, and their flights are compared.
The cheapest model that holds the tolerance in 95 of 100 cells is taken. Costs are compared by
the fixed table of worker.plan and not by the clock, so that the same specification always
gets the same model. A task like any other: idempotent, and it returns a report.

One model for the whole sweep, never a mixture: its results would jump by the tolerance along a seam
that nobody could tell from a bifurcation, and a ramp cannot be handed from a ball to a spring, for the
ball has no elongation to carry on from. What rests on the plate is not followed whatever the model: its
end is in closed form (the modules of `kernel.models`), and the table counts such cells.
"""

import time
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.params import Line as Record
from kernel.params import Outcome
from worker.analysis.deviation import deviations, percentile
from worker.spec import AXES, SweepSpec
from worker.spec.axes import Strict
from worker.spec.contact_models import CONTACT_MODELS, Auto, Ball, Rigid, Soft
from worker.tasks import run_cells

#: Cells of a sample from rest; of a ramp, lines and cells along each of them.
CELLS: Final = 48
LINES: Final = 4
CELLS_ALONG: Final = 12

#: A lattice: point k of n lies in stratum k * LATTICE[axis] % n of every axis, each of which it
#: so visits once. The numbers have no factor in common with 48, 12 or 4, and of those that
#: have none they keep the points farthest apart.
LATTICE: Final = {"gamma": 1, "omega": 13, "xi": 43}

#: Plate periods of a sample's cell at most, however long the sweep's are.
MOST_SETTLE: Final = 2_000
MOST_OBSERVE: Final = 1_000
MOST_FLIGHTS: Final = 4_096

#: Flights shorter than the tolerance are not told from none, but no longer ones than this, rad.
MOST_MICRO_FLIGHT: Final = 0.1

HOLDS: Final = 95.0  # percent of the cells

_Array = NDArray[np.float64]


class Rung(Strict):
    """One model beside the exact one; deviations in rad, null where some cell rests that should not."""

    model: str
    cost: float  # core-microseconds a cell and plate period, by the fixed table
    measured: float | None  # the same, as it went just now
    median: float | None
    percentile_95: float | None
    cells: int  # compared
    resting: int = 0  # of them by this model on the plate throughout: answered in closed form


class Choice(Strict):
    """The model that was chosen, and why."""

    model: str
    reason: str
    tolerance: float
    table: tuple[Rung, ...]

    def lasting(self) -> dict[str, Any]:
        """All of it that is the same whenever the choice is made: no timings. Plain JSON values."""
        return self.model_dump(mode="json", exclude={"table": {"__all__": {"measured"}}})


class Line(NamedTuple):
    """Cells in the order they are visited, each array (n,)."""

    gamma: _Array
    omega: _Array
    xi: _Array


def choose(spec: SweepSpec) -> Choice:
    """Choose the model for a sweep whose own is `auto`."""
    auto = _auto(spec)
    lines = list(sample(spec))
    exact, _ = _run(_shortened(spec, auto.exact, settle_tolerance=0.0), lines)
    table = [_rung(spec, model, lines, exact) for model in _ladder(auto).values()]
    for rung in table:
        if rung.percentile_95 is not None and rung.percentile_95 <= auto.tolerance:
            return _choice(auto, table, rung)
    return _choice(auto, table, table[-1])


def is_open(spec: object) -> bool:
    """Whether a study is a sweep whose model has to be chosen."""
    return isinstance(spec, SweepSpec) and isinstance(spec.model, Auto)


def resolved(spec: SweepSpec, choice: Choice) -> SweepSpec:
    """The sweep with the model that was chosen for it; not the sweep's identity, which stays `auto`."""
    return spec.model_copy(update={"model": _ladder(_auto(spec))[choice.model]})


def sample(spec: SweepSpec) -> Iterator[Line]:
    """Some of the sweep's cells, spread evenly over all its axes: a line from rest, or a few along a ramp."""
    values = {axis: spec.axis_values(axis) for axis in AXES}
    ramp = spec.ramp_axis
    if ramp is None:
        places = sorted(set(_spread({axis: len(values[axis]) for axis in AXES}, CELLS)))
        table = np.array(
            [[values[axis][place] for axis, place in zip(AXES, cell, strict=True)] for cell in places]
        )
        yield Line(**{axis: np.ascontiguousarray(table[:, i]) for i, axis in enumerate(AXES)})
        return
    beside = {axis: 1 if axis == ramp else len(values[axis]) for axis in AXES}
    along = _along(spec, values[ramp])
    for cell in sorted(set(_spread(beside, LINES))):
        fixed = {axis: values[axis][place] for axis, place in zip(AXES, cell, strict=True)}
        yield Line(**{axis: along if axis == ramp else np.full(len(along), fixed[axis]) for axis in AXES})


def _along(spec: SweepSpec, values: _Array) -> _Array:
    """Some of a ramp's values in the order they are visited."""
    n = min(len(values), CELLS_ALONG)
    chosen = values[[_middle(k, n, len(values)) for k in range(n)]]
    runs = {"up": chosen, "down": chosen[::-1]}
    return np.concatenate([runs[direction] for direction in spec.directions])


def _spread(lengths: dict[str, int], n: int) -> Iterator[tuple[int, ...]]:
    """n places in a grid of these lengths, one in each n-th part of every axis."""
    for k in range(n):
        yield tuple(_middle(k * LATTICE[axis] % n, n, length) for axis, length in lengths.items())


def _middle(part: int, parts: int, length: int) -> int:
    return (2 * part + 1) * length // (2 * parts)


def _ladder(auto: Auto) -> dict[str, Soft | Rigid | Ball]:
    """The models to choose from, cheapest first."""
    ball, rigid = Ball(kind="ball"), Rigid(kind="rigid", restitution=auto.restitution)
    models: tuple[Soft | Rigid | Ball, ...] = (ball, rigid, auto.exact)
    return {
        model.kind: model for model in sorted(models, key=lambda model: CONTACT_MODELS[model.kind].cost_us)
    }


def _auto(spec: SweepSpec) -> Auto:
    if not isinstance(spec.model, Auto):
        raise TypeError(f"the sweep's model is {spec.model.kind}: there is nothing to choose")
    return spec.model


def _shortened(spec: SweepSpec, model: Soft | Rigid | Ball, settle_tolerance: float) -> SweepSpec:
    """The sweep as it is computed for comparison."""
    observe = min(spec.observe, MOST_OBSERVE)
    micro_flight = max(spec.micro_flight, min(_auto(spec).tolerance, MOST_MICRO_FLIGHT))
    return spec.model_copy(
        update={
            "model": model,
            "settle": min(spec.settle, MOST_SETTLE),
            "observe": observe,
            "keep": min(8 * observe, MOST_FLIGHTS),
            "micro_flight": micro_flight,
            "settle_tolerance": settle_tolerance,
        }
    )


def _run(spec: SweepSpec, lines: list[Line]) -> tuple[list[Record], float]:
    """The record of each line, and core-microseconds a cell and plate period."""
    gamma, omega, xi = (axis[:1] for axis in lines[0])
    run_cells(spec.model_copy(update={"settle": 0, "observe": 1}), gamma, omega, xi, None)  # compiles
    began = time.thread_time()
    records = [run_cells(spec, line.gamma, line.omega, line.xi, None) for line in lines]
    seconds = time.thread_time() - began
    cells = sum(len(line.gamma) for line in lines)
    return records, seconds / cells / (spec.settle + spec.observe) * 1e6


def _rung(spec: SweepSpec, model: Soft | Rigid | Ball, lines: list[Line], exact: list[Record]) -> Rung:
    run = _shortened(spec, model, spec.settle_tolerance)
    records, microseconds = _run(run, lines)
    found = np.concatenate(
        [deviations(one, other, run.micro_flight) for one, other in zip(exact, records, strict=True)]
    )
    compared = ~np.isnan(found)
    resting = np.concatenate([record.outcome for record in records])[compared] == Outcome.AT_REST
    found = found[compared]
    median, most = (percentile(found, percent) for percent in (50.0, HOLDS))
    cost = CONTACT_MODELS[model.kind].cost_us
    return Rung(
        model=model.kind, cost=cost, measured=round(microseconds, 3), median=median, percentile_95=most,
        cells=len(found), resting=int(np.count_nonzero(resting)),
    )  # fmt: skip


def _choice(auto: Auto, table: list[Rung], rung: Rung) -> Choice:
    within = rung.percentile_95 is not None and rung.percentile_95 <= auto.tolerance
    verdict = f"{rung.model}: the cheapest within {auto.tolerance:g} rad of exact soft in 95% of the cells"
    if not within:
        verdict = (
            f"{rung.model}: no model holds {auto.tolerance:g} rad in 95% of the cells, and this is the best"
        )
    seen = ", ".join(f"{one.model} {_said(one.percentile_95)}" for one in table)
    closed = f", {rung.resting} of them at rest, in closed form" if rung.resting else ""
    reason = f"{verdict} ({rung.cells} cells{closed}; 95th percentiles: {seen})"
    return Choice(model=rung.model, reason=reason, tolerance=auto.tolerance, table=tuple(table))


def _said(percentile: float | None) -> str:
    return "unbounded" if percentile is None else f"{percentile:.2g} rad"
