"""A real Chromium for the tests, and what every one of its pages is watched for."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
SHOTS = ROOT / "test-artefacts" / "page"
CHROMIUM = next((path for name in ("chromium", "chromium-browser") if (path := shutil.which(name))), None)
ARGUMENTS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip

needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium on this machine: `apt-get install chromium` brings it"
)


@contextmanager
def chromium() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


@contextmanager
def opened(browser: Any, address: str, *, expected: tuple[str, ...] = (), **given: Any) -> Iterator[Any]:
    """A page in a window of its own; whatever it complains of, but what is expected, is an error."""
    given = {"viewport": {"width": 1280, "height": 860}, "reduced_motion": "no-preference", **given}
    complaints: list[str] = []
    context = browser.new_context(**given)
    page = context.new_page()
    page.set_default_timeout(15_000)
    page.on("console", lambda said: said.type in ("error", "warning") and complaints.append(said.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    try:
        page.goto(address)
        yield page
    finally:
        context.close()
    assert [one for one in complaints if not any(known in one for known in expected)] == []


def shoot(page: Any, name: str) -> None:
    """Keep what is seen, to be looked at."""
    SHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SHOTS / f"{name}.png", full_page=True)
