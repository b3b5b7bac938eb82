"""The page in a real Chromium on a store of a million cells: how soon it is there, how soon a slider redraws.

    python -m benchmarks.page [--moves 40] [--cells 1000]

Needs Chromium. The service is the embedded one with two workers; nothing of what the sliders ask for has been
read before, except what the page itself fetches ahead of them.
"""

import argparse
import random
import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.machine import describe
from service.client import Client, Job
from service.server import embedded
from tests.support.browser import LONG_LINE, chromium, longest_task, opened, redraws, wait_shown, watch_tasks

#: How often a page is opened.
VIEWS = 7
#: The first motion of a service's life may wait for a compiler.
COMPILING_MS = 180_000
#: What is there once a view is.
MOVING, SHOWN = ".player[data-phase]", ".panel .plot[data-shown]"


def map_of(cells: int) -> dict[str, Any]:
    """A sweep of cells × cells."""
    return {
        "name": "A million cells",
        "gamma": {"start": 0.5, "stop": 6.0, "num": cells},
        "omega": {"start": 0.4, "stop": 1.6, "num": cells},
        "xi": 0.05,
        "model": {"kind": "rigid"},
        "settle": 2,
        "observe": 8,
        "keep": 8,
    }


def told(what: str, times: Sequence[float]) -> str:
    """A line: median and 95th percentile, ms."""
    p95 = statistics.quantiles(times, n=20, method="inclusive")[-1]
    return f"{what:<48}{statistics.median(times):7.0f} ms{p95:9.0f} ms   of {len(times)}"


def first_view(browser: Any, address: str, seen: str) -> float:
    """From nothing, no cache, to what `seen` selects, ms."""
    with opened(browser, address) as page:
        page.locator(seen).first.wait_for(timeout=COMPILING_MS)
        return float(page.evaluate("performance.now()"))


def slider(browser: Any, url: str, job: Job, along: str, places: list[int]) -> list[float]:
    """The times to redraw of a view along one axis, its slider moved to these places, ms."""
    with opened(browser, f"{_view(url, job, 'diagram')}?along={along}") as page:
        wait_shown(page, along=along)
        return redraws(page, places)


def busiest(browser: Any, url: str, line: Job, grid: Job) -> float:
    """The longest task while a million flights and a map of a million cells are looked at, ms."""
    with opened(browser, "about:blank") as page:
        watch_tasks(page)
        page.goto(_view(url, line, "diagram"))
        wait_shown(page, along="gamma")
        page.locator(".panel .plot").focus()
        for key in ("ArrowRight", "+", "0"):
            page.keyboard.press(key)
        flights = longest_task(page)
        page.goto(_view(url, grid, "modes"))
        page.reload()
        wait_shown(page, xi=0.05)
        return max(flights, longest_task(page))


def _view(url: str, job: Job, tab: str) -> str:
    return f"{url}/#/job/{job.id}/{tab}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moves", type=int, default=40)
    parser.add_argument("--cells", type=int, default=1000, help="along each of two axes")
    given = parser.parse_args()
    anywhere = random.Random(7).sample(range(given.cells), given.moves)
    start = given.cells // 3
    steps = [start + place for place in range(given.moves)]
    print(describe("zarr"))
    with tempfile.TemporaryDirectory() as folder:
        settings = embedded.settings(data=Path(folder), workers=2, host="127.0.0.1", port=0)
        with embedded.running(settings) as url, Client(url) as client, chromium() as browser:
            grid, line = (
                client.submit(spec).wait(progress=False) for spec in (map_of(given.cells), LONG_LINE)
            )
            print(f"a spring moves after the service's start: {first_view(browser, url, MOVING):.0f} ms")
            print(f"{'':<48}{'median':>10}{'95 %':>12}")
            print(
                told(
                    "first view: the list, and a spring that moves",
                    _views(browser, url, MOVING),
                )
            )
            print(
                told(
                    "first view: a diagram of the million cells",
                    _views(browser, _view(url, grid, "diagram"), SHOWN),
                )
            )
            for along, moved in (("gamma", "Ω"), ("omega", "Γ")):
                print(told(f"{moved} slider, anywhere", slider(browser, url, grid, along, anywhere)))
                print(told(f"{moved} slider, step by step", slider(browser, url, grid, along, steps)))
            print(f"longest task: {busiest(browser, url, line, grid):.0f} ms (0: none of 50 ms or more)")


def _views(browser: Any, address: str, seen: str) -> list[float]:
    return [first_view(browser, address, seen) for _ in range(VIEWS)]


if __name__ == "__main__":
    main()
