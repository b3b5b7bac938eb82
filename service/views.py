"""What the page looks at: a line of cells as points or as density, a plane of modes, one cell's motion.

The same arrays as `/diagram` and `/modes`, in a form that a slider can ask for many times a second.
"""

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from numpy.typing import NDArray
from pydantic import Field

from kernel.params import Outcome
from service import calls, lines, packing, queries, schemas, trajectories
from service.calls import TheJob, TheService
from service.errors import InvalidRequest
from service.jobs import JobRecord, JobState
from service.queries import Sweep
from service.schemas import LineQuery, ModesQuery, Number, Trajectory, problem_responses
from service.trajectories import TrajectorySpec

router = APIRouter(prefix="/v1/jobs/{job_id}")

#: Flights read for one view; more than are sent as points become density.
MAX_READ: Final = 16_000_000

_PACKED: Final[dict[str, Any]] = {"content": {packing.MEDIA_TYPE: {}}}

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


class CellQuery(schemas.Query):
    """A cell of the sweep, the nearest to the values given, and how closely to look."""

    gamma: Number | None = None
    omega: Number | None = None
    xi: Number | None = None
    direction: str | None = Field(None, description="rest, up or down; the sweep's first if left out")
    periods: Annotated[int, Field(ge=1, le=1000)] = 4
    samples: Annotated[int, Field(ge=1, le=trajectories.MAX_SAMPLES)] = 200


@router.get("/line", responses={200: _PACKED, **problem_responses(404, 413, 422)})
def line(
    service: TheService, job: TheJob, query: Annotated[LineViewQuery, Query()], request: Request
) -> Response:
    """One line of cells, packed (see service/packing.py): what became of each, and its flights.

    Up to `most` flights come as `flight_time`, cell after cell as `shown` counts them. More come as
    `density`: `height` rows (from `bottom` up) of `width` columns, how many flights fell where, up to 255.
    """
    found = read_line(calls.sweep(service, job), query, _reader(request, job))
    window = window_of(found, query)
    dense = len(found.flights) > query.most
    flights = {"density": density(found, window, query)} if dense else {"flight_time": found.flights}
    facts = {
        "along": query.along,
        "fixed": found.fixed,
        "direction": found.direction,
        "missing": int(np.count_nonzero(found.cells["outcome"] == Outcome.MISSING)),
        "points": len(found.flights),
        "highest": float(found.flights.max(initial=0.0)),
    }
    content = packing.packed(facts, {**found.cells, **flights})
    return packing.answer(content, squeeze=dense and _takes_gzip(request))


@router.get("/plane", responses={200: _PACKED, **problem_responses(404, 413, 422)})
def plane(
    service: TheService, job: TheJob, query: Annotated[ModesQuery, Query()], request: Request
) -> Response:
    """The mode map, packed: `outcome`, `bounces` and `periods`, row after row of Ω."""
    found = queries.modes(calls.sweep(service, job), query.xi, query.direction, service.settings.max_points)
    facts = {"xi": found.xi, "direction": found.direction, "complete": found.complete}
    content = packing.packed(facts, {"omega": found.omega, "gamma": found.gamma, **found.arrays})
    return packing.answer(content, squeeze=_takes_gzip(request))


@router.get("/trajectory", response_model=Trajectory, responses=problem_responses(404, 413, 422, 429))
def trajectory(service: TheService, job: TheJob, query: Annotated[CellQuery, Query()]) -> Response:
    """One cell of the sweep in motion: as it settles from rest, or from where the ramp left it."""
    sweep = calls.sweep(service, job)
    spec, state = _cell(sweep, query)
    one = spec.sweep()
    trajectories.check_cost(spec, one, service.settings.trajectory_seconds)
    with service.trajectories.turn():
        found = trajectories.compute(spec, one, state)
    return Response(trajectories.as_json(found), media_type="application/json")


