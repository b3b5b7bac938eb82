"""The page at `/`: plain files, which load nothing from elsewhere and are told so."""

from pathlib import Path
from typing import Any, Final

from fastapi import APIRouter, FastAPI, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field
from starlette.staticfiles import StaticFiles

from service.api.routers import page_data
from service.figures.catalogue import FIGURES

FILES: Final = Path(__file__).parents[2] / "static"

#: The page's own policy; every other answer has the stricter one of `middleware.access_control`.
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


router = APIRouter()


class FigureView(BaseModel):
    """A figure of the paper and the sweeps behind it, ready to be submitted."""

    number: int
    title: str
    sweeps: list[dict[str, Any]] = Field(description="the first is what the figure shows")


def install(app: FastAPI) -> None:
    """Give `app` the page, its files, and the calls that only it makes."""
    app.include_router(router)
    app.include_router(page_data.router)
    app.mount("/static", StaticFiles(directory=FILES), name="static")


@router.get("/v1/figures")
def figures() -> list[FigureView]:
    """The figures of the paper that come from sweeps: those `bounce figure` makes."""
    return [
        FigureView(number=one.number, title=one.title, sweeps=[dict(sweep) for sweep in one.sweeps])
        for one in FIGURES.values()
        if one.sweeps
    ]


@router.get("/", include_in_schema=False)
def index() -> Response:
    """The page."""
    headers = {"Content-Security-Policy": POLICY, "Cache-Control": "no-cache"}
    return FileResponse(FILES / "index.html", headers=headers)
