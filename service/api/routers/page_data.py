"""What the page draws: a line of cells as points or as density, a plane of modes.

The arrays of `/diagram` and `/modes` in a binary form, which a slider can request many times per second.
"""

import gzip
from typing import Annotated, Any, Final

from fastapi import APIRouter, Query, Request, Response

from service.api import dependencies, parameters
from service.api.capacity import Cost, costly
from service.api.dependencies import JobDep, ServiceDep
from service.api.schemas import problem_responses
from service.render import answers, binary
from service.render.answers import Answer
from service.views import modes
from service.views.selection import BASE_MEMORY, MAX_READ, needs_flights

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["page"])

#: Bytes of memory per flight of a line, and per cell of a plane.
_PER_FLIGHT: Final = 24
_PER_CELL: Final = 32

_PACKED: Final[dict[str, Any]] = {"content": {binary.MEDIA_TYPE: {}}}


def _line_cost(service: ServiceDep, job: JobDep, query: parameters.LineViewQuery, request: Request) -> Cost:
    spec = dependencies.sweep(service, job).spec
    flights = len(spec.axis_values(query.along)) * spec.keep
    points, pixels = min(flights, MAX_READ) * _PER_FLIGHT, query.width * query.height * 16
    taken = points + pixels * (flights > query.most)
    cost = dependencies.cost_of_read(service, job, taken, query.along)
    return cost._replace(memory=BASE_MEMORY + points + pixels)


@router.get(
    "/line",
    summary="Read a line of cells in binary form",
    responses={200: _PACKED, **problem_responses(404, 413, 422)},
)
@costly(_line_cost)
def get_line(
    service: ServiceDep, job: JobDep, query: Annotated[parameters.LineViewQuery, Query()], request: Request
) -> Response:
    """One line of cells in binary form: outcome and mode of each, and its flights.

    Up to `most` flights come as `flight_time`, cell after cell as `shown` counts them. More come as
    `density`: `height` rows (from `bottom` up) of `width` columns, flights per bin, at most 255.
    Very long lines are thinned to every n-th cell: `every`.
    """
    view = answers.View(
        query.left, query.right, query.bottom, query.top, query.log, query.width, query.height, query.most
    )
    sweep = dependencies.sweep(service, job)
    return _packed(
        service.background.run(answers.packed_line, sweep, dependencies.line(query), view), request
    )


def _plane_cost(service: ServiceDep, job: JobDep, query: parameters.PlaneViewQuery, request: Request) -> Cost:
    spec = dependencies.sweep(service, job).spec
    every = needs_flights(spec, query.min_flight)
    most = min(service.settings.max_points, MAX_READ // spec.keep if every else MAX_READ)
    cells = min(len(spec.axis_values("omega")) * len(spec.axis_values("gamma")), most)
    compared = modes.comparison_memory(spec) if query.hysteresis else 0
    memory = cells * (_PER_CELL + spec.keep * _PER_FLIGHT * every) + compared
    return dependencies.cost_of_read(service, job, memory, "omega", "gamma")


@router.get(
    "/plane",
    summary="Read a mode map in binary form",
    responses={200: _PACKED, **problem_responses(404, 413, 422)},
)
@costly(_plane_cost)
def get_plane(
    service: ServiceDep, job: JobDep, query: Annotated[parameters.PlaneViewQuery, Query()], request: Request
) -> Response:
    """The mode map, or a window of it, in binary form: `outcome`, `bounces` and `periods` in rows of Ω.

    Planes of more cells than one answer may hold are thinned: `every_gamma`, `every_omega`. With `hysteresis`
    as in `/modes`.
    """
    window = ((query.left, query.right), (query.bottom, query.top))
    limits = (service.settings.max_points, query.min_flight, query.hysteresis)
    plane = (query.xi, query.direction, *window, *limits)
    sweep = dependencies.sweep(service, job)
    return _packed(service.background.run(answers.packed_plane, sweep, *plane), request)


def _packed(answer: Answer, request: Request) -> Response:
    """The answer, compressed if that is worth it and the client accepts gzip.

    Points are not worth compressing: their lower bits are noise.
    """
    content, headers = answer.content, {"Vary": "Accept-Encoding", "Cache-Control": "no-cache"}
    if answer.dense and "gzip" in request.headers.get("accept-encoding", ""):
        content, headers = gzip.compress(content, 1), {**headers, "Content-Encoding": "gzip"}
    return Response(content, 200, headers, binary.MEDIA_TYPE)
