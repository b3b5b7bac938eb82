"""The page in Chromium on a store of a million cells: time to the first view, and of a step while it moves.

    python -m benchmarks.page [--moves 40] [--cells 1000] [--against FOLDER]

Needs Chromium. Services have two workers. The sliders request data that were not read before. FOLDER is a
checkout with an environment of its own in `.venv`; the browser visits both services in turn.
"""

import random
import socket
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measuring import HERE, describe, options, ratio, table
from service.client import Client
from tests.support.browser import LONG_LINE, chromium, longest_task, opened, wait_shown, watch_tasks

#: How often a page is opened.
VIEWS = 7
#: Time-out, ms: the first trajectory of a service may wait for compilation.
COMPILING_MS = 180_000
#: Selectors of elements that exist when a view is complete.
MOVING, SHOWN = ".player[data-phase]", ".panel .plot[data-shown]"
#: Keys that zoom, and back to everything.
ZOOMS = "+++---0" * 4

#: Pause after a key, ms: results of the window may come.
PAUSE_MS = 150

#: Moves the first slider to each index and returns the times until the plot was redrawn, ms.
MOVE_SLIDER = """async indices => {
    const slider = document.querySelector("main .slider:not([hidden]) input[type=range]");
    const plot = document.querySelector(".panel .plot");
    const times = [];
    for (const index of indices) {
        const before = plot.dataset.shown, start = performance.now();
        slider.value = index;
        slider.dispatchEvent(new Event("input", { bubbles: true }));
        while (plot.dataset.shown === before) await new Promise((next) => setTimeout(next));
        await new Promise((next) => requestAnimationFrame(next));
        times.push(performance.now() - start);
    }
    return times;
}"""


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


def wait_ready(port: int) -> None:
    """Wait until something answers at a port."""
    for _ in range(600):
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
            return
        time.sleep(0.1)
    raise TimeoutError(f"nothing answers at port {port}")


@contextmanager
def served(checkout: Path) -> Iterator[str]:
    """The address of a service of a checkout, with a folder of its own."""
    with tempfile.TemporaryDirectory() as folder, socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()
        command = [
            checkout / ".venv/bin/bounce",
            "serve",
            "--data",
            folder,
            "--port",
            str(port),
            "--workers",
            "2",
        ]
        with subprocess.Popen(command, cwd=checkout, stderr=subprocess.DEVNULL) as process:
            try:
                wait_ready(port)
                yield f"http://127.0.0.1:{port}"
            finally:
                process.terminate()


def first_view(browser: Any, address: str, selector: str) -> list[float]:
    """Time from navigation without a cache until an element of `selector` exists, ms."""
    with opened(browser, address) as page:
        page.locator(selector).first.wait_for(timeout=COMPILING_MS)
        return [float(page.evaluate("performance.now()"))]


def slider(browser: Any, diagram: str, along: str, positions: list[int]) -> list[float]:
    """Times to redraw a diagram along one axis after its slider moves to each of `positions`, ms."""
    with opened(browser, f"{diagram}?along={along}") as page:
        wait_shown(page, along=along)
        return [float(time) for time in page.evaluate(MOVE_SLIDER, positions)]


def zoom(browser: Any, view: str) -> list[float]:
    """What the browser's main thread works for each of ZOOMS, ms."""
    with opened(browser, view) as page:
        page.locator(SHOWN).wait_for()
        page.locator(SHOWN).focus()
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable")
        times = []
        for key in ZOOMS:
            before = worked(session)
            page.keyboard.press(key)
            page.wait_for_timeout(PAUSE_MS)
            times.append(worked(session) - before)
        return times


def worked(session: Any) -> float:
    """Time that the main thread has worked, ms."""
    metrics = session.send("Performance.getMetrics")["metrics"]
    return 1e3 * next(float(each["value"]) for each in metrics if each["name"] == "TaskDuration")


def busiest(browser: Any, line: str, grid: str) -> list[float]:
    """The longest task of the browser while it shows a million flights and a map of a million cells, ms."""
    with opened(browser, "about:blank") as page:
        watch_tasks(page)
        page.goto(line)
        wait_shown(page, along="gamma")
        page.locator(".panel .plot").focus()
        for key in ("ArrowRight", "+", "0"):
            page.keyboard.press(key)
        flights = longest_task(page)
        page.goto(grid)
        page.reload()
        wait_shown(page, xi=0.05)
        return [max(flights, longest_task(page))]


def main() -> None:
    """Print the table."""
    arguments = options(__doc__, moves=40, cells=1000, against="")
    anywhere = random.Random(7).sample(range(arguments.cells), arguments.moves)
    start = arguments.cells // 3
    steps = list(range(start, start + arguments.moves))
    checkouts = [HERE, *([Path(arguments.against).resolve()] if arguments.against else [])]
    print(describe("zarr"))
    with ExitStack() as stack:
        browser = stack.enter_context(chromium())
        urls = [stack.enter_context(served(checkout)) for checkout in checkouts]
        views = []
        for url in urls:
            with Client(url, timeout=60.0) as client:
                line, grid = (
                    client.submit(spec).wait(progress=False) for spec in (LONG_LINE, map_of(arguments.cells))
                )
            views.append([f"{url}/#/explore", f"{url}/#/job/{line.id}/diagram", f"{url}/#/job/{grid.id}"])
            first_view(browser, views[-1][0], MOVING)  # compiles

        def row(name: str, times: Callable[[list[str]], list[float]], repeat: int = 1) -> list[str]:
            rounds = np.array(
                [[times(each) for each in views] for _ in range(repeat)]
            )  # (repeat, services, n)
            of = np.moveaxis(rounds, 1, 2).reshape(-1, len(views))
            p95 = statistics.quantiles(of[:, 0], n=20, method="inclusive")[-1] if len(of) > 1 else of[0, 0]
            cells = [name, f"{np.median(of[:, 0]):.0f}", f"{p95:.0f}"]
            return (
                cells if len(views) == 1 else [*cells, f"{np.median(of[:, 1]):.0f}", f"{ratio(of, 0, 1):.2f}"]
            )

        rows = [
            row("first view: a moving spring", lambda at: first_view(browser, at[0], MOVING), VIEWS),
            row(
                "first view: diagram of a million cells",
                lambda at: first_view(browser, f"{at[2]}/diagram", SHOWN),
                VIEWS,
            ),
            row(
                "first view: map of a million cells",
                lambda at: first_view(browser, f"{at[2]}/modes", SHOWN),
                VIEWS,
            ),
            row("a step of zooming a million flights", lambda at: zoom(browser, at[1]), 3),
            row("a step of zooming a map", lambda at: zoom(browser, f"{at[2]}/modes"), 3),
            *(
                row(
                    f"{moved} slider, {how}",
                    lambda at, a=along, p=positions: slider(browser, f"{at[2]}/diagram", a, p),
                )
                for along, moved in (("gamma", "Ω"), ("omega", "Γ"))
                for how, positions in (("random", anywhere), ("step by step", steps))
            ),
            row("longest task", lambda at: busiest(browser, at[1], f"{at[2]}/modes")),
        ]
        print(table(["ms", "median", "95 %", *(["the other", "ratio"] if len(views) > 1 else [])], rows))


if __name__ == "__main__":
    main()
