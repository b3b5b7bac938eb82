"""Branches of the cycles of a spring, in closed form or on a contact."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Any, Final, Literal

import numpy as np
import xarray
from pydantic import Field

from kernel.cycles.energy import energy
from kernel.cycles.events import Branch, Events, Kind, branch, branch_and_events, join_events, rows_of
from kernel.cycles.follow import RANGE
from kernel.params import Cell
from service.errors import InvalidRequest
from service.pictures import IDEAL, Figure, draw_cycles
from service.views import proofs
from service.views.selection import check_order
from service.views.springs.branches import (
    BALANCE,
    BRANCH,
    EVENTS,
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
from service.views.springs.queries import (
    GAMMA_MAX,
    ONLY_ALONG_GAMMA,
    ContactQuery,
    Gamma,
    Modes,
    grid_length,
    name_of,
    parse_modes,
)
from service.views.variables import coordinate
from service.views.view import AT_ONCE_SECONDS, SMALL_SECONDS, Call, Estimate, Number, Omega, View, Xi
from worker.analysis.cycles import CYCLE_SECONDS, FollowedCycles, follow_cycles
from worker.analysis.prediction import branch_seconds
from worker.orbits.specification import MAX_POINTS

WithDoubled = Annotated[bool, Field(description="branches of twice the period that begin at flips as well")]

#: Estimated branches of a mode on a contact, and limit on the core-seconds of an answer.
_FAMILIES: Final = 3
MAX_SECONDS: Final = 60.0

#: Core-seconds for counting a branch's folds and flips, times periods/omega.
_COUNT_SECONDS: Final = 0.3

#: Bytes of memory for a point of a branch, with those computed on the way to it.
_PER_POINT: Final = 4_000

#: Names of a window in a query. In this many rounds its steps are divided down to the rounding of numbers.
WINDOW: Final = ("start", "stop", "flight_start", "flight_stop")
_ROUNDS: Final = 10


class OrbitsQuery(ContactQuery):
    """A spring, its contact, and which of its branches to compute."""

    omega: Omega
    xi: Xi
    modes: Modes = "1-1,1-2"
    gamma_max: Gamma | None = Field(
        None, description=f"branches along gamma are cut above this Γ; default: {GAMMA_MAX:g}"
    )
    points: int = Field(
        400, ge=10, le=MAX_POINTS, description="points of a branch, about; with a `model`, at most, each way"
    )
    start: Annotated[Number | None, Field(description="lowest Γ of a window with `points` more")] = None
    stop: Annotated[Number | None, Field(description="highest Γ of the window")] = None
    flight_start: Annotated[Number | None, Field(description="rad, shortest flight of the window")] = None
    flight_stop: Annotated[Number | None, Field(description="rad, longest flight of the window")] = None
    energy: Annotated[bool, Field(description="the energy balance of every point as well")] = False
    prove: Annotated[bool, Field(description="whether all folds and flips are counted, with a proof")] = False
    along: Literal["gamma", "omega", "xi"] = Field(
        "gamma", description="what varies; of a model, omega or xi too, from half to twice its value"
    )
    gamma: Gamma | None = Field(None, description="where another varies")
    doubled: WithDoubled = False

    @property
    def has_window(self) -> bool:
        return any(getattr(self, name) is not None for name in WINDOW)


def parts(study: None, query: OrbitsQuery) -> Sequence[Call]:
    """The branches of each mode, on a contact; in closed form if together they exceed AT_ONCE_SECONDS."""
    plate, grids = query.contact(), _grids(query)
    if plate is None:
        return [(branch_and_events, *grid) for grid in grids] if _seconds(query) > AT_ONCE_SECONDS else []
    cell = Cell(query.gamma or query.gamma_max or GAMMA_MAX, query.omega, query.xi)
    value = getattr(cell, query.along)
    span = (RANGE[0], value) if query.gamma is None else (0.5 * value, 2.0 * value)
    modes = parse_modes(query.modes)
    return [(follow_cycles, plate, cell, k, query.along, span, query.points, query.doubled) for k in modes]


def _seconds(query: OrbitsQuery) -> float:
    """Core-seconds of the branches in closed form."""
    return sum(branch_seconds(*grid) for grid in _grids(query))


def _grids(query: OrbitsQuery) -> list[tuple[float, float, int, int]]:
    """Spring, plate periods and points of each branch."""
    return [(query.omega, query.xi, periods, query.points) for periods in parse_modes(query.modes)]


def compute(
    study: None, query: OrbitsQuery, *parts: tuple[Branch, Events] | FollowedCycles
) -> xarray.Dataset:
    """Branches of cycles of one bounce, and their events.

    They are stable and unstable, in closed form, on a rigid contact without restitution. A branch that
    leaves `gamma_max` and comes back is several pieces. Within a window, from `start` to `stop` and from
    `flight_start` to `flight_stop`, a branch is as smooth as a whole one without it. With `prove`,
    `event_complete` says whether all events of a kind were counted.

    With a `model`, workers follow the contact's own cycles from those of the closed form, some seconds at
    most once compiled. With rebound a branch may pass through numbers of `flights`; it also ends at the
    event `stick-vanishes`, `rest`, `below-surface` or `unknown-change`, or at `cut-off`, beyond the points
    asked for. Branches `along` omega or xi pass through the cycles that the contact has at `gamma`.
    `doubled` adds up to 12 branches of twice the period; `flight_time` then has all flights that count, the
    longest first.
    """
    plate = query.contact()
    parts = parts or tuple(_branch(*grid) for grid in _grids(query))
    branches: list[Any] = []
    events: list[Events] = []
    for part in parts:
        if isinstance(part, FollowedCycles):
            branches += part.branches
            events += part.events
        else:
            branches.append(_finer(*part, query) if query.has_window else part[0])
            events.append(part[1])
    gamma_max = query.gamma_max or GAMMA_MAX
    top = gamma_max if plate is None else np.inf  # followed branches end there, or are of one gamma
    kept = [rows_of(each, each.gamma <= top) for each in events]
    highest = gamma_max if query.along == "gamma" else np.inf
    pieces, on = pieces_below(branches, [(x.gamma, x.flight_time) for x in kept], highest)
    data = padded(OF_POINT, pieces) if not query.doubled else with_flights(pieces)
    if plate is not None:
        data |= padded(("flights", "cycle_state"), pieces)
    if query.energy:
        data |= padded(BALANCE, [energy(query.omega, query.xi, x.periods, x.flight_time) for x in pieces])
    data |= event_columns(join_events(kept)) | on
    if query.prove:
        complete = [proofs.of_events(e)[e.gamma <= top] for e in events]
        data |= columns("event", {"complete": np.concatenate(complete)})
    coords = of_branches(pieces)
    spring = {name for name in ("omega", "xi") if name != query.along}
    coords |= {name: coordinate(name, getattr(query, name)) for name in sorted(spring)}
    if query.along != "gamma":
        data |= padded((query.along,), pieces)
    model = IDEAL if plate is None else name_of(plate)
    return cycle_result(data, coords, model=model, along=query.along, gamma_max=gamma_max)


#: The last branches of a process are kept.
_branch = lru_cache(64)(branch_and_events)


def _finer(coarse: Branch, events: Events, query: OrbitsQuery) -> Branch:
    """The branch with up to twice the query's `points` more, those in its window.

    Steps that meet the window are divided until there are enough. Folds are points too: within a step Γ has
    then no extremum, so that its ends tell whether it meets the window.
    """
    omega, xi, periods = query.omega, query.xi, coarse.periods
    lowest, shortest = (-np.inf if x is None else x for x in (query.start, query.flight_start))
    highest, longest = (np.inf if x is None else x for x in (query.stop, query.flight_stop))
    times = np.union1d(coarse.flight_time, events.flight_time[events.kind == Kind.FOLD])
    begin, end = times[:-1], times[1:]
    for _ in range(_ROUNDS):
        gammas = [branch(omega, xi, periods, t).gamma for t in (begin, end)]
        meets = (np.minimum(*gammas) <= highest) & (np.maximum(*gammas) >= lowest)
        meets &= (begin <= longest) & (end >= shortest)
        begin, end = begin[meets], end[meets]
        if not 0 < len(begin) <= query.points // 2:
            break
        divided = np.linspace(begin, end, query.points // len(begin) + 1)
        begin, end = divided[:-1].ravel(), divided[1:].ravel()
    return branch(omega, xi, periods, np.union1d(times, np.concatenate([begin, end])))


def estimate(spec: None, query: OrbitsQuery) -> Estimate:
    """All points of the branches.

    Raises InvalidRequest for parameters that exclude each other, for a branch that is too long or does not
    exist, and above MAX_SECONDS.
    """
    lengths = [grid_length(*grid) + 2 * query.points * query.has_window for grid in _grids(query)]
    check_order(query, *WINDOW[:2], wide=True)
    check_order(query, *WINDOW[2:], wide=True)
    plate = query.contact()
    for name in ("energy", "prove", *WINDOW) if plate is not None else ():
        if (asked := getattr(query, name)) is not None and asked is not False:  # 0 is an end of a window
            raise InvalidRequest.of(name, "is of the closed form: leave out model")
    if query.doubled and plate is None:
        raise InvalidRequest.of("doubled", "needs a model; that of the closed form is rigid")
    if (query.along == "gamma") != (query.gamma is None):
        raise InvalidRequest.of("gamma", "is required where omega or xi varies, and not where gamma does")
    if query.along != "gamma" and plate is None:
        raise InvalidRequest.of("along", "must be gamma without a model")
    if query.along != "gamma" and query.gamma_max is not None:
        raise InvalidRequest.of("gamma_max", ONLY_ALONG_GAMMA.format(query.along))
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


def draw(result: xarray.Dataset, figure: Figure) -> None:
    draw_cycles(figure.subplots(), result)


VIEW: Final = View(
    "orbits", "Branches of a spring", None, OrbitsQuery, compute, estimate,
    variables=(
        *(ROWS[x] for x in (*OF_POINT, "flights", "cycle_state", *BALANCE, *BRANCH, "event_complete")),
        *EVENTS, ROWS["event_branch"],
    ),
    rows="gamma", printed=("points", "event_gamma"), parts=parts, draw=draw,
)  # fmt: skip
