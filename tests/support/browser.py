"""A real Chromium for the page's tests: pages that fail on console errors, timings, screenshots."""

import csv
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

#: Not from `paths`: benchmarks import this module without the tests' import path.
ROOT = Path(__file__).parents[2]
SCREENSHOTS = ROOT / "test-artefacts" / "page"
ARGUMENTS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-dev-shm-usage",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
#: Timeout of every wait, ms, on an overloaded machine.
TIMEOUT_MS = 300_000


def _find_chromium() -> str | None:
    """The path of a Chromium that runs: on some systems the command only offers to install it."""
    for name in ("chromium", "chromium-browser"):
        path = shutil.which(name)
        if (
            path
            and b"Chromium" in subprocess.run([path, "--version"], capture_output=True, check=False).stdout
        ):
            return path
    return None


CHROMIUM = _find_chromium()
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="Chromium is not installed; on Debian: apt-get install chromium"
)

#: A line of a million flights, computed in half a second; the flights themselves do not matter.
LONG_LINE: dict[str, Any] = {
    "name": "A million flights", "gamma": {"start": 1.1, "stop": 6.0, "num": 15_600}, "omega": 0.5,
    "xi": 0.05, "model": {"kind": "rigid"}, "settle": 2, "observe": 70, "keep": 64,
}  # fmt: skip

#: Drops a file of this name and text on the page.
DROP = """([name, text]) => {
    const files = new DataTransfer();
    files.items.add(new File([text], name));
    document.querySelector("header").dispatchEvent(
        new DragEvent("drop", { dataTransfer: files, cancelable: true, bubbles: true }));
}"""

#: Reads a copy, because Chromium warns of reading the page's own canvas twice.
_PIXELS = """window.pixels = (canvas) => {
    const copy = new OffscreenCanvas(canvas.width, canvas.height)
        .getContext("2d", { willReadFrequently: true });
    copy.drawImage(canvas, 0, 0);
    return copy.getImageData(0, 0, canvas.width, canvas.height);
}"""

_OBSERVE_TASKS = """window.longestTask = 0;
new PerformanceObserver((list) => list.getEntries().forEach((entry) => {
    window.longestTask = Math.max(window.longestTask, entry.duration);
})).observe({ entryTypes: ["longtask"] })"""


#: A page that polls five times as often, and waits a fifth of the time before it asks again.
_HURRY = """{
    const later = window.setTimeout;
    window.setTimeout = (work, ms, ...given) => later(work, ms >= 1000 ? ms / 5 : ms, ...given);
}"""


@contextmanager
def chromium() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS, timeout=TIMEOUT_MS)
        yield browser
        browser.close()


@contextmanager
def opened(
    browser: Any, address: str, *, expected: tuple[str, ...] = (), hurried: bool = False, **options: Any
) -> Iterator[Any]:
    """A page in a context of its own. hurried: its timers of a second and more take a fifth of the time.

    A console error or warning that contains none of the `expected` texts fails the test. With
    BOUNCE_TEST_SCREENSHOTS set, the last page of a test is kept as a picture.
    """
    options = {"viewport": {"width": 1280, "height": 860}, "reduced_motion": "no-preference", **options}
    errors: list[str] = []
    context = browser.new_context(**options)
    for script in (_PIXELS, _HURRY)[: 1 + hurried]:
        context.add_init_script(script)
    page = context.new_page()
    page.set_default_timeout(TIMEOUT_MS)
    page.on("console", lambda message: message.type in ("error", "warning") and errors.append(message.text))
    page.on("pageerror", lambda error: errors.append(str(error)))
    try:
        page.goto(address)
        yield page
        if "BOUNCE_TEST_SCREENSHOTS" in os.environ:
            screenshot(page, os.environ["PYTEST_CURRENT_TEST"].split("::")[-1].split()[0])
    finally:
        context.close()
    unexpected = [error for error in errors if not any(text in error for text in expected)]
    assert unexpected == [], unexpected


def reopen(page: Any, address: str) -> None:
    """Load the page anew: where only what follows # changes, the view before is still there for a while."""
    page.goto("about:blank")
    page.goto(address)


def open_tab(page: Any, title: str) -> None:
    """Open a tab of a sweep, and wait until it has taken the place of the one before."""
    page.locator(".tabs a", has_text=title).click()
    page.locator(".tabs [aria-current]", has_text=title).wait_for()


def wait_shown(page: Any, **values: Any) -> None:
    """Wait until the plot shows these parameters."""
    page.wait_for_function(
        """values => {
            const shown = JSON.parse(document.querySelector(".panel .plot")?.dataset.shown ?? "{}");
            return Object.entries(values).every(([name, value]) => shown[name] === value);
        }""",
        arg=values,
    )


def picture(page: Any) -> str:
    """What the plot shows."""
    return str(page.eval_on_selector(".panel .plot canvas", "canvas => canvas.toDataURL()"))


def download(button: Any) -> Path:
    """The file that a click saves, with the name that it is given."""
    with button.page.expect_download() as saved:
        button.click()
    path = Path(saved.value.path())
    return path.rename(path.with_name(saved.value.suggested_filename))


def table_of(page: Any) -> list[dict[str, str]]:
    """The rows of an opened table, as its CSV has them."""
    with download(page.get_by_role("button", name="Download table as CSV")).open(newline="") as file:
        return list(csv.DictReader(file))


def watch_tasks(page: Any) -> None:
    """Record long tasks from the next load on, for `longest_task`."""
    page.add_init_script(_OBSERVE_TASKS)


def longest_task(page: Any) -> float:
    """The longest task that has blocked the page, ms; 0 if none took 50 ms."""
    # Entries are delivered in a task of their own, after the current ones.
    page.evaluate("new Promise((done) => setTimeout(() => requestAnimationFrame(() => setTimeout(done))))")
    return float(page.evaluate("window.longestTask"))


def screenshot(page: Any, name: str, *, whole: bool = True) -> None:
    """Keep a screenshot of the whole page, or of what the window shows, in test-artefacts/page."""
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=whole)
