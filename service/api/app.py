"""The ASGI application: routers, error handlers, middleware, and the parts that live while it runs."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache, partial
from typing import Final

from fastapi import Depends, FastAPI

from service.api import openapi, problems
from service.api.capacity import Capacity, ListenerLimit
from service.api.dependencies import Service, reject_repeated_parameters
from service.api.middleware.access_control import AccessControl
from service.api.middleware.access_log import AccessLog
from service.api.middleware.body_limit import BodyLimit
from service.api.middleware.head import HeadAsGet
from service.api.monitoring import Metrics, Readiness
from service.api.progress_stream import ProgressStream
from service.api.routers import docs, health, jobs, model, page, results, views
from service.background import Background, InThisProcess
from service.jobs.ledger import Ledger
from service.jobs.manager import JobManager
from service.jobs.on_demand import MAX_PENDING, OnDemandCache
from service.jobs.stores.adoption import open_ledger
from service.settings import Settings
from service.software import software
from service.views.files import export
from worker.executors.base import Executor

#: Chunks of stores read at a time.
CHUNKS: Final = 4

#: Small reads of each kind computed at a time, in this process; bytes that they take until they are sent, and
#: how many may wait.
SMALL_READS: Final = 2
SMALL_MEMORY: Final = 128 * 2**20
MOST_SMALL: Final = 1_000

SUMMARY = "Parameter studies of the bouncing spring: bifurcation diagrams, thresholds, hysteresis."


#: Of the API document, by which a service is recognised.
TITLE: Final = "bouncing-spring"


def create_app(settings: Settings, executor: Executor, background: Background | None = None) -> FastAPI:
    """The service as an ASGI application that computes jobs on `executor`; the caller closes both.

    Answers are computed in the `background`; without one, in this process.

    Its startup raises DataFolderBusy if another service uses the data folder, LedgerUnusable if a newer
    version wrote the ledger. Raises NotStarted for a file of tokens that cannot be used.
    """
    tokens = settings.access_tokens()
    metrics = Metrics()
    app = FastAPI(
        title=TITLE,
        summary=SUMMARY,
        version=software().release,
        docs_url=None,  # routers.docs replaces FastAPI's viewers, which load scripts from other hosts
        redoc_url=None,
        generate_unique_id_function=openapi.operation_id,
        dependencies=[Depends(reject_repeated_parameters)],
        lifespan=partial(
            _lifespan,
            settings=settings,
            executor=executor,
            background=background or InThisProcess(),
            metrics=metrics,
        ),
    )
    for module in (jobs, results, model, health, docs, page):
        app.include_router(module.router)
    for router in views.routes():
        app.include_router(router)
    app.mount("/static", page.static_files(), name="static")
    problems.install(app)
    app.add_middleware(HeadAsGet)
    app.add_middleware(BodyLimit, max_bytes=settings.max_body_bytes, timeout=settings.body_seconds)
    app.add_middleware(AccessControl, hosts=settings.hosts, tokens=tokens, origins=settings.cors_origins)
    app.add_middleware(AccessLog, metrics=metrics)  # added last, so the outermost: it logs refusals too
    app.openapi = cache(  # type: ignore[method-assign]
        partial(openapi.document, app, needs_token=bool(tokens))
    )
    return app


@asynccontextmanager
async def _lifespan(
    app: FastAPI, *, settings: Settings, executor: Executor, background: Background, metrics: Metrics
) -> AsyncIterator[None]:
    """Open the ledger and compute its unfinished jobs until the application stops."""
    with open_ledger(settings) as ledger:
        export.remove_unfinished(settings.exports_path)
        service = _service(settings, ledger, executor, background, metrics)
        app.state.service = service
        service.manager.start()
        try:
            yield
        finally:
            service.capacity.close()
            service.small_reads.close()
            service.on_demand.close()
            service.manager.stop()


def _service(
    settings: Settings, ledger: Ledger, executor: Executor, background: Background, metrics: Metrics
) -> Service:
    readiness = Readiness(executor, ledger_fault=ledger.fault)
    manager = JobManager(ledger, executor, settings)
    metrics.add_jobs(ledger, readiness, manager)
    metrics.add_cluster(executor)
    return Service(
        settings=settings,
        ledger=ledger,
        manager=manager,
        on_demand=OnDemandCache(executor, jobs_compute=manager.is_computing),
        capacity=Capacity(
            {
                "read": settings.max_reads,
                "store": CHUNKS,
                "export": settings.max_exports,
                "trajectory": settings.max_trajectories,
                "on demand": MAX_PENDING,
            },
            settings.answer_memory,
            timeout=settings.turn_seconds,
        ),
        small_reads=Capacity(
            dict.fromkeys(("read", "store", "on demand"), SMALL_READS), SMALL_MEMORY, max_waiting=MOST_SMALL
        ),
        background=background,
        listener_limit=ListenerLimit(settings.max_listeners),
        progress_stream=ProgressStream(ledger, manager.compiling),
        readiness=readiness,
        metrics=metrics,
    )
