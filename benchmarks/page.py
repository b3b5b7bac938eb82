"""The page in Chromium on a store of a million cells: time to the first view, time to redraw.

    python -m benchmarks.page [--moves 40] [--cells 1000]

Needs Chromium. The service is the embedded one with two workers. The sliders request data that were not read
before.
"""

import random
import statistics
from collections.abc import Sequence
from typing import Any

from benchmarks.measuring import describe, options, service
from service.client import Job
from tests.support.browser import LONG_LINE, chromium, longest_task, opened, redraws, wait_shown, watch_tasks

#: How often a page is opened.
VIEWS = 7
#: Time-out, ms: the first trajectory of a service may wait for compilation.
COMPILING_MS = 180_000
#: Selectors of elements that exist when a view is complete.
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


def summary(label: str, times: Sequence[float]) -> str:
    """One row: median and 95th percentile, ms."""
    p95 = statistics.quantiles(times, n=20, method="inclusive")[-1]
    return f"{label:<48}{statistics.median(times):7.0f} ms{p95:9.0f} ms   of {len(times)}"


def first_view(browser: Any, address: str, selector: str) -> float:
    """Time from navigation without a cache until an element of `selector` exists, ms."""
    with opened(browser, address) as page:
        page.locator(selector).first.wait_for(timeout=COMPILING_MS)
        return float(page.evaluate("performance.now()"))


def slider(browser: Any, url: str, job: Job, along: str, positions: list[int]) -> list[float]:
    """Times to redraw a diagram along one axis after its slider moves to each of `positions`, ms."""
    with opened(browser, f"{_view(url, job, 'diagram')}?along={along}") as page:
        wait_shown(page, along=along)
        return redraws(page, positions)


def busiest(browser: Any, url: str, line: Job, grid: Job) -> float:
    """The longest task of the browser while it shows a million flights and a map of a million cells, ms."""
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
    arguments = options(__doc__, moves=40, cells=1000)
    anywhere = random.Random(7).sample(range(arguments.cells), arguments.moves)
    start = arguments.cells // 3
    steps = list(range(start, start + arguments.moves))
    print(describe("zarr"))
    with service() as (client, url, _), chromium() as browser:
        grid, line = (
            client.submit(spec).wait(progress=False) for spec in (map_of(arguments.cells), LONG_LINE)
        )
        print(f"first moving spring of the service: {first_view(browser, url, MOVING):.0f} ms")
        print(f"{'':<48}{'median':>10}{'95 %':>12}")
        print(summary("first view: list of jobs and moving spring", _views(browser, url, MOVING)))
        diagram = _view(url, grid, "diagram")
        print(summary("first view: diagram of a million cells", _views(browser, diagram, SHOWN)))
        for along, moved in (("gamma", "Ω"), ("omega", "Γ")):
            print(summary(f"{moved} slider, random", slider(browser, url, grid, along, anywhere)))
            print(summary(f"{moved} slider, step by step", slider(browser, url, grid, along, steps)))
        print(f"longest task: {busiest(browser, url, line, grid):.0f} ms (0: none of 50 ms or more)")


def _views(browser: Any, address: str, selector: str) -> list[float]:
    return [first_view(browser, address, selector) for _ in range(VIEWS)]


if __name__ == "__main__":
    main()