@dataclass(frozen=True)
class Line:
    """n cells along one axis and their flights that count, cell after cell."""

    fixed: dict[str, float]
    direction: str
    cells: dict[str, NDArray[Any]]  # each (n,): values, shown, outcome, bounces, periods
    flights: NDArray[np.float32]  # (sum of shown,) rad


def _reader(request: Request, job: JobRecord) -> lines.Reader:
    """How a job's lines are read: of one that is done, together with those beside them."""
    if job.state is not JobState.DONE:
        return lines.read
    kept: lines.Lines = request.app.state.lines
    return partial(kept.read, chunk_shape=job.chunk_shape)


def read_line(sweep: Sweep, query: LineViewQuery, read: lines.Reader = lines.read) -> Line:
    """The line that a query names. Raises InvalidRequest, TooLarge."""
    spec = sweep.spec
    given = {"gamma": query.gamma, "omega": query.omega, "xi": query.xi}
    places = queries.fixed_places(spec, query.along, given)
    direction = queries.direction_of(spec, query.direction)
    values = spec.axis_values(query.along)
    what = f"{len(values):,} values of {query.along} × keep {spec.keep:,}"
    queries.check_points(len(values) * spec.keep, MAX_READ, what)
    found = read(sweep, query.along, direction, {axis: place for axis, (place, _) in places.items()})
    times = found["flight_time"]
    counts = np.arange(spec.keep) < found["flights"][:, None]
    counts &= times >= query.min_flight  # never true of NaN
    cells = {"values": values, "shown": np.count_nonzero(counts, axis=1).astype(np.int32)}
    cells |= {name: found[name] for name in ("outcome", "bounces", "periods")}
    fixed = {axis: value for axis, (_, value) in places.items()}
    return Line(fixed, direction, cells, times[counts])


class Window(NamedTuple):
    """What is looked at of a line; x in units of its axis, y in rad."""

    left: float
    right: float
    bottom: float
    top: float


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


def density(line: Line, window: Window, query: LineViewQuery) -> NDArray[np.uint8]:
    """(height, width) how many flights fall on each part of the window, 255 for more, low flights first."""
    warp = np.log if query.log else np.asarray
    left, right = float(warp(window.left)), float(warp(window.right))
    column = np.repeat(_bins(warp(line.cells["values"]), left, right, query.width), line.cells["shown"])
    row = _bins(line.flights, window.bottom, window.top, query.height)
    inside = (column >= 0) & (row >= 0)
    counts = np.bincount(row[inside] * query.width + column[inside], minlength=query.width * query.height)
    return np.minimum(counts, 255).astype(np.uint8).reshape(query.height, query.width)


def _first(given: float | None, otherwise: float) -> float:
    return float(otherwise) if given is None else given


def _bins(values: NDArray[Any], low: float, high: float, n: int) -> NDArray[np.int64]:
    """The bin of each value, the highest value in the last one; -1 outside."""
    if not high > low:
        return np.where(values == low, 0, -1)
    bins = np.floor((values - low) * (n / (high - low)))
    bins[values == high] = n - 1
    bins[(bins < 0) | (bins >= n)] = -1
    return bins.astype(np.int64)


def _cell(sweep: Sweep, query: CellQuery) -> tuple[TrajectorySpec, NDArray[np.float64] | None]:
    """What to compute of the cell nearest to the one asked for, and the state a ramp left it in."""
    spec = sweep.spec
    places = {axis: queries.place_of(spec, axis, getattr(query, axis)) for axis in ("xi", "omega", "gamma")}
    direction = queries.direction_of(spec, query.direction)
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
    found = queries.read(sweep, ("outcome", "end_state"), direction, places)
    if found["outcome"] == Outcome.MISSING:
        raise InvalidRequest.of("gamma", "this cell is not computed yet; a ramp reaches its cells in order")
    return np.asarray(found["end_state"])


def _takes_gzip(request: Request) -> bool:
    return "gzip" in request.headers.get("accept-encoding", "")
