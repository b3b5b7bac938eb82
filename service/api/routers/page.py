"""The web page at `/`, its static files, and the figures of the paper that its form offers as examples."""

from pathlib import Path
from typing import Any, Final

from fastapi import APIRouter, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field

from service import presets

FILES: Final = Path(__file__).parents[2] / "static"

#: Content-Security-Policy of the page, which runs scripts; `middleware` has the default.
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)

router = APIRouter(tags=["page"])


class FigureView(BaseModel):
    """A figure of the paper and its sweeps, ready to be submitted."""

    number: int
    title: str
    sweeps: list[dict[str, Any]] = Field(description="the first is the sweep that the figure shows")


@router.get("/v1/figures", summary="List the paper's figures")
def list_figures() -> list[FigureView]:
    """The figures of the paper that are made from sweeps, as `bounce figure` makes them."""
    return [
        FigureView(number=figure.number, title=figure.title, sweeps=[dict(sweep) for sweep in figure.sweeps])
        for figure in presets.FIGURES
        if figure.sweeps
    ]


@router.get("/", include_in_schema=False)
def index() -> Response:
    """The page."""
    headers = {"Content-Security-Policy": _POLICY, "Cache-Control": "no-cache"}
    return FileResponse(FILES / "index.html", headers=headers)
