"""What the model itself answers, without a job: cycles, one cell in motion."""

from typing import Annotated, Final, get_args

from fastapi import APIRouter, Query, Response

from kernel.branches.curves import Parameter
from service.api import parameters, schemas
from service.api.capacity import costly
from service.api.dependencies import JsonBody, ServiceDep
from service.api.routers.views import Dataset
from service.api.schemas import PENDING_RESPONSE, content, problem_responses
from service.errors import InvalidRequest
from service.formats import MEDIA_TYPES, DatasetFormat
from service.render import orbits as orbits_text
from service.results import orbits
from service.results.selection import BASE_MEMORY
from service.views import registry
from service.views.trajectory import BYTES_PER_SAMPLE, MAX_SAMPLES, TrajectorySpec, check_cost
from worker.orbits import MAX_GRID

router = APIRouter(prefix="/v1", tags=["model"])

#: Bytes of a point of a branch, with what is computed on the way to it, and of an answer of curves.
_PER_POINT: Final = 4_000
_CURVES_MEMORY: Final = 16 * 2**20

_TRAJECTORY_BODY: Final = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/TrajectorySpec"}}},
    }
}


def _orbits_memory(service: ServiceDep, query: parameters.OrbitsQuery) -> int:
    return BASE_MEMORY + (query.modes.count(",") + 1) * MAX_GRID * _PER_POINT


@router.get(
    "/orbits",
    summary="Compute the branches of a spring",
    response_model=schemas.OrbitsView,
    responses={**PENDING_RESPONSE, **problem_responses(422, 429, 503)},
)
@costly(_orbits_memory, "trajectory")
def get_orbits(service: ServiceDep, query: Annotated[parameters.OrbitsQuery, Query()]) -> Response:
    """Cycles of one bounce in k plate periods, stable and unstable, and where their branches turn or end.

    In closed form, of the rigid contact without restitution. A branch that leaves `gamma_max` and comes back
    is several pieces. Workers compute what takes longer than a second; until then 202.
    """
    spring = (query.omega, query.xi, orbits.parse_modes(query.modes))
    found = orbits.orbits_of(service.on_demand, service.background, *spring, query.gamma_max, query.points)
    content = service.background.run(orbits_text.orbits_json, found, query.energy)
    return Response(content, media_type=MEDIA_TYPES["json"])


@router.get(
    "/curves",
    summary="Compute bifurcation curves",
    response_model=schemas.CurvesView,
    responses={**PENDING_RESPONSE, **problem_responses(422, 429, 503)},
)
@costly(_CURVES_MEMORY, "on demand")
def get_curves(service: ServiceDep, query: Annotated[parameters.CurvesQuery, Query()]) -> Response:
    """Curves of folds, flips and other events over Ω at one ξ, or over ξ at one Ω, and where they meet.

    Workers compute them, some seconds for each mode; until then 202 with the progress.
    """
    along, fixed, span = _plane(query)
    modes, kinds = orbits.parse_modes(query.modes), orbits.parse_kinds(query.kinds)
    found = orbits.event_curves(service.on_demand, along, fixed, span, modes, kinds, query.gamma_max)
    return Response(orbits_text.curves_json(found), media_type=MEDIA_TYPES["json"])


def _plane(query: parameters.CurvesQuery) -> tuple[Parameter, float, tuple[float, float]]:
    """The parameter that varies, the value of the other one, and the range. Raises InvalidRequest."""
    given = query.model_fields_set
    if {"xi", "omega_start", "omega_stop"} <= given and not given & {"omega", "xi_start", "xi_stop"}:
        along, fixed, span = Parameter.OMEGA, query.xi, (query.omega_start, query.omega_stop)
    elif {"omega", "xi_start", "xi_stop"} <= given and not given & {"xi", "omega_start", "omega_stop"}:
        along, fixed, span = Parameter.XI, query.omega, (query.xi_start, query.xi_stop)
    else:
        rule = "give xi, omega_start and omega_stop, or omega, xi_start and xi_stop"
        raise InvalidRequest.of("xi" if "omega" not in given else "omega", rule)
    low, high = span
    if fixed is None or low is None or high is None:  # given without a value
        raise InvalidRequest.of(along.value, "must be a number")
    return along, fixed, (low, high)


@router.post(
    "/trajectories",
    summary="Compute the motion of a cell",
    response_model=Dataset,
    responses={**content(*get_args(DatasetFormat)), **problem_responses(400, 408, 413, 415, 422, 429)},
    openapi_extra=_TRAJECTORY_BODY,
)
@costly(MAX_SAMPLES * BYTES_PER_SAMPLE, "trajectory")
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
