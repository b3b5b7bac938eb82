"""The page at `/`: plain files, which load nothing from elsewhere and are told so."""

from pathlib import Path
from typing import Final

from fastapi import FastAPI, Response
from fastapi.responses import FileResponse
from starlette.staticfiles import StaticFiles

from service import views
from service.lines import Lines

FILES: Final = Path(__file__).parent / "static"

#: The page's own policy, in the place of the stricter one that every other answer has (service/security.py).
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


def install(app: FastAPI) -> None:
    """Give `app` the page, its files, and the calls that only it makes."""
    app.state.lines = Lines()
    app.include_router(views.router)
    app.add_api_route("/", index, include_in_schema=False)
    app.mount("/static", StaticFiles(directory=FILES), name="static")


def index() -> Response:
    """The page."""
    headers = {"Content-Security-Policy": POLICY, "Cache-Control": "no-cache"}
    return FileResponse(FILES / "index.html", headers=headers)
