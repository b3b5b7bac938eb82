"""Endpoints that read a job's results, also while the job is running."""

import os
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import IO, Annotated, Final
from urllib.parse import quote

from fastapi import APIRouter, Header, HTTPException, Query, Response
from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from service.api import dependencies, schemas
from service.api.capacity import PIECE, SMALL_ANSWER, Cost, costly
from service.api.dependencies import JobDep, ServiceDep, StoreJob
from service.api.schemas import NOT_MODIFIED, content, problem_responses
from service.formats import EXPORTS, MEDIA_TYPES
from service.ledger.model import JobRecord, JobState
from service.views import exports
from service.views.encode import GROUP_BYTES
from service.views.selection import BASE_MEMORY
from worker.store import ROOT, StoreDamaged

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"])

#: Copies of a chunk in memory while a file is made of it: read, as rows, encoded.
_CHUNK_COPIES: Final = 12


class _OpenFile(StreamingResponse):
    """An open file, which is closed however the request ends, also before anything is read."""

    def __init__(self, file: IO[bytes], headers: Mapping[str, str], media_type: str) -> None:
        super().__init__(iter(partial(file.read, PIECE), b""), 200, headers, media_type)
        self._file = file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._file:
            await super().__call__(scope, receive, send)


def _export_cost(service: ServiceDep, job: JobRecord, query: schemas.ExportQuery) -> Cost:
    group = GROUP_BYTES if query.format == "parquet" else 0
    chunk = service.manager.preparer.prepare(job).layout.chunk_bytes
    return Cost(BASE_MEMORY + group + _CHUNK_COPIES * chunk)


@router.get(
    "/export",
    summary="Export the job's results as a file",
    response_class=Response,
    responses={**content(*EXPORTS), **problem_responses(404, 413, 422, 429, 507)},
)
@costly(_export_cost, "export")
def export_job(service: ServiceDep, job: JobDep, query: Annotated[schemas.ExportQuery, Query()]) -> Response:
    """The whole study as one file: NetCDF holds the store's arrays, Parquet a row for every cell.

    Of a job of basins or multistability Parquet has a row for every attractor of a cell. With
    `layout=flights` it has a row for every flight instead. The file's attributes tell job, specification,
    software, libraries, processor, times and core-seconds.
    """
    study, prepared = dependencies.stored(service, job), service.manager.preparer.prepare(job)
    study = replace(study, audit=service.audit_of(job))
    limit = service.settings.max_export_bytes
    exports.check(study.spec, prepared.plan, query.format, query.layout, limit)
    attributes = exports.attributes_of(job, prepared)
    export = exports.Export(study, prepared.plan, query.format, query.layout, attributes, job.runs)
    file = exports.make(service.background, export, service.settings.exports_path)
    headers = {
        "Content-Length": str(file.seek(0, 2)),
        "Content-Disposition": f'attachment; filename="{job.id}.{query.format}"',
        "Bounce-Complete": "true" if job.state is JobState.DONE else "false",
    }
    file.seek(0)
    return _OpenFile(file, headers, MEDIA_TYPES[query.format])


#: One range of bytes; the answer to a request for several has all bytes, which is allowed.
_RANGE: Final = re.compile("bytes=([0-9]{1,18})?-([0-9]{1,18})?")


def _zarr_cost(service: ServiceDep, job: JobRecord, key: str, **_: str | None) -> Cost:
    size = service.manager.preparer.prepare(job).layout.chunk_bytes
    return Cost(size, size <= SMALL_ANSWER)


def _span(byte_range: str, size: int) -> slice | None:
    """The part of `size` bytes that a Range asks for; None for a header to ignore (RFC 9110)."""
    match = _RANGE.fullmatch(byte_range)
    if match is None or match.groups() == (None, None):
        return None
    first, last = (None if text is None else int(text) for text in match.groups())
    if first is None:
        return slice(max(size - (last or 0), 0), size)
    if last is not None and last < first:
        return None
    return slice(first, size if last is None else min(last + 1, size))


@router.get(
    "/zarr/{key:path}",
    summary="Read the zarr store",
    responses={
        200: {"content": {"application/octet-stream": {}}},
        206: {"description": "Some of the bytes", "content": {"application/octet-stream": {}}},
        **NOT_MODIFIED,
        **problem_responses(404, 410, 416),
    },
)
@costly(_zarr_cost, "store")
def get_zarr_file(
    service: ServiceDep,
    job: StoreJob,
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
    try:
        content = prepared.read_file(key, complete=job.state is JobState.DONE, begun=job.chunks_done > 0)
        if content is None:
            raise HTTPException(404, f"the job's store has nothing under the key {key[:80]!a}")
    except (HTTPException, StoreDamaged):
        dependencies.find_store_job(job.id, service)  # it may be deleted meanwhile
        raise
    headers = {"Cache-Control": "no-cache", "Accept-Ranges": "bytes"}
    if key == ROOT:
        store_url = os.fsencode(prepared.store_url)  # the name of a folder need not be UTF-8
        headers["Bounce-Store"] = quote(store_url, safe="/:@+,;=~()[] ")
    media_type = "application/json" if key.endswith(".json") else "application/octet-stream"
    span = None if if_range is not None else _span(byte_range or "", len(content))
    if span is None:
        return Response(content, 200, headers, media_type)
    if not content[span]:
        beyond, size = f"the range starts beyond the end ({len(content)} bytes)", f"bytes */{len(content)}"
        raise HTTPException(416, beyond, {"Content-Range": size})
    headers["Content-Range"] = f"bytes {span.start}-{span.stop - 1}/{len(content)}"
    return Response(content[span], 206, headers, media_type)
