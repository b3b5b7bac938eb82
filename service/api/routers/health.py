"""Endpoints for operators: liveness, readiness, metrics."""

from typing import Any

from fastapi import APIRouter, Response

from service.api.dependencies import ServiceDep
from service.api.problems import ProblemResponse
from service.api.schemas import Health, problem_responses

router = APIRouter()


@router.get("/healthz", summary="Liveness")
def healthz() -> Health:
    """The service answers requests."""
    return Health(status="ok")


@router.get("/readyz", summary="Readiness", response_model=Health, responses=problem_responses(503))
def readyz(service: ServiceDep) -> Any:
    """The Dask scheduler answers, so jobs are computed."""
    if service.readiness.ready():
        return Health(status="ok")
    return ProblemResponse(503, "the Dask scheduler does not answer; jobs wait until it does")


@router.get(
    "/metrics",
    summary="Prometheus metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {}}}},
)
def metrics(service: ServiceDep) -> Response:
    """Requests, jobs and readiness, in Prometheus's text format."""
    return Response(service.metrics.text(), media_type="text/plain; version=0.0.4")
