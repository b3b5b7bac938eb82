"""GET /v1/jobs/{job_id}/NAME for every view."""

from collections.abc import Callable, Sequence
from inspect import cleandoc
from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, JsonValue, create_model

from service.api import dependencies
from service.api.capacity import Cost, costly
from service.api.conditional import NOT_MODIFIED, ConditionalRoute, ResultsJob
from service.api.dependencies import ServiceDep
from service.api.schemas import PENDING_RESPONSE, content, problem_responses
from service.formats import MEDIA_TYPES, PICTURES
from service.jobs.model import JobRecord
from service.results.selection import BASE_MEMORY
from service.views.registry import VIEWS, admit, answer
from service.views.view import View

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


def routes() -> APIRouter:
    """The routes of all views."""
    router = APIRouter(prefix="/v1/jobs/{job_id}", route_class=ConditionalRoute, tags=["results"])
    for view in VIEWS.values():
        router.add_api_route(
            f"/{view.name}", _endpoint(view), name=f"get_{view.name}", summary=view.summary,
            description=_description(view), response_model=Dataset,
            responses={
                **content(*view.formats),
                **(PENDING_RESPONSE if view.parts else {}),
                **NOT_MODIFIED,
                **problem_responses(404, 413, 422),
            },
        )  # fmt: skip
    return router


def _description(view: View) -> str:
    rows = (
        f"- `{row.name}`: {row.attrs['long_name']}"
        + (f" ({row.attrs['units']})" if row.attrs.get("units", "1") != "1" else "")
        for row in view.variables
    )
    return "\n".join([cleandoc(view.compute.__doc__ or view.summary), "", *rows])


def _endpoint(view: View) -> Callable[..., Any]:
    # The format is a field of the model, which forbids parameters beside its own.
    formats: Any = Literal[view.formats]
    model: Any = create_model(view.query.__name__, __base__=view.query, format=(formats, "json"))

    def asked(service: ServiceDep, job: JobRecord, query: Any) -> Any:
        study = dependencies.stored(service, job)
        plain = view.query(**query.model_dump(exclude={"format"}))
        return study, *admit(view, study.spec, plain, query.format, service.settings.max_points)

    def cost(service: ServiceDep, job: JobRecord, query: Any) -> Cost:
        _, _, estimate = asked(service, job, query)
        memory = estimate.memory + estimate.points * _PER_POINT[query.format]
        if query.format in PICTURES or not estimate.small:
            return Cost(BASE_MEMORY + memory)
        return dependencies.cost_of_read(service, job, memory, *estimate.reads)

    @costly(cost, "on demand" if view.parts else "read")
    def get(service: ServiceDep, job: ResultsJob, query: Annotated[model, Query()]) -> Response:
        asking: Any = query
        study, plain, _ = asked(service, job, asking)
        parts: Sequence[Any] = ()
        if view.parts is not None:
            calls = view.parts(study, plain)
            key = (view.name, job.id, job.chunks_done, plain)
            parts = service.on_demand.get(key, lambda workers: [workers.call(*call) for call in calls])
        body, complete = service.background.run(
            answer, view.name, study, plain.model_dump(), asking.format, parts
        )
        headers = {"Bounce-Complete": "true" if complete else "false"}
        return Response(body, media_type=MEDIA_TYPES[asking.format], headers=headers)

    return get
