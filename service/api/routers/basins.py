"""Endpoints of basins of attraction."""

from typing import Annotated, Final

from fastapi import APIRouter, Query, Response

from service.api import dependencies, parameters, schemas
from service.api.capacity import costly
from service.api.conditional import NOT_MODIFIED, ConditionalRoute, ResultsJob
from service.api.dependencies import ServiceDep
from service.api.schemas import content, problem_responses
from service.formats import MEDIA_TYPES, PICTURES
from service.jobs.model import JobRecord
from service.render import answers
from service.results.selection import BASE_MEMORY

router = APIRouter(prefix="/v1/jobs/{job_id}", route_class=ConditionalRoute)

#: Bytes of memory per start, with its id as text.
_PER_START: Final = 64


def _memory(service: ServiceDep, job: JobRecord, query: parameters.BasinQuery) -> int:
    plane = dependencies.basins(service, job).spec.protocol
    return BASE_MEMORY + plane.rows * plane.columns * _PER_START


@router.get(
    "/basins",
    summary="Read the basin of a cell",
    response_model=schemas.BasinView,
    responses={**content("json", *PICTURES), **NOT_MODIFIED, **problem_responses(404, 422)},
)
@costly(_memory)
def basins(
    service: ServiceDep, job: ResultsJob, query: Annotated[parameters.BasinQuery, Query()]
) -> Response:
    """The attractors of one cell, and which of them each start of the plane reaches.

    Of a job with the protocol `basin`. Attractors are numbered from 1 by the share of the starts that reach
    them; 0 in the map is a start without one. `complete` tells whether the cell is computed. As a picture,
    every start has the colour of its attractor.
    """
    place = (query.gamma, query.omega, query.xi)
    answer = service.background.run(answers.basin, dependencies.basins(service, job), place, query.format)
    headers = {"Bounce-Complete": "true" if answer.complete else "false"}
    return Response(answer.content, media_type=MEDIA_TYPES[query.format], headers=headers)
