"""What the model itself answers, without a job: thresholds, one cell in motion."""

from typing import Annotated, Final

from fastapi import APIRouter, Query, Response

from service.api import parameters, schemas
from service.api.capacity import costly
from service.api.dependencies import JsonBody, ServiceDep
from service.api.schemas import PENDING_RESPONSE, problem_responses
from service.formats import MEDIA_TYPES
from service.render import answers
from service.render import orbits as orbits_text
from service.results import orbits
from service.results import trajectory as trajectories
from service.results.selection import BASE_MEMORY
from service.results.trajectory import BYTES_PER_SAMPLE, MAX_SAMPLES, TrajectorySpec

router = APIRouter(prefix="/v1", tags=["model"])

_TRAJECTORY_BODY: Final = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/TrajectorySpec"}}},
    }
}


@router.get(
    "/threshold",
    summary="Compute the thresholds of a spring",
    response_model=schemas.Threshold,
    responses={**PENDING_RESPONSE, **problem_responses(422, 429, 503)},
)
@costly(BASE_MEMORY, "trajectory")
def get_threshold(service: ServiceDep, query: Annotated[parameters.ThresholdQuery, Query()]) -> Response:
    """Γ_th of Eq. 25, above which a spring at rest begins to bounce; where flights leap, and bouncing ends.

    In closed form, of the rigid contact without restitution. `down` is the lowest Γ at which anything bounces
    for ever, by a rule that no search contradicts at its damping: `not searched` below that. A slow descent
    ends there or earlier, where the cycle that it is on ends.
    A worker computes what takes longer than a second; until then 202.
    """
    found = orbits.thresholds_of(service.on_demand, service.background, query.omega, query.xi)
    return Response(orbits_text.thresholds_json(found, query.delta), media_type=MEDIA_TYPES["json"])


@router.post(
    "/trajectories",
    summary="Compute the motion of a cell",
    response_model=schemas.Trajectory,
    responses=problem_responses(400, 408, 413, 415, 422, 429),
    openapi_extra=_TRAJECTORY_BODY,
)
@costly(MAX_SAMPLES * BYTES_PER_SAMPLE, "trajectory")
def compute_trajectory(service: ServiceDep, body: JsonBody) -> Response:
    """One cell from rest, after `settle` plate periods, or from a start: plate,
    masses and contact force, sample by sample.

    Lengths are in plate amplitudes: the paper's zω²/g divided by Γ, as its Fig. 2 draws them.
    """
    spec = TrajectorySpec.from_json(body)
    trajectories.check_cost(spec, service.settings.trajectory_seconds)
    content = service.background.run(answers.trajectory, spec)
    return Response(content, media_type=MEDIA_TYPES["json"])
