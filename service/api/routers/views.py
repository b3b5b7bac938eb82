"""GET /v1/jobs/{job_id}/NAME for results of a job, GET /v1/NAME for results of a spring.

Also POST /v1/trajectories, the motion of a cell, and POST /v1/plans.
"""

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from inspect import cleandoc
from itertools import groupby
from operator import attrgetter, itemgetter
from typing import Annotated, Any, Final, Literal, get_args

from fastapi import APIRouter, Depends, Query, Response
from pydantic import BaseModel, JsonValue, create_model

from kernel.params import KernelInputError
from service.api import dependencies
from service.api.capacity import SMALL_CHUNKS, Cost, costly
from service.api.dependencies import JsonBody, ResultsJob, Service, ServiceDep
from service.api.schemas import (
    NOT_MODIFIED,
    PENDING_RESPONSE,
    MotionQuery,
    content,
    json_body,
    problem_responses,
)
from service.background import Asker
from service.errors import Busy, InvalidRequest, NotComputed, ServiceError
from service.formats import EXPORTS, MEDIA_TYPES, PICTURES, DatasetFormat
from service.jobs.on_demand import Pending
from service.ledger.model import JobRecord
from service.views import audit, difference
from service.views import plan as plans
from service.views.encode import check_format
from service.views.registry import SPRINGS, VIEWS, admit, answer, encoded, motion
from service.views.selection import BASE_MEMORY, Stored
from service.views.trajectory import BYTES_PER_SAMPLE, MAX_SAMPLES, TrajectorySpec, check_cost
from service.views.view import Call, Estimate, View
from worker.store import StoreDamaged, StoreError, StoreMissing, Unreachable
from worker.studies import from_json
from worker.sweep import SweepSpec

#: Bytes of memory per number of an answer.
_PER_POINT: Final = {
    "json": 100, "csv": 300, "bin": 32, "nc": 48, "parquet": 64, "png": 80, "svg": 80, "pdf": 80,
}  # fmt: skip


class Variable(BaseModel):
    """A variable or a coordinate."""

    dims: list[str]
    dtype: str
    attrs: dict[str, JsonValue]
    data: JsonValue


class Dataset(BaseModel):
    """A result in the form of `xarray.Dataset.to_dict`, with a `dtype` for each variable. NaN is null."""

    coords: dict[str, Variable]
    data_vars: dict[str, Variable]
    dims: dict[str, int]
    attrs: dict[str, JsonValue]


def routes() -> list[APIRouter]:
    """The routes of all views: of jobs, and of springs."""
    jobs = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"])
    for view in VIEWS.values():
        _add(jobs, view, ResultsJob, f"get_job_{view.name}", {**NOT_MODIFIED, **problem_responses(404)})
    springs = APIRouter(prefix="/v1", tags=["model"])
    for view in SPRINGS.values():
        _add(springs, view, Annotated[None, Depends(_no_job)], f"get_{view.name}", {})
    springs.add_api_route(
        "/trajectories", compute_trajectory, methods=["POST"], summary="Compute the motion of a cell",
        response_model=Dataset,
        responses={**content(*get_args(DatasetFormat)), **problem_responses(400, 408, 413, 415, 422, 429)},
        openapi_extra=json_body("TrajectorySpec"),
    )  # fmt: skip
    springs.add_api_route(
        "/plans", plan_sweep, methods=["POST"], summary="Plan a sweep", response_model=Dataset,
        responses={
            **content(*plans.VIEW.formats), **PENDING_RESPONSE,
            **problem_responses(400, 408, 413, 415, 422, 429, 503),
        },
        openapi_extra=json_body("SweepSpec"),
    )  # fmt: skip
    return [jobs, springs]


def _add(router: APIRouter, view: View, job_type: Any, name: str, responses: dict[int | str, Any]) -> None:
    description = "\n".join([cleandoc(view.compute.__doc__ or view.summary), "", *view.described])
    pending = {**PENDING_RESPONSE, **problem_responses(429, 503)} if view.parts else {}
    methods = {"GET": name} | ({"POST": name.replace("get_", "compute_", 1)} if view.kept else {})
    for method, operation in methods.items():
        router.add_api_route(
            f"/{view.name}", _endpoint(view, job_type), methods=[method], name=operation,
            summary=view.summary, description=description, response_model=Dataset,
            responses={**content(*view.formats), **pending, **problem_responses(413, 422), **responses},
        )  # fmt: skip


