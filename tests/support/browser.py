"""A real Chromium for the tests, and what every one of its pages is watched for."""

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from paths import ROOT

SHOTS = ROOT / "test-artefacts" / "page"
ARGUMENTS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-dev-shm-usage",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
#: For anything to happen, ms, on a machine with far too much to do.
PATIENCE_MS = 120_000


def _found() -> str | None:
    """Where a Chromium is that runs: a name may stand for one that is to be installed first."""
    for name in ("chromium", "chromium-browser"):
        path = shutil.which(name)
        if (
            path
            and b"Chromium" in subprocess.run([path, "--version"], capture_output=True, check=False).stdout
        ):
            return path
    return None


CHROMIUM = _found()
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium on this machine: `apt-get install chromium` brings it"
)

#: A line of a million flights, in half a second: what they are does not matter here.
LONG_LINE: dict[str, Any] = {
    "name": "A million flights",
    "gamma": {"start": 1.1, "stop": 6.0, "num": 20_000},
    "omega": 0.5,
    "xi": 0.05,
    "model": {"kind": "rigid"},
    "settle": 2,
    "observe": 70,
    "keep": 64,
}

#: Moves the first slider to these places one by one; the time until each is drawn, ms.
_MOVE = """async places => {
    const slider = document.querySelector(".panel input[type=range]");
    const plot = document.querySelector(".panel .plot");
    const took = [];
    for (const place of places) {
        const before = plot.dataset.shows, start = performance.now();
        slider.value = place;
        slider.dispatchEvent(new Event("input", { bubbles: true }));
        while (plot.dataset.shows === before) await new Promise((next) => setTimeout(next));
        await new Promise((next) => requestAnimationFrame(next));
        took.push(performance.now() - start);
    }
    return took;
}"""

_WATCH = """window.longest = 0;
new PerformanceObserver((list) => list.getEntries().forEach((entry) => {
    window.longest = Math.max(window.longest, entry.duration);
})).observe({ entryTypes: ["longtask"] })"""


@contextmanager
def chromium() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS, timeout=PATIENCE_MS)
        yield browser
        browser.close()


@contextmanager
def opened(browser: Any, address: str, *, expected: tuple[str, ...] = (), **given: Any) -> Iterator[Any]:
    """A page in a window of its own; whatever it complains of, but what is expected, is an error."""
    given = {"viewport": {"width": 1280, "height": 860}, "reduced_motion": "no-preference", **given}
    complaints: list[str] = []
    context = browser.new_context(**given)
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.on("console", lambda said: said.type in ("error", "warning") and complaints.append(said.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    try:
        page.goto(address)
        yield page
    finally:
        context.close()
    assert [one for one in complaints if not any(known in one for known in expected)] == []


def wait_shown(page: Any, **wanted: Any) -> None:
    """Until the plot shows these values."""
    page.wait_for_function(
        """wanted => {
            const shows = document.querySelector(".panel .plot")?.dataset.shows;
            const found = JSON.parse(shows ?? "{}");
            return Object.entries(wanted).every(([name, value]) => found[name] === value);
        }""",
        arg=wanted,
    )


def redraws(page: Any, places: list[int]) -> list[float]:
    """Moves the first slider of a view to these places; how long each took until it was drawn, ms."""
    return [float(took) for took in page.evaluate(_MOVE, places)]


def watch_tasks(page: Any) -> None:
    """From the next load on, `longest_task` knows."""
    page.add_init_script(_WATCH)


def longest_task(page: Any) -> float:
    """The longest that anything has kept the page busy, ms; 0 if nothing did for 50."""
    # What is observed is told in a task of its own, after those under way.
    page.evaluate("new Promise((done) => setTimeout(() => requestAnimationFrame(() => setTimeout(done))))")
    return float(page.evaluate("window.longest"))


def shoot(page: Any, name: str) -> None:
    """Keep what is seen, to be looked at."""
    SHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SHOTS / f"{name}.png", full_page=True)
