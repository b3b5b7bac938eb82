"""Branches of the cycles to which the cells of a job settled."""

from collections.abc import Sequence
from typing import Annotated, Any, Final, Literal

import numpy as np
import xarray
from pydantic import Field

from kernel.cycles.events import Branch, join_events
from kernel.cycles.follow import RANGE
from service.errors import InvalidRequest
from service.views import selection
from service.views.springs import orbits as of_spring
from service.views.springs.branches import (
    BRANCH,
    EVENT_FIELDS,
    EVENTS,
    OF_CELLS,
    OF_POINT,
    ROWS,
    columns,
    cycle_result,
    event_columns,
    of_branches,
    padded,
    pieces_below,
    with_flights,
)
from service.views.springs.queries import GAMMA_MAX, ONLY_ALONG_GAMMA, Gamma, name_of
from service.views.variables import coordinate
from service.views.view import Call, Estimate, Number, Query, View
from worker import store
from worker.analysis.cycles import MAX_BRANCHES, POINTS, FollowedCycles, Skipped, follow_cells
from worker.orbits.schema import ARRAYS, KINDS
from worker.orbits.specification import DIMS, OrbitsSpec
from worker.spec.contact_models import Rigid, Soft, Stepped
from worker.sweep import AXES, SweepSpec

#: Estimated bytes of an answer.
_MEMORY: Final = 16 * 2**20
_OF_SKIPPED: Final = Skipped._fields[1:]
#: The branches of a line without a computed cell.
_NONE: Final = FollowedCycles((), ())


class CellsQuery(Query):
    """The line of the job nearest to the given values, and the direction whose cells are continued."""

    omega: Number | None = None
    xi: Number | None = None
    direction: Annotated[str | None, Field(description="rest, up or down; default: all of the sweep")] = None
    gamma_max: Gamma | None = Field(
        None, description="branches are cut above this Γ; default: 8, of a study of orbits its own"
    )
    doubled: of_spring.WithDoubled = False
    along: Literal["gamma", "omega", "xi"] = Field("gamma", description="what varies on the branches")
    gamma: Number | None = None


def contact_of(spec: SweepSpec) -> Rigid | Soft:
    """The contact of a sweep, solved exactly, if its cycles can be followed. Raises InvalidRequest."""
    rule = "cycles are followed of rigid, soft and stepped contacts"
    if not isinstance(spec.model, Rigid | Soft | Stepped):
        raise InvalidRequest.of("model", f"{rule}; the sweep's is {spec.model.kind}")
    contact: Rigid | Soft = spec.model.exact
    if isinstance(contact, Soft) and contact.rest_length is not None:
        raise InvalidRequest.of(
            "model", f"{rule} of one penetration; with a rest_length every cell has its own"
        )
    return contact


def _line(spec: SweepSpec, query: CellsQuery) -> tuple[tuple[str, ...], dict[str, selection.GridValue]]:
    """Directions of the cells, and what they have in common. Raises InvalidRequest."""
    contact_of(spec)
    fixed = selection.fixed_axes(spec, query)
    return selection.directions_of(spec, query.direction), fixed


def parts(study: selection.Stored[Any], query: CellsQuery) -> Sequence[Call]:
    """The branches of one line of a sweep; none if nothing is stored yet.

    Raises OutdatedJob for a sweep of another kernel version, whose states this release does not continue.
    """
    if isinstance(study.spec, OrbitsSpec):
        return []
    selection.check_kernel(study)
    try:
        store.stored_forms(study.url, study.forms)  # checks the store
    except store.StoreMissing as error:
        if study.begun:
            raise store.StoreDamaged(str(error)) from error
        return []
    spec = study.spec
    directions, fixed = _line(spec, query)
    axes = [fixed[axis].index for axis in AXES if axis in fixed]
    lines = tuple((spec.directions.index(direction), *axes) for direction in directions)
    values = spec.axis_values(query.along)
    span = 0.5 * float(values[0]), 2.0 * float(values[-1])
    if query.along == "gamma":
        span = RANGE[0], query.gamma_max or GAMMA_MAX
    return [(follow_cells, spec, study.url, query.along, lines, span, study.complete, query.doubled)]


