"""GET /v1/jobs/{job_id}/NAME for every result of a job, GET /v1/NAME for every one of a spring."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from inspect import cleandoc
from itertools import groupby
from operator import itemgetter
from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, JsonValue, create_model

from kernel.params import KernelInputError
from service.api import dependencies
from service.api.capacity import Cost, costly
from service.api.conditional import NOT_MODIFIED, ConditionalRoute, ResultsJob
from service.api.dependencies import Service, ServiceDep
from service.api.schemas import PENDING_RESPONSE, content, problem_responses
from service.errors import InvalidRequest
from service.formats import MEDIA_TYPES, PICTURES
from service.jobs.model import JobRecord
from service.jobs.on_demand import Caller
from service.views.registry import SPRINGS, VIEWS, admit, answer
from service.views.selection import BASE_MEMORY, Stored
from service.views.view import Call, Estimate, View

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
    jobs = APIRouter(prefix="/v1/jobs/{job_id}", route_class=ConditionalRoute, tags=["results"])
    for view in VIEWS.values():
        _add(jobs, view, _of_job(view), f"get_job_{view.name}", {**NOT_MODIFIED, **problem_responses(404)})
    springs = APIRouter(prefix="/v1", tags=["model"])
    for view in SPRINGS.values():
        _add(springs, view, _of_spring(view), f"get_{view.name}", {})
    return [jobs, springs]


def _add(
    router: APIRouter, view: View, endpoint: Callable[..., Any], name: str, responses: dict[int | str, Any]
) -> None:
    description = "\n".join([cleandoc(view.compute.__doc__ or view.summary), "", *view.described])
    pending = {**PENDING_RESPONSE, **problem_responses(429, 503)} if view.parts else {}
    router.add_api_route(
        f"/{view.name}", endpoint, name=name, summary=view.summary, description=description,
        response_model=Dataset,
        responses={**content(*view.formats), **pending, **problem_responses(413, 422), **responses},
    )  # fmt: skip


def _query_model(view: View) -> Any:
    # The format is a field of the model, which forbids parameters beside its own.
    formats: Any = Literal[view.formats]
    return create_model(view.query.__name__, __base__=view.query, format=(formats, "json"))


def _asked(service: Service, view: View, study: Stored[Any] | None, query: Any) -> tuple[Any, Estimate]:
    """The query without the format, thinned if it is of a picture, and its estimate."""
    plain = view.query(**query.model_dump(exclude={"format"}))
    spec = None if study is None else study.spec
    limits = service.settings
    return admit(view, spec, plain, query.format, limits.max_points, limits.trajectory_seconds)


def _memory(estimate: Estimate, format: str) -> int:
    return estimate.memory + estimate.points * _PER_POINT[format]


def _answer(service: Service, view: View, study: Stored[Any] | None, query: Any) -> Response:
    plain, _ = _asked(service, view, study, query)
    parts = _computed(service, study, view.parts(study, plain)) if view.parts is not None else []
    body, complete = service.background.run(answer, view.name, study, plain.model_dump(), query.format, parts)
    headers = {"Bounce-Complete": "true" if complete else "false"}
    return Response(body, media_type=MEDIA_TYPES[query.format], headers=headers)


def _computed(service: Service, study: Stored[Any] | None, calls: Sequence[Call]) -> list[Any]:
    """The results of these calls. Those of one function are kept together, for every query that has them.

    Calls that read the store of a job have other results once more chunks are done.
    """
    results = []
    for _, same in groupby(calls, itemgetter(0)):
        step = tuple(same)
        reads = study is not None and any(study.url in call for call in step)
        key = (step, study.chunks_done if study is not None and reads else 0)
        try:
            results += service.on_demand.get(key, partial(_submitted, step))
        except KernelInputError as error:
            raise InvalidRequest.of(error.argument, error.rule) from error
    return results


def _submitted(calls: Sequence[Call], workers: Caller) -> list["Future[Any]"]:
    return [workers.call(*call) for call in calls]


def _of_job(view: View) -> Callable[..., Any]:
    model: Any = _query_model(view)

    def cost(service: ServiceDep, job: JobRecord, query: Any) -> Cost:
        _, estimate = _asked(service, view, dependencies.stored(service, job), query)
        memory = _memory(estimate, query.format)
        if query.format in PICTURES or not estimate.small:
            return Cost(BASE_MEMORY + memory)
        return dependencies.cost_of_read(service, job, memory, *estimate.reads)

    @costly(cost, "on demand" if view.parts else "trajectory" if view.computes else "read")
    def get(service: ServiceDep, job: ResultsJob, query: Annotated[model, Query()]) -> Response:
        study = dependencies.stored(service, job)
        return _answer(service, view, study, query)

    return get


def _of_spring(view: View) -> Callable[..., Any]:
    model: Any = _query_model(view)

    def cost(service: ServiceDep, query: Any) -> int:
        _, estimate = _asked(service, view, None, query)
        return BASE_MEMORY + _memory(estimate, query.format)

    @costly(cost, "on demand" if view.parts else "trajectory")
    def get(service: ServiceDep, query: Annotated[model, Query()]) -> Response:
        return _answer(service, view, None, query)

    return get
