"""Endpoints for operators: liveness, readiness, metrics, versions."""

import os

from fastapi import APIRouter, HTTPException, Response
from prometheus_client import generate_latest

from service.api.dependencies import ServiceDep
from service.api.schemas import Health, ReadinessView, SoftwareView, problem_responses
from service.software import software

router = APIRouter(tags=["service"])


@router.get("/healthz", summary="Liveness")
def get_liveness() -> Health:
    """The service answers requests."""
    return Health(status="ok")


@router.get(
    "/readyz", summary="Readiness", response_model_exclude_defaults=True, responses=problem_responses(503)
)
def get_readiness(service: ServiceDep) -> ReadinessView:
    """The ledger can be used, the Dask scheduler answers and has the workers that jobs need."""
    if (fault := service.manager.fault()) is not None:
        raise HTTPException(503, fault)
    return ReadinessView(status="ok", notices=service.manager.notices())


@router.get("/v1/software", summary="Versions of what the service runs on")
def get_versions(service: ServiceDep) -> SoftwareView:
    """Release, kernel version, Python and libraries, which workers have too; the data folder."""
    data = os.fsencode(service.settings.data.absolute()).decode(errors="replace")
    return SoftwareView(**software()._asdict(), data=data)


@router.get(
    "/metrics",
    summary="Prometheus metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {}}}},
)
def get_metrics(service: ServiceDep) -> Response:
    """Requests, jobs and readiness, in Prometheus's text format."""
    return Response(generate_latest(service.metrics.registry), media_type="text/plain; version=0.0.4")
