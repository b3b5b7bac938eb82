"""The calls that read what a job has found, also while it is still running."""

from collections.abc import AsyncIterator
from typing import Annotated, Any, Final

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import StreamingResponse
from fastapi.sse import EventSourceResponse, ServerSentEvent
from numpy.typing import NDArray

from service.api import dependencies, schemas
from service.api.conditional import NOT_MODIFIED, Results, Tagged
from service.api.dependencies import TheJob, TheService
from service.api.pending import RESPONSES as PENDING
from service.api.schemas import Format, problem_responses
from service.errors import NotInStore
from service.jobs.model import UNFINISHED, JobState
from service.render import bifurcation, text
from service.render import export as export_files
from service.results import diagram as diagrams
from service.results import mode_map
from service.results.thresholds import refined
from worker import store
from worker.spec import SweepSpec

router = APIRouter(prefix="/v1/jobs/{job_id}", route_class=Tagged)

Content = dict[str, dict[str, Any]]

_PICTURES: Final[Content] = {"application/json": {}, "text/csv": {}, "image/png": {}, "image/svg+xml": {}}
_FILES: Final[Content] = {media_type: {} for media_type in export_files.MEDIA_TYPES.values()}


async def _listening(service: TheService) -> AsyncIterator[None]:
    with service.watch.place():
        yield


@router.get(
    "/events",
    response_class=EventSourceResponse,
    dependencies=[Depends(_listening)],
    responses=problem_responses(404, 429),
)
async def events(service: TheService, job: TheJob, request: Request) -> AsyncIterator[ServerSentEvent]:
    """Progress as server-sent events, each the job without its specification.

    They are named `progress` while the job goes on and `end` when it is finished, which is the last one.
    """
    async for now in service.watch.changes(job.id):
        view = schemas.job_view(now, longest_spec=0)
        kind = "progress" if now.state in UNFINISHED else "end"
        yield ServerSentEvent(event=kind, raw_data=view.model_dump_json())


@router.get(
    "/diagram", responses={200: {"content": _PICTURES}, **NOT_MODIFIED, **problem_responses(404, 413, 422)}
)
def diagram(service: TheService, job: Results, query: Annotated[schemas.DiagramQuery, Query()]) -> Response:
    """The bifurcation diagram along one axis, also of a job that is not done: `complete` says so.

    Pictures show lines of any length, dense ones as density. JSON and CSV end at a number of flights; `every`
    takes every n-th cell, which the JSON then repeats.
    """
    sweep = dependencies.sweep(service, job)
    given = {"gamma": query.gamma, "omega": query.omega, "xi": query.xi}
    line = (sweep, query.along, given, query.direction, query.min_flight)
    most = service.settings.max_points
    if query.format is Format.JSON:
        found = [diagrams.diagram(*line, most, query.every)]
    elif query.format is Format.CSV:
        found = diagrams.diagrams(*line, most, query.every)
    else:
        found = diagrams.pictured(*line, query.every)
    content, media_type = _encoded(found, sweep.spec, query.format)
    return Response(content, media_type=media_type, headers=_complete(all(one.complete for one in found)))


@router.get(
    "/threshold",
    responses={**PENDING, **NOT_MODIFIED, **problem_responses(404, 413, 422, 429, 503)},
)
def job_threshold(
    service: TheService, job: Results, query: Annotated[schemas.JobThresholdQuery, Query()]
) -> schemas.Thresholds:
    """Per Ω at one xi: Eq. 25 beside the Γ where the sweep's cells begin and cease to bounce.

    To the grid, or with a tolerance as finely as asked for: null then where the change is not on the grid,
    and 202 with how far the workers are until they have found them all.
    """
    sweep = dependencies.sweep(service, job)
    found = mode_map.thresholds(sweep, query.xi, service.settings.max_points)
    if query.tolerance is not None:
        found = refined(service.answers, job, sweep, found, query.tolerance)
    return schemas.Thresholds(
        xi=found.xi,
        omega=found.omega.tolist(),
        analytic=numbers(found.analytic),
        up=numbers(found.up),
        down=numbers(found.down),
        tolerance=query.tolerance,
        complete=found.complete,
    )


@router.get(
    "/modes", response_model=schemas.Modes, responses={**NOT_MODIFIED, **problem_responses(404, 413, 422)}
)
def modes(service: TheService, job: Results, query: Annotated[schemas.ModesQuery, Query()]) -> Response:
    """The mode map at one xi: outcome, bounces and plate periods of every cell, rows of Ω, columns of Γ."""
    sweep, most = dependencies.sweep(service, job), service.settings.max_points
    found = mode_map.modes(sweep, query.xi, query.direction, most, query.every)
    return Response(
        text.modes_as_json(found), media_type="application/json", headers=_complete(found.complete)
    )


@router.get(
    "/export", responses={200: {"content": _FILES}, **problem_responses(404, 413, 422, 429, 507)}
)  # fmt: skip
def export(service: TheService, job: TheJob, query: Annotated[schemas.ExportQuery, Query()]) -> Response:
    """The whole sweep as one file: NetCDF holds the store's arrays, Parquet a row for every cell."""
    sweep = dependencies.sweep(service, job)
    export_files.check_size(sweep.spec, service.settings.max_export_bytes)
    with service.exports.turn():
        plan: Any = service.manager.preparer.prepare(job).plan
        file = export_files.make(sweep, plan, query.format, service.settings.exports_path)
    headers = {
        "Content-Length": str(file.seek(0, 2)),
        "Content-Disposition": f'attachment; filename="{job.id}.{query.format}"',
        **_complete(job.state is JobState.DONE),
    }
    file.seek(0)
    return StreamingResponse(export_files.pieces(file), 200, headers, export_files.MEDIA_TYPES[query.format])


@router.get(
    "/zarr/{key:path}",
    responses={200: {"content": {"application/octet-stream": {}}}, **NOT_MODIFIED, **problem_responses(404)},
)
def zarr(service: TheService, job: Results, key: str) -> Response:
    """The store itself, read only: `xarray.open_zarr` opens the address that ends in `/zarr`."""
    prepared = service.manager.preparer.prepare(job)
    found = store.read_key(prepared.store_url, key) if prepared.layout.has_key(key) else None
    if found is None:
        raise NotInStore(f"the job's store has nothing under the key {key[:80]!a}")
    media_type = "application/json" if key.endswith(".json") else "application/octet-stream"
    return Response(found, media_type=media_type, headers={"Cache-Control": "no-cache"})


router.add_api_route("/zarr/{key:path}", zarr, methods=["HEAD"], include_in_schema=False)


def numbers(values: NDArray[np.float64]) -> list[float | None]:
    """Numbers for JSON, which has no NaN and no infinity."""
    return [value if np.isfinite(value) else None for value in values.tolist()]


def _encoded(found: list[diagrams.Diagram], spec: SweepSpec, format: Format) -> tuple[bytes, str]:
    """The diagrams' bytes and what they are."""
    if format is Format.JSON:
        return text.as_json(found[0]), "application/json"
    if format is Format.CSV:
        return text.as_csv(found), "text/csv"
    media_type = "image/png" if format is Format.PNG else "image/svg+xml"
    return bifurcation.as_picture(found, spec, format), media_type


def _complete(complete: bool) -> dict[str, str]:
    return {"Bounce-Complete": "true" if complete else "false"}
