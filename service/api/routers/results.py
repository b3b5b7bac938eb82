"""Endpoints that read a job's results, also while the job is running."""

import re
from collections.abc import Mapping
from http import HTTPStatus
from typing import IO, Annotated, Final
from urllib.parse import quote

from fastapi import APIRouter, Header, Query, Response
from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from service.api import dependencies, parameters
from service.api.capacity import SMALL_ANSWER, Cost, costly
from service.api.conditional import NOT_MODIFIED, ConditionalRoute, ResultsJob
from service.api.dependencies import JobDep, ServiceDep
from service.api.schemas import content, problem_responses
from service.errors import NotInStore, OutOfRange
from service.formats import EXPORTS, MEDIA_TYPES
from service.jobs.model import JobRecord, JobState
from service.views.files import export as export_files
from service.views.files.blocks import GROUP_BYTES
from service.views.provenance import attributes_of
from service.views.selection import BASE_MEMORY
from worker.store import ROOT

router = APIRouter(prefix="/v1/jobs/{job_id}", route_class=ConditionalRoute, tags=["results"])

#: How often a chunk is in memory while a file is made of it: read, as rows, encoded.
_CHUNK_COPIES: Final = 12


class _OpenFile(StreamingResponse):
    """A file that is open; it is closed however the request ends, also before anything is read."""

    def __init__(self, file: IO[bytes], headers: Mapping[str, str], media_type: str) -> None:
        super().__init__(export_files.pieces(file), 200, headers, media_type)
        self._file = file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._file:
            await super().__call__(scope, receive, send)


def _export_memory(service: ServiceDep, job: JobRecord, query: parameters.ExportQuery) -> int:
    group = GROUP_BYTES if query.format == "parquet" else 0
    return BASE_MEMORY + group + _CHUNK_COPIES * service.manager.preparer.prepare(job).layout.chunk_bytes


@router.get(
    "/export",
    summary="Export the job's results as a file",
    responses={**content(*EXPORTS), **problem_responses(404, 413, 422, 429, 501, 507)},
)
@costly(_export_memory, "export")
def export_job(
    service: ServiceDep, job: JobDep, query: Annotated[parameters.ExportQuery, Query()]
) -> Response:
    """The whole study as one file: NetCDF holds the store's arrays, Parquet a row for every cell.

    Of a job of basins or multistability Parquet has a row for every attractor of a cell. With
    `layout=flights` it has a row for every flight instead. The file's attributes tell job, specification,
    software, libraries, processor, times and core-seconds.
    """
    study, prepared = dependencies.stored(service, job), service.manager.preparer.prepare(job)
    export_files.check(study.spec, prepared.plan, query.format, query.layout)
    export_files.check_size(study, prepared.plan, service.settings.max_export_bytes)
    attributes = attributes_of(job, prepared)
    export = export_files.Export(study, prepared.plan, query.format, query.layout, attributes)
    file = export_files.make(service.background, export, service.settings.exports_path)
    headers = {
        "Content-Length": str(file.seek(0, 2)),
        "Content-Disposition": f'attachment; filename="{job.id}.{query.format}"',
        **_complete(job.state is JobState.DONE),
    }
    file.seek(0)
    return _OpenFile(file, headers, MEDIA_TYPES[query.format])


#: One range of bytes; a request for several is answered with all bytes, which is allowed.
_RANGE: Final = re.compile("bytes=([0-9]{1,18})?-([0-9]{1,18})?")
#: Characters of an address that a header carries as they are.
_PLAIN: Final = "/:@+,;=~()[] "


def _zarr_cost(service: ServiceDep, job: JobRecord, key: str, **_: str | None) -> Cost:
    size = service.manager.preparer.prepare(job).layout.chunk_bytes
    return Cost(size, size <= SMALL_ANSWER)


def _asked(byte_range: str) -> tuple[int | None, int | None] | None:
    """The first and the last byte that a Range asks for; None for one that counts as none (RFC 9110)."""
    match = _RANGE.fullmatch(byte_range)
    first, last = (None if text is None else int(text) for text in match.groups()) if match else (None, None)
    if first is None:
        return None if last is None else (None, last)
    return None if last is not None and last < first else (first, last)


def _span(first: int | None, last: int | None, size: int) -> range:
    """The positions of the bytes that `_asked` gives, of `size` there are."""
    if first is None:
        return range(max(size - (last or 0), 0), size)
    return range(first, size if last is None else min(last + 1, size))


@router.get(
    "/zarr/{key:path}",
    summary="Read the zarr store",
    responses={
        200: {"content": {"application/octet-stream": {}}},
        206: {"description": "Some of the bytes", "content": {"application/octet-stream": {}}},
        **NOT_MODIFIED,
        **problem_responses(404, 416),
    },
)
@costly(_zarr_cost, "store")
def get_zarr_file(
    service: ServiceDep,
    job: ResultsJob,
    key: str,
    byte_range: Annotated[
        str | None,
        Header(alias="Range", description="The bytes to send: `bytes=0-99`, `bytes=100-` or `bytes=-100`."),
    ] = None,
    if_range: Annotated[str | None, Header(include_in_schema=False)] = None,
) -> Response:
    """The store, read only: `xarray.open_zarr` opens the address that ends in `/zarr`.

    `Bounce-Store`, with `zarr.json`, is where the service has it: a folder of its machine, or an address in a
    bucket.
    """
    prepared = service.manager.preparer.prepare(job)
    content = prepared.read_file(key)
    if content is None:
        raise NotInStore(f"the job's store has nothing under the key {key[:80]!a}")
    headers = {"Cache-Control": "no-cache", "Accept-Ranges": "bytes"}
    if key == ROOT:
        headers["Bounce-Store"] = quote(prepared.store_url, safe=_PLAIN)
    media_type = "application/json" if key.endswith(".json") else "application/octet-stream"
    asked = None if if_range is not None else _asked(byte_range or "")
    if asked is None:
        return Response(content, media_type=media_type, headers=headers)
    span = _span(*asked, len(content))
    if not span:
        raise OutOfRange(len(content))
    headers["Content-Range"] = f"bytes {span[0]}-{span[-1]}/{len(content)}"
    return Response(content[span.start : span.stop], HTTPStatus.PARTIAL_CONTENT, headers, media_type)


def _complete(complete: bool) -> dict[str, str]:
    return {"Bounce-Complete": "true" if complete else "false"}
