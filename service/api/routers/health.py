"""The calls that tell of the service itself: alive, ready, figures."""

from typing import Any

from fastapi import APIRouter, Response

from service.api import schemas
from service.api.dependencies import TheService
from service.api.problems import Problem
from service.api.schemas import problem_responses

router = APIRouter()


@router.get("/healthz")
def healthz() -> schemas.Health:
    """The service answers."""
    return schemas.Health(status="ok")


@router.get("/readyz", response_model=schemas.Health, responses=problem_responses(503))
def readyz(service: TheService) -> Any:
    """The service can compute: its scheduler answers."""
    if service.health.ready():
        return schemas.Health(status="ok")
    return Problem(503, "the Dask scheduler does not answer; jobs wait until it does")


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
def metrics(service: TheService) -> Response:
    """Figures for Prometheus."""
    return Response(service.metrics.text(), media_type="text/plain; version=0.0.4")