def compute(
    study: selection.Stored[Any], query: CellsQuery, cycles: FollowedCycles = _NONE
) -> xarray.Dataset:
    """Branches of the cycles that cells settled to.

    They run along an axis, on the cells' own contact, stable and unstable, with their events. A study of
    orbits stores them, along Γ; those of a sweep are followed by workers, within seconds once compiled.
    `flight_time` has all flights of a cycle that count, the longest first. `skipped` are the periodic cells
    from which no branch was followed. `doubled` adds up to 12 branches of twice the period to which no cell
    settled.
    """
    if isinstance(study.spec, OrbitsSpec):
        return _stored_branches(study, query)
    directions, fixed = _line(study.spec, query)
    data = with_flights(cycles.branches)
    if query.along != "gamma":
        data |= padded((query.along,), cycles.branches)
    places = [(events.gamma, events.flight_time) for events in cycles.events]
    data |= event_columns(join_events(cycles.events)) | pieces_below(cycles.branches, places, np.inf)[1]
    skipped = [{query.along: getattr(x.cell, query.along), **x._asdict()} for x in cycles.skipped]
    data |= columns("skipped", {name: [x[name] for x in skipped] for name in (query.along, *_OF_SKIPPED)})
    coords = of_branches(cycles.branches)
    coords |= {axis: coordinate(axis, point.value) for axis, point in fixed.items() if axis != "gamma"}
    coords |= {"direction": coordinate("direction", directions[0])} if len(directions) == 1 else {}
    about = {"model": name_of(contact_of(study.spec)), "along": query.along}
    return cycle_result(data, coords, study.complete, **about, gamma_max=query.gamma_max or GAMMA_MAX)


def _stored_branches(study: selection.Stored[OrbitsSpec], query: CellsQuery) -> xarray.Dataset:
    spec, top = study.spec, query.gamma_max or study.spec.gamma_max
    spring = selection.nearest_values(spec, query, DIMS)
    x = selection.read_stored(
        study, tuple(array.name for array in ARRAYS), {axis: point.index for axis, point in spring.items()}
    )
    x["multiplier"] = np.stack([x["multiplier"], x["other_multiplier"]], axis=-1)
    one = np.ones(spec.points, np.int32)
    xi, omega = (np.full(spec.points, point.value) for point in spring.values())
    of_point = [name for name in Branch._fields if name in x]
    branches = [
        Branch(periods, omega, xi, flights=one, bounces=one, **{name: x[name][i] for name in of_point})
        for i, periods in enumerate(spec.periods)
    ]
    shown = (x["event_kind"] > 0) & (x["event_gamma"] <= top)
    of_branch = [shown & (x["event_periods"] == periods) for periods in spec.periods]
    places = [(x["event_gamma"][own], x["event_flight_time"][own]) for own in of_branch]
    pieces, on = pieces_below(branches, places, top)
    events = {name: x[f"event_{name}"][shown] for name in EVENT_FIELDS if f"event_{name}" in x}
    events["kind"] = np.array(["", *KINDS])[events["kind"]]
    events |= {axis: np.full(int(shown.sum()), point.value) for axis, point in spring.items()}
    data = padded(OF_POINT, pieces) | columns("event", events) | on
    coords = of_branches(pieces) | {axis: coordinate(axis, point.value) for axis, point in spring.items()}
    return cycle_result(data, coords, study.is_complete(x["outcome"]), gamma_max=top)


def estimate(spec: SweepSpec | OrbitsSpec, query: CellsQuery) -> Estimate:
    """The points of all branches that may be followed. Raises InvalidRequest if the job lacks the line."""
    if isinstance(spec, OrbitsSpec):
        for name in ("direction", "doubled", "gamma", "along"):
            if getattr(query, name) not in (None, False, "gamma"):
                raise InvalidRequest.of(name, "is of the cells of a sweep; this study is of kind orbits")
        selection.nearest_values(spec, query, DIMS)
        return Estimate({"branch": len(spec.modes), "point": spec.points, "multiplier": 2, "part": 2})
    _line(spec, query)
    if query.along != "gamma" and query.gamma_max is not None:
        raise InvalidRequest.of("gamma_max", ONLY_ALONG_GAMMA.format(query.along))
    sizes = {"branch": MAX_BRANCHES * (1 + query.doubled), "point": 2 * POINTS, "multiplier": 2, "part": 2}
    return Estimate(sizes, memory=_MEMORY, small=False)


VIEW: Final = View(
    "orbits", "Branches of a job's cycles", SweepSpec | OrbitsSpec, CellsQuery, compute, estimate,
    variables=(
        *(ROWS[name] for name in (*OF_CELLS, "cycle_state", "flight_time", *BRANCH)),
        *EVENTS, ROWS["event_branch"], *(ROWS[f"skipped_{name}"] for name in ("gamma", *_OF_SKIPPED)),
    ),
    rows="flight_time", printed=("points", "event_gamma", "skipped_gamma"), parts=parts, draw=of_spring.draw,
)  # fmt: skip
