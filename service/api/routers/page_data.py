"""What the page looks at: a line of cells as points or as density, a plane of modes, one cell's motion.

The same arrays as `/diagram` and `/modes`, in a form that a slider can ask for many times a second.
"""

from dataclasses import dataclass
from typing import Annotated, Any, Final

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from numpy.typing import NDArray
from pydantic import Field

from kernel.params import Outcome
from service.api import dependencies, schemas
from service.api.dependencies import TheJob, TheService
from service.api.routers import model
from service.api.routers.model import TrajectorySpec
from service.api.schemas import LineQuery, Number, PlaneQuery, Trajectory, problem_responses
from service.errors import InvalidRequest
from service.render import binary
from service.results import diagram, mode_map
from service.results.density import Window, density
from service.results.diagram import Sweep

router = APIRouter(prefix="/v1/jobs/{job_id}")

#: What a line is made of.
LINE_ARRAYS: Final = ("flight_time", "flights", "outcome", "bounces", "periods")

_PACKED: Final[dict[str, Any]] = {"content": {binary.MEDIA_TYPE: {}}}

Pixels = Annotated[int, Field(ge=1, le=4096)]


class LineViewQuery(LineQuery):
    """A line, and the window of it that is looked at: in units of the axis, and in rad from below."""

    left: Number | None = None
    right: Number | None = None
    bottom: Number = 0.0
    top: Number | None = None
    log: bool = Field(False, description="whether columns go in equal ratios")
    width: Pixels = 800
    height: Pixels = 400
    most: Annotated[int, Field(ge=0, le=1_000_000, description="flights sent as points")] = 250_000


class PlaneViewQuery(PlaneQuery):
    """A plane, and the window of it that is looked at: left to right in Γ, bottom to top in Ω."""

    left: Number | None = None
    right: Number | None = None
    bottom: Number | None = None
    top: Number | None = None


class CellQuery(schemas.Query):
    """A cell of the sweep, the nearest to the values given, and how closely to look."""

    gamma: Number | None = None
    omega: Number | None = None
    xi: Number | None = None
    direction: str | None = Field(None, description="rest, up or down; the sweep's first if left out")
    periods: Annotated[int, Field(ge=1, le=1000)] = 4
    samples: Annotated[int, Field(ge=1, le=model.MAX_SAMPLES)] = 200


@router.get("/line", responses={200: _PACKED, **problem_responses(404, 413, 422)})
def line(
    service: TheService, job: TheJob, query: Annotated[LineViewQuery, Query()], request: Request
) -> Response:
    """One line of cells, packed (see service/render/binary.py): what became of each, and its flights.

    Up to `most` flights come as `flight_time`, cell after cell as `shown` counts them. More come as
    `density`: `height` rows (from `bottom` up) of `width` columns, how many flights fell where, up to 255.
    Of very long lines only every n-th cell comes: `every`.
    """
    found = read_line(dependencies.sweep(service, job), query)
    window = window_of(found, query)
    dense = len(found.flights) > query.most
    flights = {"density": _counted(found, window, query)} if dense else {"flight_time": found.flights}
    facts = {
        "along": query.along,
        "fixed": found.fixed,
        "direction": found.direction,
        "every": found.every,
        "missing": int(np.count_nonzero(found.cells["outcome"] == Outcome.MISSING)),
        "points": len(found.flights),
        "highest": float(found.flights.max(initial=0.0)),
    }
    content = binary.packed(facts, {**found.cells, **flights})
    return binary.answer(content, squeeze=dense and _takes_gzip(request))


@router.get("/plane", responses={200: _PACKED, **problem_responses(404, 413, 422)})
def plane(
    service: TheService, job: TheJob, query: Annotated[PlaneViewQuery, Query()], request: Request
) -> Response:
    """The mode map, or a window of it, packed: `outcome`, `bounces` and `periods`, row after row of Ω.

    Of more cells than one answer may hold only every n-th of both axes come: `every_gamma`, `every_omega`.
    """
    sweep = dependencies.sweep(service, job)
    gamma = _between(sweep.spec.axis_values("gamma"), query.left, query.right)
    omega = _between(sweep.spec.axis_values("omega"), query.bottom, query.top)
    every = diagram.thinning((len(omega), len(gamma)), 1, service.settings.max_points) or 1
    direction = diagram.direction_of(sweep.spec, query.direction)
    part = (slice(omega.start, omega.stop, every), slice(gamma.start, gamma.stop, every))
    found = mode_map.plane(sweep, query.xi, direction, mode_map.MODE_ARRAYS, *part)
    facts = {"xi": found.xi, "direction": direction, "complete": found.complete}
    facts |= {"every_gamma": every, "every_omega": every}
    content = binary.packed(facts, {"omega": found.omega, "gamma": found.gamma, **found.arrays})
    return binary.answer(content, squeeze=_takes_gzip(request))


