"""What the model itself answers, without a job: one cell in motion."""

from typing import Annotated, Final, get_args

from fastapi import APIRouter, Query, Response

from service.api import parameters
from service.api.capacity import Cost, costly
from service.api.dependencies import JsonBody, ServiceDep
from service.api.routers.views import Dataset
from service.api.schemas import content, problem_responses
from service.formats import MEDIA_TYPES, DatasetFormat
from service.views import registry
from service.views.trajectory import BYTES_PER_SAMPLE, MAX_SAMPLES, TrajectorySpec, check_cost

router = APIRouter(prefix="/v1", tags=["model"])

_TRAJECTORY_BODY: Final = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/TrajectorySpec"}}},
    }
}


@router.post(
    "/trajectories",
    summary="Compute the motion of a cell",
    response_model=Dataset,
    responses={**content(*get_args(DatasetFormat)), **problem_responses(400, 408, 413, 415, 422, 429)},
    openapi_extra=_TRAJECTORY_BODY,
)
@costly(Cost(MAX_SAMPLES * BYTES_PER_SAMPLE), "trajectory")
def compute_trajectory(
    service: ServiceDep, body: JsonBody, query: Annotated[parameters.MotionQuery, Query()]
) -> Response:
    """One cell from rest, after `settle` plate periods, or from a start: plate, masses and contact force.

    The answer is the result `trajectory` of a job. Lengths are in plate amplitudes: the paper's zω²/g divided
    by Γ, as its Fig. 2 draws them.
    """
    spec = TrajectorySpec.from_json(body)
    check_cost(spec, service.settings.trajectory_seconds)
    found = service.background.run(registry.motion, spec, query.format)
    return Response(found, media_type=MEDIA_TYPES[query.format])
