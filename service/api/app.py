"""The ASGI application: routers, error handlers, middleware, and the parts that live while it runs."""

import asyncio
import shutil
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager
from operator import attrgetter
from typing import Final

from fastapi import Depends, FastAPI
from starlette.staticfiles import StaticFiles

from service.api import openapi, problems
from service.api.capacity import Capacity
from service.api.dependencies import Service, check_parameters
from service.api.middleware import Gate
from service.api.monitoring import JobsCollector, Metrics
from service.api.progress_stream import ProgressStream
from service.api.routers import docs, health, jobs, page, results, views
from service.api.schemas import problem_responses
from service.background import Background, InThisProcess
from service.jobs.budgets import Budgets
from service.jobs.manager import JobManager
from service.jobs.on_demand import MAX_PENDING, OnDemandCache
from service.jobs.stores.opening import open_ledger
from service.ledger.ledger import Ledger
from service.settings import Settings
from service.software import software
from worker.executors.base import Executor

#: Shared files that are received or imported at a time.
IMPORTS: Final = 4

#: Chunks of stores read at a time.
CHUNKS: Final = 4

#: Small reads of each kind computed at a time, in this process; bytes of all until they are sent; and most
#: that wait.
SMALL_READS: Final = 2
SMALL_MEMORY: Final = 128 * 2**20
MOST_SMALL: Final = 1_000


def create_app(
    settings: Settings, executor: Executor, background: Background | None = None, ledger: Ledger | None = None
) -> FastAPI:
    """The service as an ASGI application that computes jobs on `executor` and answers in the `background`.

    The caller closes both; without a `background` it answers in this process. Without a `ledger` its startup
    opens the settings', and raises as `open_ledger`. Raises NotStarted for an unusable file of tokens.
    """
    tokens = settings.access_tokens()
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        """Open the ledger and compute its unfinished jobs until the application stops."""
        try:
            with ExitStack() as stack:
                own = stack.enter_context(ledger or open_ledger(settings))
                shutil.rmtree(settings.exports_path, ignore_errors=True)  # left by a killed service
                service = _service(settings, own, executor, background or InThisProcess(), metrics)
                app.state.service = service
                service.manager.start()
                stack.callback(service.manager.stop)  # last
                for part in (service.budgets, service.on_demand, service.small_reads, service.capacity):
                    stack.callback(part.close)
                yield
        except Exception as error:
            app.state.startup_error = error  # uvicorn only logs it
            raise

    app = FastAPI(
        title="bouncing-spring",
        summary="Parameter studies of the bouncing spring: bifurcation diagrams, thresholds, hysteresis.",
        version=software().release,
        docs_url=None,  # routers.docs replaces FastAPI's viewers, which load scripts from other hosts
        redoc_url=None,
        generate_unique_id_function=attrgetter("name"),  # the name in a generated client
        dependencies=[Depends(check_parameters)],
        lifespan=lifespan,
    )
    for router in (health.router, docs.router, jobs.router, results.router, *views.routes(), page.router):
        app.include_router(router, responses=problem_responses(422))
    app.mount("/static", StaticFiles(directory=page.FILES), name="static")
    problems.install(app)
    app.add_middleware(Gate, metrics=metrics, settings=settings, tokens=tokens)
    app.openapi = openapi.kept_document(app, needs_token=bool(tokens))  # type: ignore[method-assign]
    return app


def _service(
    settings: Settings, ledger: Ledger, executor: Executor, background: Background, metrics: Metrics
) -> Service:
    manager = JobManager(ledger, executor, settings)
    for collector in (JobsCollector(ledger, manager), *vars(manager.supervisor.metrics).values()):
        metrics.registry.register(collector)
    service = Service(
        settings=settings,
        ledger=ledger,
        manager=manager,
        budgets=Budgets(
            manager, ledger, lambda *of: views.audited(service, *of), lambda *of: views.changed(service, *of)
        ),
        on_demand=OnDemandCache(executor, jobs_compute=manager.supervisor.in_flight),
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
        listeners=asyncio.Semaphore(settings.max_listeners),
        imports=asyncio.Semaphore(IMPORTS),
        progress_stream=ProgressStream(ledger, manager.compiling),
        metrics=metrics,
    )
    return service