def _asked(service: Service, view: View, study: Stored[Any] | None, query: Any) -> tuple[Any, Estimate]:
    """The query without the format, thinned if it is of a picture, and its estimate."""
    plain = view.query(**query.model_dump(exclude={"format"}))
    spec = None if study is None else study.spec
    limits = service.settings
    return admit(view, spec, plain, query.format, limits.max_points, limits.trajectory_seconds)


def _answer(
    service: Service, view: View, study: Stored[Any] | None, job: JobRecord | None, query: Any
) -> Response:
    plain, _ = _asked(service, view, study, query)
    parts = _parts(service, view, study, job, plain)
    if study is not None and job is not None and query.format in (*PICTURES, *EXPORTS):
        study = replace(study, audit=service.audit_of(job))
    body, complete = service.background.run(answer, view.name, study, plain, query.format, parts)
    headers = {"Bounce-Complete": "true" if complete else "false"}
    return Response(body, media_type=MEDIA_TYPES[query.format], headers=headers)


def _parts(
    service: Service, view: View, study: Stored[Any] | None, job: JobRecord | None, query: Any
) -> Sequence[Any]:
    """The results that workers compute for an answer; computed only once if they are kept with the job."""
    if view.parts is None:
        return []
    if not view.kept or job is None:
        return _computed(service, study, view.parts(study, query))
    asked = query.model_dump_json()
    with service.ledger.reading() as ledger:
        kept = ledger.answer(job, view.name, asked)
    if kept is None:
        kept = _computed(service, study, view.parts(study, query))
        sentence = view.compute(study, query, *kept).attrs["sentence"]
        with service.ledger.writing() as writing:
            now, results = writing.find(job.id), attrgetter("seq", "state", "chunks_done")
            if now is not None and results(now) == results(job):
                writing.keep_answer(job, view.name, asked, kept, sentence)
    return kept


