"""The application: one data folder, one supervisor, the calls, and nothing that outlives it."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

from fastapi import Depends, FastAPI
from fastapi.openapi.utils import get_openapi

from service.api import problems
from service.api.capacity import ConcurrencyLimit
from service.api.damage import damaged
from service.api.dependencies import Service, reject_repeated_parameters
from service.api.metrics import Metrics
from service.api.middleware.access_control import AccessControl
from service.api.middleware.body_limit import BodyLimit
from service.api.pending import underway
from service.api.progress_stream import ProgressStream
from service.api.readiness import Health
from service.api.routers import docs, jobs, model, page, results
from service.api.routers import health as probes
from service.api.schemas import ProblemDocument
from service.jobs.ledger import Ledger
from service.jobs.manager import JobManager
from service.jobs.on_demand import OnDemandCache, Pending
from service.render import export
from service.results.trajectory import TrajectorySpec
from service.server.logging import AccessLog
from service.settings import Settings
from worker.executors.base import Executor
from worker.spec import SweepSpec
from worker.store import StoreDamaged

SUMMARY = "Parameter studies of the bouncing spring: bifurcation diagrams, thresholds, hysteresis."


def create_app(settings: Settings, executor: Executor) -> FastAPI:
    """The service as an ASGI application, computing on `executor`, which stays its owner's to close.

    Starting it raises DataFolderBusy if another service uses the data folder, LedgerUnusable if a newer
    version wrote its ledger.
    """
    metrics = Metrics()
    app = FastAPI(
        title="bouncing-spring",
        summary=SUMMARY,
        version="0.1.0",
        docs_url=None,  # /docs is our own: the usual ones fetch their scripts from elsewhere
        redoc_url=None,
        dependencies=[Depends(reject_repeated_parameters)],
        lifespan=partial(_lifespan, settings=settings, executor=executor, metrics=metrics),
    )
    app.include_router(jobs.router)
    app.include_router(results.router)
    app.include_router(model.router)
    app.include_router(probes.router)
    app.include_router(docs.router)
    page.install(app)
    problems.install(app)
    app.add_exception_handler(StoreDamaged, damaged)
    app.add_exception_handler(Pending, underway)
    app.add_middleware(BodyLimit, max_bytes=settings.max_body_bytes, seconds=settings.body_seconds)
    app.add_middleware(AccessControl, settings=settings)
    app.add_middleware(AccessLog, metrics=metrics)  # the outermost: it tells of refusals too
    app.openapi = partial(_openapi, app)  # type: ignore[method-assign]
    return app


@asynccontextmanager
async def _lifespan(
    app: FastAPI, *, settings: Settings, executor: Executor, metrics: Metrics
) -> AsyncIterator[None]:
    """Open the ledger and compute what it has unfinished until the application stops."""
    with Ledger(settings.ledger_path) as ledger:
        export.remove_unfinished(settings.exports_path)
        service = _service(settings, ledger, executor, metrics)
        app.state.service = service
        service.manager.start()
        try:
            yield
        finally:
            service.answers.close()
            service.manager.stop()


def _service(settings: Settings, ledger: Ledger, executor: Executor, metrics: Metrics) -> Service:
    health = Health(executor)
    metrics.watch(ledger, health)
    return Service(
        settings=settings,
        ledger=ledger,
        manager=JobManager(ledger, executor, settings),
        health=health,
        watch=ProgressStream(ledger, settings.max_listeners),
        metrics=metrics,
        exports=ConcurrencyLimit("files", settings.max_exports),
        trajectories=ConcurrencyLimit("trajectories", settings.max_trajectories),
        answers=OnDemandCache(executor),
    )


def _openapi(app: FastAPI) -> dict[str, Any]:
    """The API document, with the schemas of what FastAPI does not parse itself."""
    if app.openapi_schema is None:
        document = get_openapi(title=app.title, version=app.version, summary=app.summary, routes=app.routes)
        schemas = document.setdefault("components", {}).setdefault("schemas", {})
        for kind in (SweepSpec, TrajectorySpec, ProblemDocument):
            schema = kind.model_json_schema(ref_template="#/components/schemas/{model}")
            schemas |= schema.pop("$defs", {}) | {kind.__name__: schema}
        app.openapi_schema = document
    return app.openapi_schema
