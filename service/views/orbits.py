"""Branches of cycles: of a spring, in closed form or on a contact; and of the cycles to which cells settled.

Also the parameters and variables that branches share with curves. A branch or curve is a row along the first
dimension, padded beyond its last point.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from math import prod
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeVar

import numpy as np
import xarray
from numpy.typing import NDArray
from pydantic import Field

from kernel.cycles.energy import energy
from kernel.cycles.events import Branch, Events, branch_and_events, flight_times, join_events, rows_of
from kernel.cycles.roots import stretches
from kernel.params import Cell, KernelInputError
from service.errors import InvalidRequest, TooLarge
from service.pictures import IDEAL, draw_cycles
from service.views import proofs, selection
from service.views.variables import ENERGY, coordinate, dataset, row, variable
from service.views.view import (
    AT_ONCE_SECONDS,
    SMALL_SECONDS,
    Call,
    Estimate,
    FirstDirection,
    Number,
    Omega,
    Query,
    View,
    Xi,
)
from worker import store
from worker.analysis.cycles import (
    CYCLE_SECONDS,
    MAX_BRANCHES,
    POINTS,
    FollowedCycles,
    Skipped,
    follow_along,
    follow_cells,
    follow_cycles,
)
from worker.analysis.prediction import branch_seconds
from worker.orbits.schema import ARRAYS, KINDS
from worker.orbits.specification import DIMS, MAX_GRID, MAX_POINTS, Mode, OrbitsSpec, check_modes, read_mode
from worker.spec.contact_models import MAX_PENETRATION, MIN_PENETRATION, Rigid, Soft
from worker.spec.errors import BrokenRuleError, SpecInvalid
from worker.study import Array
from worker.study.layout import COORDINATES
from worker.sweep import AXES, SweepSpec

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Modes = Annotated[str, Field(max_length=200, description="bounces-periods, as 1-1,1-2; cycles of one bounce")]
#: Limit on Γ of branches and curves.
MAX_GAMMA: Final = 1e6
GammaMax = Annotated[
    Number, Field(gt=0, le=MAX_GAMMA, description="branches and curves are cut above this Γ")
]
WithEnergy = Annotated[bool, Field(description="the energy balance of every point as well")]
WithDoubled = Annotated[bool, Field(description="branches of twice the period that begin at flips as well")]

Record = TypeVar("Record", Branch, Events)

#: `violations` beyond the last point of a branch or curve.
MISSING_POINT: Final = 255
#: Variables of each branch, and of the energy balance of a cycle.
BRANCH: Final = ("branch_bounces", "branch_periods", "points")
BALANCE: Final = tuple(array.name for array in ENERGY)

#: Branches and estimates kept in a process; the least recently used ones are dropped.
KEPT: Final = 64

#: Real and imaginary part of both multipliers.
_PARTS: Final = {"multiplier": 2, "part": 2}


def _of_cycle(thing: str, what: str) -> tuple[Array, Array]:
    return (
        row(f"{thing}_bounces", (thing,), "<i4", f"bounces of the {what}"),
        row(f"{thing}_periods", (thing,), "<i4", f"plate periods of the {what}"),
    )


_STORED: Final = {array.name: array for array in ARRAYS}

#: The variables by name: those that a study of orbits stores, and others.
ROWS: Final[Mapping[str, Array]] = _STORED | {
    array.name: array
    for array in (
        _STORED["gamma"]._replace(attrs=COORDINATES["gamma"] | {"comment": "NaN: no point"}),
        _STORED["violations"]._replace(fill=MISSING_POINT, attrs=_STORED["violations"].attrs | {
            "comment": f"0: a cycle of the spring; {MISSING_POINT}: no point",
        }),
        row("multipliers", ("branch", "point", *_PARTS), "<f8", "Floquet multipliers, the larger first"),
        row("flights", ("branch", "point"), "<i4", "flights of the cycle; `flight_time` is the longest",
            comment="0: no point"),
        *ENERGY,
        *_of_cycle("branch", "cycles"),
        row("points", ("branch",), "<i4", "points of the branch"),
        row("curve_kind", ("curve",), "U", "kind of event"),
        *_of_cycle("curve", "cycles"),
        *(Array(axis, ("curve", "point"), "<f8", 0, COORDINATES[axis]) for axis in ("omega", "xi")),
        row("event_kind", ("event",), "U", "kind of event"),
        *(Array(f"event_{axis}", ("event",), "<f8", 0, COORDINATES[axis]) for axis in AXES[::-1]),
        row("event_multipliers", ("event", *_PARTS), "<f8", "Floquet multipliers"),
        row("event_branch", ("event",), "<i4", "index of the branch that the event is on"),
        row("event_complete", ("event",), "?", "whether all of its kind were counted, with proof"),
        Array("skipped_gamma", ("skipped",), "<f8", 0, COORDINATES["gamma"]),
        *_of_cycle("skipped", "cell from which no branch was followed"),
        row("skipped_reason", ("skipped",), "U", "why no branch was followed from the cell"),
    )
}  # fmt: skip
_EVENT: Final = (
    "kind", "gamma", "omega", "xi", "bounces", "periods", "flight_time", "violations", "multipliers",
)  # fmt: skip
EVENTS: Final = tuple(ROWS[f"event_{name}"] for name in _EVENT)


def padded(
    names: Sequence[str], records: Sequence[Any], dims: tuple[str, ...] = ("branch", "point")
) -> dict[str, xarray.Variable]:
    """Fields of all records as variables, padded to the longest record."""
    return {
        name: _padded(ROWS[name], [_field(record, name) for record in records],
                      (*dims, *_PARTS) if name == "multipliers" else dims)
        for name in names
    }  # fmt: skip


def _padded(about: Array, values: Sequence[NDArray[Any]], dims: tuple[str, ...]) -> xarray.Variable:
    """Arrays as the rows of a variable. Raises TooLarge."""
    lengths = [
        max((x.shape[i] for x in values), default=_PARTS.get(dim, 0)) for i, dim in enumerate(dims[1:])
    ]
    if (size := prod((len(values), *lengths))) > selection.MAX_READ:
        raise TooLarge(
            f"{len(values):,} of them, as long as the longest, hold {size:,} numbers; the limit is "
            f"{selection.MAX_READ:,}: take a shorter range, or fewer kinds or modes"
        )
    table = np.full((len(values), *lengths), np.nan if about.dtype == "<f8" else about.fill, about.dtype)
    for line, value in zip(table, values, strict=True):
        line[tuple(map(slice, value.shape))] = value
    return xarray.Variable(dims, table, dict(about.attrs))


def columns(thing: str, fields: Mapping[str, Any]) -> dict[str, xarray.Variable]:
    """Fields of a list of events, branches, curves or cells as variables."""
    names = {field: f"{thing}_{field}" for field in fields}
    return {name: variable((), fields[field], ROWS[name]) for field, name in names.items()}


def event_columns(events: Events) -> dict[str, xarray.Variable]:
    """Events as the variables EVENTS."""
    return columns("event", {name: _field(events, name) for name in _EVENT})


def _field(record: Any, name: str) -> NDArray[Any]:
    if name == "multipliers":
        return np.stack([record.multiplier.real, record.multiplier.imag], axis=-1)
    return np.asarray(getattr(record, name))


def of_branches(records: Sequence[Branch]) -> dict[str, xarray.Variable]:
    """Mode and number of points of each branch; the median where bounces change along it."""
    bounces = [int(np.median(x.bounces)) for x in records]
    lengths = {"bounces": bounces, "periods": [x.periods for x in records]}
    points = variable((), [len(x.gamma) for x in records], ROWS["points"])
    return {**columns("branch", lengths), "points": points}


def closed_form(
    data: Mapping[str, xarray.Variable], coords: Mapping[str, xarray.Variable], complete: bool = True,
    model: str = IDEAL, **attrs: Any,
) -> xarray.Dataset:  # fmt: skip
    """A result on branches or curves, with the attributes of all of them."""
    part = xarray.Variable(("part",), np.array(["real", "imaginary"]))
    return dataset(data, {**coords, "part": part}, {"model": model, **attrs, "complete": complete})


def parse_modes(text: str) -> tuple[Mode, ...]:
    """Modes of one bounce, written as bounces and plate periods: `1-1,1-2`. Raises InvalidRequest."""
    try:
        modes = [read_mode(part.strip()) for part in text.split(",")]
        check_modes(modes)
    except BrokenRuleError as error:
        raise InvalidRequest.of("modes", error.rule) from error
    return tuple(sorted(modes))


@lru_cache(KEPT)  # called several times for an answer
def grid_length(omega: float, xi: float, periods: int, points: int = 1) -> int:
    """Number of flight times of a branch. Raises InvalidRequest above MAX_GRID, and if there is no branch."""
    try:
        needed = len(flight_times(omega, xi, periods, points))
    except KernelInputError as error:
        raise InvalidRequest.of(error.argument, error.rule) from error
    if needed > MAX_GRID:
        rule = (
            f"1-{periods} at omega {omega:g} takes a branch of {needed:,} points; the limit is "
            f"{MAX_GRID:,}: ask for fewer periods, or take a larger omega"
        )
        raise InvalidRequest.of("modes", rule)
    return needed


def below(record: Record, gamma_max: float) -> list[Record]:
    """The connected parts of a branch or curve up to `gamma_max`."""
    return [rows_of(record, slice(*part)) for part in stretches(record.gamma <= gamma_max)]


#: Estimated branches of a mode on a contact, and limit on the core-seconds of an answer.
_FAMILIES: Final = 3
MAX_SECONDS: Final = 60.0

#: Core-seconds for counting a branch's folds and flips, times periods/omega.
_COUNT_SECONDS: Final = 0.3

#: Bytes of memory for a point of a branch, with those computed on the way to it.
_PER_POINT: Final = 4_000

_OF_POINT: Final = (
    "gamma", "flight_time", "takeoff_phase", "elongation", "elongation_velocity", "impact_velocity",
    "multipliers", "stable", "violations",
)  # fmt: skip


#: The contacts whose cycles are followed, and their parameters.
_CONTACTS: Final[Mapping[str, type[Rigid | Soft]]] = {"rigid": Rigid, "soft": Soft}
_OF_CONTACT: Final = ("restitution", "penetration", "adhesive")


class ContactQuery(Query):
    """The contact that the spring has."""

    model: Literal["rigid", "soft"] | None = Field(
        None, description="contact whose cycles are followed; default: the ideal plate in closed form"
    )
    restitution: Annotated[Number, Field(ge=0, lt=1)] | None = Field(None, description="of the model")
    penetration: Annotated[Number, Field(ge=MIN_PENETRATION, le=MAX_PENETRATION)] | None = Field(
        None, description="of a soft model, in plate amplitudes"
    )
    adhesive: Annotated[bool, Field(description="whether a soft model pulls before take-off")] = True


class OrbitsQuery(ContactQuery):
    """A spring, its contact, and which of its branches to compute."""

    omega: Omega
    xi: Xi
    modes: Modes = "1-1,1-2"
    gamma_max: GammaMax = 8.0
    points: int = Field(
        400, ge=10, le=MAX_POINTS, description="of each branch, about; of a `model`, at most, each way"
    )
    energy: WithEnergy = False
    prove: Annotated[bool, Field(description="whether all folds and flips are counted, with a proof")] = False
    along: Literal["gamma", "omega", "xi"] = Field(
        "gamma", description="what varies; of a model, omega or xi too, from half to twice its value"
    )
    gamma: Annotated[Number, Field(gt=0, le=MAX_GAMMA)] | None = Field(
        None, description="where another varies"
    )
    doubled: WithDoubled = False


def contact(query: ContactQuery) -> Rigid | Soft | None:
    """The contact whose cycles are followed; None for the closed form. Raises InvalidRequest."""
    given = query.model_dump(include={"model", *_OF_CONTACT}, exclude_defaults=True)
    if "model" not in given:
        if given:
            raise InvalidRequest.of("model", f"is required with {', '.join(given)}: rigid or soft")
        return None
    fields = _CONTACTS[given.pop("model")]
    try:
        return fields(**given)
    except SpecInvalid as error:
        raise InvalidRequest("; ".join(map(str, error.problems)), error.problems) from error


def name_of(plate: Rigid | Soft) -> str:
    """A contact and its parameters as text."""
    name = f"{plate.kind}, restitution {plate.restitution:g}"
    if isinstance(plate, Rigid):
        return name
    return f"{name}, penetration {plate.penetration:g}, {'adhesive' if plate.adhesive else 'not adhesive'}"


def orbit_parts(study: None, query: OrbitsQuery) -> Sequence[Call]:
    """The branches of each mode, on a contact; in closed form if together they exceed AT_ONCE_SECONDS."""
    plate, grids = contact(query), _grids(query)
    if plate is None:
        return [(branch_and_events, *grid) for grid in grids] if _seconds(query) > AT_ONCE_SECONDS else []
    if query.gamma is None:
        top = query.gamma_max
        return [(follow_cycles, plate, *spring, top, points, query.doubled) for *spring, points in grids]
    cell, value = Cell(query.gamma, query.omega, query.xi), getattr(query, query.along)
    span = 0.5 * value, 2.0 * value
    return [
        (follow_along, plate, cell, periods, query.along, span, points, query.doubled)
        for _, _, periods, points in grids
    ]


@lru_cache(KEPT)  # called several times for an answer
def _seconds(query: OrbitsQuery) -> float:
    """Core-seconds of the branches in closed form."""
    return sum(branch_seconds(*grid) for grid in _grids(query))


@lru_cache(KEPT)  # called several times for an answer
def _grids(query: OrbitsQuery) -> tuple[tuple[float, float, int, int], ...]:
    """Spring, plate periods and points of each branch."""
    return tuple((query.omega, query.xi, mode.periods, query.points) for mode in parse_modes(query.modes))


def compute_orbits(
    study: None, query: OrbitsQuery, *parts: tuple[Branch, Events] | FollowedCycles
) -> xarray.Dataset:
    """Branches of cycles of one bounce, and their events.

    Stable and unstable ones, in closed form, of the rigid contact without restitution. A branch that leaves
    `gamma_max` and comes back is several pieces. With `prove`, `event_complete` says whether none is missing.

    With a `model`, workers follow the contact's own cycles from those of the closed form, some seconds at
    most once compiled. With rebound a branch may pass through numbers of `flights`; it also ends at the
    event `stick-vanishes`, `rest`, `below-surface` or `unknown-change`, or at `cut-off`, beyond the points
    asked for. Branches `along` omega or xi pass through the cycles that the contact has at `gamma`. With
    `doubled`, up to 12 branches of twice the period, too, and `flight_time` has all flights that count, the
    longest first.
    """
    plate = contact(query)
    parts = parts or tuple(_branch(*grid) for grid in _grids(query))
    branches: list[Any] = []
    events: list[Events] = []
    for part in parts:
        branches += part.branches if isinstance(part, FollowedCycles) else part[:1]
        events += part.events if isinstance(part, FollowedCycles) else part[1:]
    top = max(query.gamma_max, query.gamma or 0.0)
    pieces = [piece for branch in branches for piece in below(branch, top)]
    data = padded(_OF_POINT, pieces) if not query.doubled else _with_flights(pieces)
    if plate is not None:
        data |= padded(("flights",), pieces)
    if query.energy:
        data |= padded(BALANCE, [energy(query.omega, query.xi, x.periods, x.flight_time) for x in pieces])
    data |= event_columns(join_events([rows_of(e, e.gamma <= top) for e in events]))
    if query.prove:
        complete = [proofs.of_events(e)[e.gamma <= top] for e in events]
        data |= columns("event", {"complete": np.concatenate(complete)})
    coords = of_branches(pieces)
    spring = {name for name in ("omega", "xi") if name != query.along}
    coords |= {name: coordinate(name, getattr(query, name)) for name in sorted(spring)}
    varies: dict[str, Any] = {}
    if query.along != "gamma":
        data |= padded((query.along,), pieces)
        varies = {"along": query.along}
    model = IDEAL if plate is None else name_of(plate)
    return closed_form(data, coords, model=model, **varies, gamma_max=query.gamma_max)


def _with_flights(branches: Sequence[Branch]) -> dict[str, xarray.Variable]:
    """The points of branches, with all flights in `flight_time`."""
    flights = padded(("flight_time",), branches, ("branch", "point", "flight"))
    return padded(_OF_CELLS, branches) | flights


_branch = lru_cache(KEPT)(branch_and_events)


def estimate_orbits(spec: None, query: OrbitsQuery) -> Estimate:
    """All points of the branches.

    Raises InvalidRequest for parameters that exclude each other, for a branch that is too long or does not
    exist, and above MAX_SECONDS.
    """
    lengths = [grid_length(*grid) for grid in _grids(query)]
    plate = contact(query)
    for name in ("energy", "prove") if plate is not None else ():
        if getattr(query, name):
            raise InvalidRequest.of(name, "is of the closed form: leave out model")
    if query.doubled and plate is None:
        raise InvalidRequest.of("doubled", "needs a model; that of the closed form is rigid")
    if (query.along == "gamma") != (query.gamma is None):
        raise InvalidRequest.of("gamma", "is required where omega or xi varies, and not where gamma does")
    if query.along != "gamma" and plate is None:
        raise InvalidRequest.of("along", "must be gamma without a model")
    if plate is not None:
        lengths = [2 * query.points] * (_FAMILIES * (1 + query.doubled) * len(lengths))
        seconds = _seconds(query) + sum(lengths) * CYCLE_SECONDS
        if seconds > MAX_SECONDS:
            rule = (
                f"their cycles take up to {seconds:.0f} core-seconds, the limit for one answer is "
                f"{MAX_SECONDS:g}: ask for fewer modes or points"
            )
            raise InvalidRequest.of("modes", rule)
    sizes = {"branch": len(lengths), "point": max(lengths), "multiplier": 2, "part": 2}
    small = plate is None and _seconds(query) <= SMALL_SECONDS and not query.prove
    seconds = sum(_COUNT_SECONDS * periods / omega for omega, _, periods, _ in _grids(query) if query.prove)
    return Estimate(sizes, memory=sum(lengths) * _PER_POINT, seconds=seconds, small=small)


def draw(result: xarray.Dataset, figure: "Figure") -> None:
    draw_cycles(figure.subplots(), result)


SPRING: Final = View(
    "orbits", "Branches of a spring", None, OrbitsQuery, compute_orbits, estimate_orbits,
    variables=(*(ROWS[x] for x in (*_OF_POINT, "flights", *BALANCE, *BRANCH, "event_complete")), *EVENTS),
    rows="gamma", printed=("points", "event_gamma"), parts=orbit_parts, draw=draw,
)  # fmt: skip


#: Γ at which followed branches are cut by default.
GAMMA_MAX: Final = 8.0
#: Estimated bytes of an answer.
_MEMORY: Final = 16 * 2**20
#: The branches of a line without a computed cell.
_NONE: Final = FollowedCycles((), ())

_OF_CELLS: Final = (*(name for name in _OF_POINT if name != "flight_time"), "flights")


class CellsQuery(Query):
    """The spring of the job nearest to the given values, and the direction whose cells are continued."""

    omega: Number | None = None
    xi: Number | None = None
    direction: FirstDirection = None
    gamma_max: Annotated[Number, Field(gt=0, le=MAX_GAMMA)] | None = Field(
        None, description="branches are cut above this Γ; default: 8, of a study of orbits its own"
    )
    doubled: WithDoubled = False


def contact_of(spec: SweepSpec) -> Rigid | Soft:
    """The contact of a sweep, if its cycles can be followed. Raises InvalidRequest."""
    rule = "cycles are followed of rigid and soft contacts"
    if not isinstance(spec.model, Rigid | Soft):
        raise InvalidRequest.of("model", f"{rule}; the sweep's is {spec.model.kind}")
    if isinstance(spec.model, Soft) and spec.model.rest_length is not None:
        raise InvalidRequest.of(
            "model", f"{rule} of one penetration; with a rest_length every cell has its own"
        )
    return spec.model


def _direction_and_spring(spec: SweepSpec, query: CellsQuery) -> tuple[str, dict[str, selection.GridValue]]:
    """Direction and spring of the cells. Raises InvalidRequest."""
    contact_of(spec)
    spring = selection.nearest_values(spec, query, ("omega", "xi"))
    return selection.directions_of(spec, query.direction)[0], spring


def cell_parts(study: selection.Stored[Any], query: CellsQuery) -> Sequence[Call]:
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
    direction, spring = _direction_and_spring(study.spec, query)
    indices = (study.spec.directions.index(direction), spring["xi"].index, spring["omega"].index)
    top = query.gamma_max or GAMMA_MAX
    return [(follow_cells, study.spec, study.url, *indices, top, study.complete, query.doubled)]


def compute_cells(
    study: selection.Stored[Any], query: CellsQuery, cycles: FollowedCycles = _NONE
) -> xarray.Dataset:
    """Branches of the cycles that cells settled to.

    Those along Γ, on their own contact, stable and unstable, with their events. A study of orbits has them
    stored; of a sweep workers follow them, some seconds at most once compiled. `flight_time` has all flights
    of a cycle that count, the longest first. `skipped` are the periodic cells from which no branch was
    followed. With `doubled`, up to 12 branches of twice the period to which no cell settled, too.
    """
    if isinstance(study.spec, OrbitsSpec):
        return _stored_branches(study, query)
    direction, spring = _direction_and_spring(study.spec, query)
    data = _with_flights(cycles.branches)
    data |= event_columns(join_events(cycles.events))
    on = np.repeat(np.arange(len(cycles.events)), [len(events.gamma) for events in cycles.events])
    data |= columns("event", {"branch": on})
    data |= columns("skipped", {name: [getattr(x, name) for x in cycles.skipped] for name in Skipped._fields})
    coords = of_branches(cycles.branches)
    coords |= {axis: coordinate(axis, point.value) for axis, point in spring.items()}
    coords |= {"direction": coordinate("direction", direction)}
    model = name_of(contact_of(study.spec))
    return closed_form(data, coords, study.complete, model, gamma_max=query.gamma_max or GAMMA_MAX)


def _stored_branches(study: selection.Stored[OrbitsSpec], query: CellsQuery) -> xarray.Dataset:
    """Branches and events of one spring of a study of orbits."""
    spec, top = study.spec, query.gamma_max or study.spec.gamma_max
    spring = selection.nearest_values(spec, query, DIMS)
    x = selection.read_stored(study, tuple(_STORED), {axis: point.index for axis, point in spring.items()})
    x["multiplier"] = np.stack([x["multiplier"], x["other_multiplier"]], axis=-1)
    one = np.ones(spec.points, np.int32)
    xi, omega = (np.full(spec.points, point.value) for point in spring.values())
    of_point = [name for name in Branch._fields if name in x]
    branches = [
        Branch(mode.periods, omega, xi, flights=one, bounces=one, **{name: x[name][i] for name in of_point})
        for i, mode in enumerate(spec.cycles)
    ]
    pieces = [piece for branch in branches for piece in below(branch, top)]
    shown = (x["event_kind"] > 0) & (x["event_gamma"] <= top)
    events = {name: x[f"event_{name}"][shown] for name in _EVENT if f"event_{name}" in x}
    events["kind"] = np.array(["", *KINDS])[events["kind"]]
    events |= {axis: np.full(int(shown.sum()), point.value) for axis, point in spring.items()}
    data = padded(_OF_POINT, pieces) | columns("event", events)
    coords = of_branches(pieces) | {axis: coordinate(axis, point.value) for axis, point in spring.items()}
    return closed_form(data, coords, study.is_complete(x["outcome"]), gamma_max=top)


def estimate_cells(spec: SweepSpec | OrbitsSpec, query: CellsQuery) -> Estimate:
    """The points of all branches that may be followed. Raises InvalidRequest if the job lacks the line."""
    if isinstance(spec, OrbitsSpec):
        for name in ("direction", "doubled"):
            if getattr(query, name):
                raise InvalidRequest.of(name, "is of the cells of a sweep; this study is of kind orbits")
        selection.nearest_values(spec, query, DIMS)
        return Estimate({"branch": len(spec.modes), "point": spec.points, "multiplier": 2, "part": 2})
    _direction_and_spring(spec, query)
    sizes = {"branch": MAX_BRANCHES * (1 + query.doubled), "point": 2 * POINTS, "multiplier": 2, "part": 2}
    return Estimate(sizes, memory=_MEMORY, small=False)


VIEW: Final = View(
    "orbits", "Branches of a job's cycles", SweepSpec | OrbitsSpec, CellsQuery, compute_cells, estimate_cells,
    variables=(
        *(ROWS[name] for name in (*_OF_CELLS, "flight_time", *BRANCH)),
        *EVENTS, ROWS["event_branch"], *(ROWS[f"skipped_{name}"] for name in Skipped._fields),
    ),
    rows="flight_time", printed=("points", "event_gamma", "skipped_gamma"), parts=cell_parts, draw=draw,
)  # fmt: skip
