"""The audit of a sweep: how many of its cells a reference would change (`worker.analysis.audit`)."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from math import inf, nan, prod
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
import xarray
from pydantic import Field

from kernel.params import Outcome
from service.errors import InvalidRequest
from service.views.selection import Stored, attractor_label, check_kernel
from service.views.variables import coordinate, dataset, row, variables
from service.views.view import Call, Estimate, Number, Query, View
from worker.analysis import audit
from worker.analysis.bisection import BOUNCING
from worker.analysis.intervals import ENDLESS, bounds, covered, percent
from worker.sweep import SweepSpec
from worker.sweep.plan import cell_seconds

#: By default a sample has the cells that cost SHARE of the sweep, within these limits.
FEWEST, MOST_BY_DEFAULT = 59, 200
SHARE: Final = 0.1
#: Cells computed again for each cell of the sample: with hard cells, points and thresholds.
HARD_AND_POINTS: Final = 2.5
#: By default a time stepper follows the cells that take these core-seconds, up to this many.
FOLLOWED, FOLLOWED_SECONDS = 10, 20.0
#: Cells of a sample within a budget: fewer say nothing, more would say little more.
FEWEST_AFFORDED, MOST_AFFORDED = 20, 2000
#: Of flights, rad, unless the specification or the query has another.
TOLERANCE: Final = 1e-3
#: Bytes of a cell in an answer.
_PER_CELL: Final = 400

_QUESTION: Final = (
    row("sampled", ("question",), "<i4", "cells drawn; for threshold pairs of cells, for area points"),
    row("changed", ("question",), "<i4", "drawn cells that the reference changes"),
    row("undecided", ("question",), "<i4", "drawn cells that the reference does not decide"),
    row("share", ("question",), "<f8", "share of all cells that the reference changes",
        comment="undecided cells count as unchanged"),
    row("low", ("question",), "<f8", "least share, with 99 % confidence"),
    row("high", ("question",), "<f8", "most, with 95 % confidence"),
    row("largest", ("question",), "<f8", "largest deviation of flights", "rad"),
    row("covered", ("question",), "<f8",
        "share of all cells within largest, aperiodic or filled in, at least, with 95 % confidence"),
)  # fmt: skip
_DEVIATION: Final = row(
    "deviation", ("coverage",), "<f8", "largest deviation of this share of all cells", "rad",
    comment="95 % confidence; within: aperiodic and filled-in cells, beyond: undecided; infinite: too few",
)  # fmt: skip
_OF_SWEEP: Final = (
    row(
        "outcomes", ("outcome", "true_outcome"), "<i4", "drawn cells by outcome, stored and of the reference"
    ),
    row("mode_stored", ("change",), "U", "outcome or mode, stored"),
    row("mode_reference", ("change",), "U", "outcome or mode of the reference"),
    row("mode_cells", ("change",), "<i4", "drawn cells with both"),
    row("cell_set", ("cell",), "U", "what the cell was drawn for"),
    row("cell_direction", ("cell",), "U", "direction of the sweep"),
    row("cell_gamma", ("cell",), "<f8", "Γ"),
    row("cell_omega", ("cell",), "<f8", "Ω"),
    row("cell_xi", ("cell",), "<f8", "ξ"),
    row("cell_stored", ("cell",), "U", "outcome or mode, stored"),
    row("cell_reference", ("cell",), "U", "outcome or mode of the reference"),
    row("cell_deviation", ("cell",), "<f8", "deviation of flights", "rad"),
    row("cell_undecided", ("cell",), "|b1", "whether the reference does not decide"),
    row("cells", (), "<i8", "cells of the sweep"),
    row("certified", (), "<f8", "share of the cells certified within the tolerance, not drawn for numerics"),
)

#: Shares of all cells for which the deviation is said.
COVERAGES: Final = (0.5, 0.9, 0.95, 0.99)

#: The questions, in order.
QUESTIONS: Final = (
    "rest", "outcome", "mode", "flights", "distribution", "label", "threshold", "area", "integrator",
)  # fmt: skip


class AuditQuery(Query):
    """The sample, and what counts as changed flights."""

    cells: Annotated[int, Field(ge=1, le=2_000)] | None = Field(
        None, description="cells of each sample; default: 59 to 200, as many as cost a tenth of the sweep"
    )
    followed: Annotated[int, Field(ge=0, le=200)] | None = Field(
        None, description="cells of a soft contact that a time stepper follows; default: up to ten"
    )
    seed: Annotated[int, Field(ge=0, lt=2**63, description="of the random sample")] = 0
    tolerance: Annotated[Number, Field(gt=0, le=10)] | None = Field(
        None, description="rad: flights that deviate by more have changed; default: that of auto, else 0.001"
    )


def compute(study: Stored[SweepSpec], query: AuditQuery, *parts: Mapping[str, Any]) -> xarray.Dataset:
    """How many cells a longer computation would change.

    Workers draw cells at random and compute them again: for `numerics` with the same contact, cell by cell,
    and windows ten times as long; for `model`, where the specification names a contact that the sweep
    approximates, with that one. On a ramp a cell starts again from the stored state of the cell before it.
    Cells that are certified within `tolerance` need no sample for `numerics`, which is drawn from the rest.
    `low` and `high` are exact bounds of the share of all cells, whatever it is; undecided cells count as
    right in one and as wrong in the other.

    The questions:

    - `rest`, `outcome`, `mode`: cells with another answer
    - `flights`: cells at rest or periodic whose flights deviate by more than `tolerance`
    - `distribution`: other cells whose quantiles of flights do, beyond their scatter; undecided with
      fewer than 16 flights, or where the sweep keeps only some of them, fewer than 32
    - `label`: cells with another label, in a sweep with exponents
    - `threshold`: thresholds on the grid with a cell that changes between rest and bouncing
    - `area`: points anywhere between the cells that are not what the nearest cell is
    - `integrator`: cells of a soft contact, at rest or periodic, that time steps, which share no closed
      form with the kernel, do not follow within `tolerance`

    Lists the cells that changed, also hard ones outside the samples: corners, and cells next to another
    mode.
    """
    table, sizes = table_of(parts), {name: parts[0][name] for name in audit.SIZES}
    answers = answers_of(study, query, table, sizes)
    certified = sizes["certified"] / sizes["cells"]
    both = len(answers) > 1
    numbers = np.array([[row.get(name, _NOT_ASKED) for name in QUESTIONS] for row in answers.values()])
    by_field = np.moveaxis(numbers if both else numbers[0], -1, 0)
    answered = dict(zip(_Answer._fields, by_field, strict=True))
    matrix = np.zeros((len(Outcome), len(Outcome)), np.int32)
    own = _drawn(table, "numerics")
    np.add.at(matrix, (own["outcome"], own["true_outcome"]), 1)
    of_sweep = {"outcomes": matrix, **_modes(own), "cells": sizes["cells"], "certified": certified}
    tolerance = _tolerance(study, query)
    listed = _changed_cells(study.spec, table, tolerance)
    against = ("against",) * both
    deviation = np.array([_deviations(_drawn(table, name), _sizes(sizes, name)) for name in answers])
    by_question = answered | {"deviation": deviation if both else deviation[0]}
    data = variables((*_QUESTION, _DEVIATION), by_question, against) | variables(_OF_SWEEP, of_sweep | listed)
    names = [outcome.name.lower() for outcome in Outcome]
    coords = {
        "against": coordinate("against", list(answers) if both else "numerics", long_name="judged against"),
        "question": coordinate("question", list(QUESTIONS), long_name="question"),
        "coverage": coordinate("coverage", COVERAGES, long_name="share of all cells", units="1"),
        "outcome": coordinate("outcome", names, long_name="outcome stored"),
        "true_outcome": coordinate("true_outcome", names, long_name="outcome computed again"),
    }
    attrs = {"sentence": _sentence(answers, deviation, certified, tolerance), "seed": query.seed,
             "tolerance": tolerance, "model": study.spec.model.kind, "complete": True}  # fmt: skip
    return dataset(data, coords, attrs)


def answers_of(
    study: Stored[SweepSpec], query: AuditQuery, table: "_Table", sizes: Mapping[str, Any]
) -> "dict[str, dict[str, _Answer]]":
    """The answers to all questions, against `numerics` and, if the sweep approximates a contact, `model`.

    table: arrays of FIELDS of the drawn cells. sizes: SIZES of the sweep.
    """
    drawn = {name: _drawn(table, name) for name in audit.SETS}
    tolerance = _tolerance(study, query)
    labelled = bool(study.spec.exponents)
    answers = {
        "numerics": _answers(drawn["numerics"], sizes, tolerance, labelled)
        | {
            "threshold": _of_thresholds(drawn["threshold"], sizes["thresholds"]),
            "area": _answer(_masks(drawn["area"], 0.0)["mode"], drawn["area"]["undecided"], ENDLESS),
            "integrator": _of_integrator(drawn["integrator"], sizes, tolerance),
        }
    }
    if _contact(study) is not None:
        answers["model"] = _answers(drawn["model"], _sizes(sizes, "model"), tolerance, labelled=False)
    return answers


def _drawn(table: "_Table", name: str) -> "_Table":
    own = table["set"] == audit.SETS.index(name)
    return {field: values[own] for field, values in table.items()}


def _sizes(sizes: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """SIZES of the sweep for a question: no certificate says that the contact is right."""
    return {**sizes, "certified": 0, "certified_error": 0.0} if name == "model" else sizes


class _Answer(NamedTuple):
    """The answer to one question: numbers of sampled cells, and the share of all cells."""

    sampled: int = 0
    changed: int = 0
    undecided: int = 0
    share: float = nan
    low: float = nan
    high: float = nan
    largest: float = nan
    covered: float = nan


_NOT_ASKED: Final = _Answer()

_Table = Mapping[str, Any]  # FIELDS as arrays (n,)


def table_of(parts: Sequence[Mapping[str, Any]]) -> _Table:
    """The cells of all parts: `repeats` at rest or periodic, deviations of -1 infinite, of -2 `unknown`."""
    dtypes = {"deviation": np.float64, "undecided": bool}
    columns = {name: [x for part in parts for x in part[name]] for name in audit.FIELDS}
    table = {name: np.array(column, dtypes.get(name)) for name, column in columns.items()}
    deviation = table["deviation"]
    table["unknown"] = deviation == -2.0
    table["repeats"] = np.isin(table["true_outcome"], (Outcome.AT_REST, Outcome.PERIODIC))
    deviation[deviation == -1.0] = np.inf
    deviation[table["unknown"]] = np.nan
    return table


def _masks(table: _Table, tolerance: float) -> dict[str, Any]:
    """Which cells have changed, by question."""
    outcome = table["outcome"] != table["true_outcome"]
    deviates = table["deviation"] > tolerance
    return {
        "rest": (table["outcome"] == Outcome.AT_REST) != (table["true_outcome"] == Outcome.AT_REST),
        "outcome": outcome,
        "mode": outcome
        | (table["bounces"] != table["true_bounces"])
        | (table["periods"] != table["true_periods"]),
        "flights": deviates & table["repeats"],
        "distribution": deviates & ~table["repeats"],
        "label": table["label"] != table["true_label"],
    }


def _answers(table: _Table, sizes: Mapping[str, Any], tolerance: float, labelled: bool) -> dict[str, _Answer]:
    """The answers of a random sample of the cells that are not certified, scaled to all cells."""
    rest = sizes["cells"] - sizes["certified"]
    weight, repeating = rest / sizes["cells"], table["repeats"]
    unknown = {"flights": table["unknown"] & repeating, "distribution": table["unknown"] & ~repeating}
    answers = {
        name: _answer(changed, table["undecided"] | unknown.get(name, False), rest, weight)
        for name, changed in _masks(table, tolerance).items()
        if labelled or name != "label"
    }
    largest = float(np.nanmax(table["deviation"][repeating], initial=sizes["certified_error"]))
    within = 1.0 - weight * (1.0 - covered(len(repeating), rest, int(_may_deviate(table).sum())))
    answers["flights"] = answers["flights"]._replace(largest=largest, covered=within)
    return answers


def _deviations(table: _Table, sizes: Mapping[str, Any]) -> list[float]:
    """The deviations, rad, within which COVERAGES of all cells lie, by a sample of the uncertified ones."""
    rest, sampled = sizes["cells"] - sizes["certified"], len(table["outcome"])
    weight = rest / sizes["cells"]
    deviation = np.where(table["repeats"], np.nan_to_num(table["deviation"], posinf=inf), 0.0)
    own = np.sort(np.where(_may_deviate(table), inf, deviation)).tolist()
    values = [sizes["certified_error"], *np.maximum(own, sizes["certified_error"]), inf]

    def share_within(number: int) -> float:
        return float(1.0 - weight * (1.0 - covered(sampled, rest, sampled - number)))

    return [values[bisect_left(range(sampled + 1), share, key=share_within)] for share in COVERAGES]


def _may_deviate(table: _Table) -> Any:
    """Which cells may deviate by anything: undecided ones, and repeating ones of unknown deviation."""
    return table["undecided"] | (table["unknown"] & table["repeats"])


def _modes(table: _Table) -> dict[str, list[Any]]:
    """The error matrix of modes, as its elements above 0."""
    pairs = Counter(zip(_mode_labels(table, ""), _mode_labels(table, "true_"), strict=True))
    return {
        "mode_stored": [stored for stored, _ in pairs],
        "mode_reference": [reference for _, reference in pairs],
        "mode_cells": list(pairs.values()),
    }


def _answer(changed: Any, undecided: Any, population: int, weight: float = 1.0) -> _Answer:
    """The answer of a sample. changed, undecided (n,): which of its cells are.

    population: number of cells from which it was drawn, the part `weight` of all.
    """
    sampled = len(changed)
    if not sampled:
        return _Answer(0, 0, 0, 0.0, 0.0, 0.0) if not population else _NOT_ASKED
    certain, doubtful = int(np.count_nonzero(changed & ~undecided)), int(np.count_nonzero(undecided))
    low, high = bounds(certain, certain + doubtful, sampled, population)
    return _Answer(sampled, certain, doubtful, weight * (certain / sampled), weight * low, weight * high)


def _of_thresholds(table: _Table, thresholds: int) -> _Answer:
    """The answer for thresholds. Both cells of a threshold have the same unit."""
    if not thresholds:
        return _NOT_ASKED
    bouncing = np.isin(table["outcome"], BOUNCING) != np.isin(table["true_outcome"], BOUNCING)
    units = np.unique(table["unit"])
    masks = (bouncing & ~table["undecided"], table["undecided"])
    changed, undecided = (np.isin(units, table["unit"][mask]) for mask in masks)
    return _answer(changed, undecided & ~changed, thresholds)


def _of_integrator(table: _Table, sizes: Mapping[str, Any], tolerance: float) -> _Answer:
    """The answer for cells at rest or periodic that a time stepper follows."""
    sampled, repeating = len(table["outcome"]), sizes["repeating"]
    if not sampled:
        return _NOT_ASKED
    weight = repeating / sizes["cells"]
    answer = _answer(_masks(table, tolerance)["flights"], table["undecided"], repeating, weight)
    largest = float(np.nanmax(table["deviation"], initial=0.0))
    return answer._replace(largest=largest, covered=weight * covered(sampled, repeating))


def _changed_cells(spec: SweepSpec, table: _Table, tolerance: float) -> dict[str, list[Any]]:
    masks = _masks(table, tolerance)
    changed = np.flatnonzero(masks["mode"] | masks["flights"] | masks["distribution"] | table["undecided"])
    named = {
        "cell_set": [audit.SETS[i] for i in table["set"]],
        "cell_direction": [spec.directions[i] for i in table["direction"]],
        **{f"cell_{axis}": table[axis] for axis in ("gamma", "omega", "xi")},
        "cell_stored": _mode_labels(table, ""),
        "cell_reference": _mode_labels(table, "true_"),
        "cell_deviation": table["deviation"],
        "cell_undecided": table["undecided"],
    }
    return {name: [values[i] for i in changed] for name, values in named.items()}


def _mode_labels(table: _Table, prefix: str) -> list[str]:
    fields = (table[f"{prefix}{name}"].tolist() for name in ("outcome", "bounces", "periods"))
    return [attractor_label(*mode) for mode in zip(*fields, strict=True)]


def _sentence(
    answers: Mapping[str, Mapping[str, _Answer]], deviations: Any, certified: float, tolerance: float
) -> str:
    """The audit in words; deviations: of COVERAGES for each of `answers`, (answers, coverages)."""
    sentences = []
    for (against, questions), deviation in zip(answers.items(), deviations, strict=True):
        mode, flights, others = (questions[name] for name in ("mode", "flights", "distribution"))
        is_part = against == "numerics" and certified
        begins = f"{percent(certified, upper=False)} % of the cells are certified; " if is_part else ""
        begins += "computed longer, " if against == "numerics" else "with the exact contact, "
        drawn = "others drawn" if is_part else "drawn"
        sentences.append(
            f"{begins}{_between(mode)} of the cells have another outcome or mode ({mode.changed} of "
            f"{mode.sampled} {drawn}), {_between(flights)} flights that repeat and deviate by more than "
            f"{tolerance:g} rad, {_between(others)} others whose distribution does"
        )
        finite = deviation[np.isfinite(deviation)]
        if finite.any():  # else no cell that repeats, or only such at rest
            share, most = f"{100.0 * COVERAGES[len(finite) - 1]:g} %", f"{1.05 * finite[-1]:.2g} rad"
            such = "if they have flights that repeat"  # a map's filled-in cells have none
            sentences[-1] += f", {share} of the cells, {such}, deviate by at most {most}"
    area, followed = (answers["numerics"][name] for name in ("area", "integrator"))
    if area.sampled:
        drawn = f"{area.changed} of {area.sampled} drawn"
        sentences.append(f"{_between(area)} of points between cells differ from the nearest cell ({drawn})")
    if followed.sampled:
        sentences.append(f"{followed.changed} of {followed.sampled} cells followed by time steps differ")
    return "; ".join(sentences)


def _between(answer: _Answer) -> str:
    """The bounds of a share in percent."""
    if answer.low == answer.high:
        return f"{100.0 * answer.high:.3g} %"
    low, high = percent(answer.low, upper=False), percent(answer.high, upper=True)
    return f"at most {high} %" if answer.low == 0.0 else f"{low} to {high} %"


def _tolerance(study: Stored[SweepSpec], query: AuditQuery) -> float:
    """Of flights, rad."""
    asked: float = getattr(study.submitted.model, "tolerance", TOLERANCE)  # of auto
    return asked if query.tolerance is None else query.tolerance


def _contact(study: Stored[SweepSpec]) -> Any:
    """The contact that a sweep approximates, for the question `model`; None if it computes that contact."""
    exact = study.submitted.model.exact
    return None if study.spec.model == exact else exact


def _cells(spec: SweepSpec, query: AuditQuery) -> int:
    if query.cells is not None:
        return query.cells
    seconds = prod(spec.shape) * cell_seconds(spec)
    by_cost = SHARE * seconds / (HARD_AND_POINTS * audit.reference_seconds(spec))
    return int(min(max(by_cost, FEWEST), MOST_BY_DEFAULT))


def _followed(spec: SweepSpec, query: AuditQuery) -> int:
    if query.followed is not None or not (seconds := audit.followed_seconds(spec)):
        return query.followed or 0
    return int(min(FOLLOWED_SECONDS / seconds, FOLLOWED))


def affordable(spec: SweepSpec, seconds: float) -> AuditQuery | None:
    """The audit without time steps that takes these core-seconds, by the table; None with too few cells."""
    cells = int(seconds / (HARD_AND_POINTS * audit.reference_seconds(spec)))
    # the table may be wrong by half, and more than all of a sweep's cells say nothing more
    many = max(MOST_BY_DEFAULT, min(cells // 2, prod(spec.shape), MOST_AFFORDED))
    return None if cells < FEWEST_AFFORDED else AuditQuery(cells=min(cells, many), followed=0)


def is_compiled(study: Stored[SweepSpec]) -> bool:
    """Whether an audit in this process compiles nothing, except for cells followed by time steps."""
    return all(audit.is_compiled(study.spec, contact) for contact in (None, _contact(study)))


def within(spec: SweepSpec, seconds: float) -> AuditQuery | None:
    """The audit that fits into these core-seconds, by the table: the usual one, a smaller one, or None."""
    usual = AuditQuery()
    return usual if _seconds(spec, usual) <= seconds else affordable(spec, seconds)


def _seconds(spec: SweepSpec, query: AuditQuery) -> float:
    """Core-seconds of an audit, by the table."""
    cells = HARD_AND_POINTS * _cells(spec, query) * audit.reference_seconds(spec)
    return cells + _followed(spec, query) * audit.followed_seconds(spec)


def estimate(spec: SweepSpec, query: AuditQuery) -> Estimate:
    """The cells of the sets. Raises InvalidRequest for more computing than one audit may take."""
    cells, seconds = _cells(spec, query), _seconds(spec, query)
    if seconds > audit.MAX_SECONDS:
        fitting = int(cells * audit.MAX_SECONDS / seconds)
        rule = f"{cells:,} cells take about {seconds:,.0f} core-seconds, the limit is {audit.MAX_SECONDS:g}"
        raise InvalidRequest.of("cells", f"{rule}: enough for {fitting:,}")
    looked = 3 * cells + 100
    return Estimate({"cell": looked}, memory=looked * _PER_CELL + prod(spec.shape), small=False)


def parts(study: Stored[SweepSpec], query: AuditQuery) -> Sequence[Call]:
    """The cells computed again. Raises InvalidRequest for a sweep that is not done, OutdatedJob."""
    check_kernel(study)
    if not study.complete:
        raise InvalidRequest("this job is not done: an audit is of a sweep with all its cells")
    spec, contact = study.spec, _contact(study)
    sample = (_cells(spec, query), _followed(spec, query), query.seed, _tolerance(study, query))
    return [(audit.look, spec, study.url, contact, *sample, part) for part in range(audit.PARTS)]


VIEW: Final = View(
    "audit", "Audit of a sweep", SweepSpec, AuditQuery, compute, estimate,
    variables=(*_QUESTION, _DEVIATION, *_OF_SWEEP), rows="share",
    printed=("share", "cell_stored"), parts=parts, kept=True,
)  # fmt: skip
