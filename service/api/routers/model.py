"""What the model itself answers, without a job: Eq. 25, one cell in motion, and cost against accuracy."""

from typing import Annotated, Final

import numpy as np
from fastapi import APIRouter, Query, Response

from kernel.threshold import threshold
from service.api import parameters, schemas
from service.api.capacity import costly
from service.api.dependencies import JsonBody, ServiceDep
from service.api.schemas import PENDING_RESPONSE, problem_responses
from service.formats import MEDIA_TYPES, PICTURES
from service.render import text
from service.render import work_precision as work_precision_diagram
from service.results import trajectory as trajectories
from service.results import work_precision
from service.results.trajectory import BYTES_PER_SAMPLE, MAX_SAMPLES, TrajectorySpec
from service.results.work_precision import Tradeoff

router = APIRouter(prefix="/v1")

_TRAJECTORY_BODY: Final = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/TrajectorySpec"}}},
    }
}


@router.get("/threshold", summary="Evaluate Eq. 25", responses=problem_responses(422))
def eq_25(query: Annotated[parameters.ThresholdQuery, Query()]) -> schemas.Threshold:
    """Γ_th of Eq. 25, above which a spring at rest begins to bounce."""
    value = float(threshold(query.omega, query.xi))
    return schemas.Threshold(omega=query.omega, xi=query.xi, threshold=value if np.isfinite(value) else None)


@router.post(
    "/trajectories",
    summary="Compute the motion of a cell",
    response_model=schemas.Trajectory,
    responses=problem_responses(400, 408, 413, 415, 422, 429),
    openapi_extra=_TRAJECTORY_BODY,
)
@costly(MAX_SAMPLES * BYTES_PER_SAMPLE, "trajectory")
def trajectory(service: ServiceDep, body: JsonBody) -> Response:
    """One cell from rest, after `settle` plate periods: plate, masses and contact force, sample by sample.

    Lengths are in plate amplitudes: the paper's zω²/g divided by Γ, as its Fig. 2 draws them.
    """
    spec = TrajectorySpec.from_json(body)
    trajectories.check_cost(spec, service.settings.trajectory_seconds)
    motion = trajectories.compute(spec)
    return Response(text.trajectory_json(motion), media_type=MEDIA_TYPES["json"])


@router.get(
    "/tradeoff",
    summary="Compare contact models by cost and accuracy",
    response_model=Tradeoff,
    responses={
        200: {"content": {MEDIA_TYPES[format]: {} for format in PICTURES}},
        **PENDING_RESPONSE,
        **problem_responses(422, 429, 503),
    },
)
@costly(work_precision_diagram.MEMORY, "on demand")
def tradeoff(service: ServiceDep, query: Annotated[parameters.TradeoffQuery, Query()]) -> Response:
    """Cost and accuracy of each contact model, measured over a fixed set of cells with extremes among them.

    Measured once in the service's lifetime, which takes a minute or two; until then 202 with the progress.
    """
    rows = service.on_demand.get("tradeoff", work_precision.submit)
    if query.format == "json":
        content: str | bytes = work_precision.table(rows).model_dump_json()
    else:
        content = service.background.run(work_precision_diagram.draw, rows, query.format)
    return Response(content, media_type=MEDIA_TYPES[query.format])