@router.get("/trajectory", response_model=Trajectory, responses=problem_responses(404, 413, 422, 429))
def trajectory(service: TheService, job: TheJob, query: Annotated[CellQuery, Query()]) -> Response:
    """One cell of the sweep in motion: as it settles from rest, or from where the ramp left it."""
    sweep = dependencies.sweep(service, job)
    spec, state = _cell(sweep, query)
    one = spec.sweep()
    model.check_cost(spec, one, service.settings.trajectory_seconds)
    with service.trajectories.turn():
        found = model.compute(spec, one, state)
    return Response(model.as_json(found), media_type="application/json")


@dataclass(frozen=True)
class Line:
    """n cells along one axis and their flights that count, cell after cell."""

    fixed: dict[str, float]
    direction: str
    cells: dict[str, NDArray[Any]]  # each (n,): values, shown, outcome, bounces, periods
    flights: NDArray[np.float32]  # (sum of shown,) rad
    every: int  # the cells are every n-th of the axis


def read_line(sweep: Sweep, query: LineViewQuery) -> Line:
    """The line that a query names. Raises InvalidRequest."""
    spec = sweep.spec
    given = {"gamma": query.gamma, "omega": query.omega, "xi": query.xi}
    fixed = diagram.fixed_places(spec, query.along, given)
    direction = diagram.direction_of(spec, query.direction)
    values = spec.axis_values(query.along)
    every = diagram.thinning((len(values),), spec.keep, diagram.MAX_READ) or len(values)
    places = {axis: place for axis, (place, _) in fixed.items()} | {query.along: slice(None, None, every)}
    found = diagram.read(sweep, LINE_ARRAYS, direction, places)
    times = found["flight_time"]
    counts = np.arange(spec.keep) < found["flights"][:, None]
    counts &= times >= query.min_flight  # never true of NaN
    cells = {"values": values[::every], "shown": np.count_nonzero(counts, axis=1).astype(np.int32)}
    cells |= {name: found[name] for name in ("outcome", "bounces", "periods")}
    fixed_values = {axis: value for axis, (_, value) in fixed.items()}
    # In single precision, which is more than a screen shows.
    return Line(fixed_values, direction, cells, times[counts].astype(np.float32), every)


def window_of(line: Line, query: LineViewQuery) -> Window:
    """The window asked for, by default all of the line. Raises InvalidRequest for one that is no window."""
    values, highest = line.cells["values"], float(line.flights.max(initial=0.0))
    window = Window(
        _first(query.left, values[0]), _first(query.right, values[-1]),
        query.bottom, _first(query.top, max(highest, query.bottom)),
    )  # fmt: skip
    if query.log and window.left <= 0:
        raise InvalidRequest.of(
            "left", f"must be above 0 where columns go in equal ratios, not {window.left!r}"
        )
    if window.right < window.left:
        raise InvalidRequest.of("right", f"must not be below left, which is {window.left!r}")
    if window.top < window.bottom:
        raise InvalidRequest.of("top", f"must not be below bottom, which is {window.bottom!r}")
    return window


def _counted(line: Line, window: Window, query: LineViewQuery) -> NDArray[np.uint8]:
    """(height, width) how many flights fall on each part of the window, 255 for more, low flights first."""
    values, shown = line.cells["values"], line.cells["shown"]
    found = density(values, shown, line.flights, window, query.width, query.height, query.log)
    return np.minimum(found, 255).astype(np.uint8)


def _between(values: NDArray[np.float64], low: float | None, high: float | None) -> range:
    """Where on an axis the values between two lie; the one nearest to their middle if none does."""
    first, last = _first(low, values[0]), _first(high, values[-1])
    start = int(np.searchsorted(values, first, side="left"))
    stop = int(np.searchsorted(values, last, side="right"))
    nearest = int(np.argmin(np.abs(values - 0.5 * (first + last))))
    return range(start, stop) if start < stop else range(nearest, nearest + 1)


def _first(given: float | None, otherwise: float) -> float:
    return float(otherwise) if given is None else given


def _cell(sweep: Sweep, query: CellQuery) -> tuple[TrajectorySpec, NDArray[np.float64] | None]:
    """What to compute of the cell nearest to the one asked for, and the state a ramp left it in."""
    spec = sweep.spec
    places = {
        axis: diagram.nearest_index(spec, axis, getattr(query, axis)) for axis in ("xi", "omega", "gamma")
    }
    direction = diagram.direction_of(spec, query.direction)
    state = None
    if spec.ramp_axis is not None:
        state = _end_state(sweep, direction, {axis: place for axis, (place, _) in places.items()})
    asked = TrajectorySpec(
        **{axis: value for axis, (_, value) in places.items()},
        model=spec.model,
        settle=min(spec.settle, 1_000_000) if state is None else 0,
        periods=query.periods,
        samples=query.samples,
    )
    return asked, state


def _end_state(sweep: Sweep, direction: str, places: dict[str, int]) -> NDArray[np.float64]:
    found = diagram.read(sweep, ("outcome", "end_state"), direction, places)
    if found["outcome"] == Outcome.MISSING:
        raise InvalidRequest.of("gamma", "this cell is not computed yet; a ramp reaches its cells in order")
    return np.asarray(found["end_state"])


def _takes_gzip(request: Request) -> bool:
    return "gzip" in request.headers.get("accept-encoding", "")