def audited(service: Service, job: JobRecord, seconds: float) -> str | None:
    """The sentence of a job's audit; None if workers cannot compute it within this many seconds."""
    study, client = dependencies.stored(service, job), Asker(object())
    asked = audit.within(study.spec, seconds * max(service.manager.workers() // 2, 1))
    if asked is None:
        return None
    over = threading.Timer(seconds, client.leave)
    over.daemon = True  # a service that stops does not wait for it
    over.start()
    while over.is_alive():
        with suppress(Pending, Busy, NotComputed):
            client.run(lambda: _parts(service, audit.VIEW, study, job, asked))
            over.cancel()
            return service.audit_of(job)
        over.join(0.5)
    return None


def changed(service: Service, job: JobRecord, before: JobRecord, seconds: float) -> float | None:
    """The share of a job's cells where a coarser one shows another mode.

    None if that cannot be read within this many seconds.
    """
    client, shares = Asker(object()), list[float | None]()

    def compare() -> None:
        with suppress(OSError, StoreError, Unreachable, ServiceError, MemoryError):
            studies = [dependencies.stored(service, level) for level in (job, before)]
            shares.append(client.run(partial(service.background.run, difference.changed, *studies)))

    comparing = threading.Thread(target=compare, daemon=True)  # it may wait for a process to start
    comparing.start()
    comparing.join(max(seconds, 0.0))
    client.leave()
    return shares[0] if shares else None


def _computed(service: Service, study: Stored[Any] | None, calls: Sequence[Call]) -> list[Any]:
    """The results of these calls. Those of one function are cached together, for every query that has them.

    Calls that read the store of a job are computed again once more chunks are done and no client waits for
    them any more; those of a job that is done at once.
    """
    results, keys = [], []
    for _, same in groupby(calls, itemgetter(0)):
        step = tuple(same)
        reads = study is not None and any(study.url in call for call in step)
        chunks = study.chunks_done if study is not None and reads else 0
        keys.append((step, chunks if study is not None and study.complete else 0))
        try:
            results += service.on_demand.get(keys[-1], step, chunks)
        except Pending as pending:
            raise Pending(len(results) + pending.done, len(calls)) from None
        except KernelInputError as error:
            raise InvalidRequest.of(error.argument, error.rule) from error
        except StoreMissing as error:  # lost, or deleted meanwhile
            raise StoreDamaged(str(error)) from error
    if keys:
        service.on_demand.note_delivered(keys)
    return results


async def _no_job() -> None:
    return None


def _endpoint(view: View, job_type: Any) -> Callable[..., Any]:
    """The endpoint of a view of a job, or of a spring, whose job is None."""
    formats: Any = Literal[view.formats]
    # The format is a field of the model, which forbids parameters beside its own.
    model: Any = create_model(view.query.__name__, __base__=view.query, format=(formats, "json"))

    def study_of(service: Service, job: JobRecord | None, query: Any) -> Stored[Any] | None:
        if job is None:
            return None
        study = dependencies.stored(service, job)
        if not hasattr(query, "other"):
            return study
        other = dependencies.stored(service, dependencies.find_job(query.other, service))
        if view.study is not None and not isinstance(other.spec, view.study):
            rule = f"must be a sweep; the protocol of this job is {other.spec.protocol.kind}"
            raise InvalidRequest.of("other", rule)
        return replace(study, other=other)

    def cost(service: ServiceDep, job: JobRecord | None, query: Any) -> Cost:
        _, estimate = _asked(service, view, study_of(service, job, query), query)
        memory = estimate.memory + estimate.points * _PER_POINT[query.format]
        if query.format in PICTURES or not estimate.small:
            return Cost(BASE_MEMORY + memory)
        if job is None:
            return Cost(BASE_MEMORY + memory, memory <= SMALL_CHUNKS)
        return dependencies.cost_of_read(service, job, memory, *estimate.reads)

    @costly(cost, view.activity or ("on demand" if view.parts else "read"))
    def get(service: ServiceDep, job: job_type, query: Annotated[model, Query()]) -> Response:
        return _answer(service, view, study_of(service, job, query), job, query)

    return get


@costly(Cost(MAX_SAMPLES * BYTES_PER_SAMPLE), "trajectory")
def compute_trajectory(
    service: ServiceDep, body: JsonBody, query: Annotated[MotionQuery, Query()]
) -> Response:
    """One cell from rest, after `settle` plate periods, or from a start: plate, masses and contact force.

    The answer is the result `trajectory` of a job. Lengths are in plate amplitudes: the paper's zω²/g divided
    by Γ, as its Fig. 2 draws them.
    """
    check_format(query.format)
    spec = TrajectorySpec.from_json(body)
    check_cost(spec, service.settings.trajectory_seconds)
    content = service.background.run(motion, spec, query.format)
    return Response(content, media_type=MEDIA_TYPES[query.format])


_PLAN_FORMATS: Any = Literal[plans.VIEW.formats]
#: The query of a plan with the format of the answer.
_PlanQuery: Any = create_model("PlanQuery", __base__=plans.PlanQuery, format=(_PLAN_FORMATS, "json"))


@costly(Cost(BASE_MEMORY), "on demand")
def plan_sweep(service: ServiceDep, body: JsonBody, query: Annotated[_PlanQuery, Query()]) -> Response:
    """What efforts and grids of a sweep from rest would cost, and how much of its picture would be wrong.

    Workers compute pilot points drawn anywhere in the plane with every setting, and compare them with a
    computation that can be trusted. The recommended setting shows least wrong within the budget, or is the
    cheapest within the tolerance; the shares of up to four candidates are of other points.
    """
    spec = from_json(body)
    if not isinstance(spec, SweepSpec):
        raise InvalidRequest.of("protocol.kind", f"must be rest, of a sweep, not {spec.protocol.kind}")
    manager = service.manager
    settings = plans.settings_of(spec, manager.pace, manager.workers(), manager.check)
    fields = query.model_dump()
    format, plain = fields.pop("format"), plans.PlanQuery(**fields)
    check_format(format)
    [pilot] = _computed(service, None, plans.parts(settings, plain))
    content = encoded(plans.VIEW, None, plans.compute(settings, plain, pilot), format)
    return Response(content, media_type=MEDIA_TYPES[format])
