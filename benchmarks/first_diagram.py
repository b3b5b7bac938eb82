"""Stopwatch: from the installation to one's own first diagram, in the shell, a notebook, the browser.

    python -m benchmarks.first_diagram [--installed]

Installs the project into a new virtual environment (with pip's cache as it is), then makes the same diagram
in three ways, each at first without compiled kernels and then with. Needs Chromium for the browser.
`--installed` measures the environment that this runs in instead.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from benchmarks.measuring import describe, options
from tests.support.browser import ROOT, chromium, opened

SPEC: Final[dict[str, Any]] = {
    "name": "my first sweep",
    "gamma": {"start": 0.5, "stop": 6.0, "num": 221},
    "omega": 0.5,
    "xi": 0.26,
    "model": {"kind": "rigid"},
}
#: A cell of a notebook.
CELL: Final = f"""
from service.local import run

sweep = run({SPEC!r}, progress=False)
sweep.bounce.plot().figure.savefig("diagram.png")
"""
LIMIT: Final = 900.0

Environment = Mapping[str, str]


def shell(python: Path, folder: Path, environment: Environment) -> None:
    """`bounce run sweep.json -o diagram.png`, after the file was written."""
    (folder / "sweep.json").write_text(json.dumps(SPEC))
    words = [str(python.with_name("bounce")), "run", "sweep.json", "-o", "diagram.png"]
    _run([*words, "--omega", "0.5", "--xi", "0.26"], folder, environment)


def notebook(python: Path, folder: Path, environment: Environment) -> None:
    """One cell; that of a new kernel, which starts as `python` does."""
    _run([str(python), "-c", CELL], folder, environment)


def browser(python: Path, folder: Path, environment: Environment) -> None:
    """`bounce serve`, the address opened, the form edited, its button pressed: until the diagram is drawn."""
    with (
        _serving(python, folder, environment) as address,
        chromium() as chrome,
        opened(chrome, address) as page,
    ):
        page.set_default_timeout(1000 * LIMIT)
        page.get_by_role("link", name="New", exact=True).click()
        presets = page.get_by_label("Start from")
        presets.select_option(label=presets.locator("option", has_text="Fig. 2").first.inner_text())
        page.locator(".cost", has_text="cells in").wait_for()
        page.get_by_label("Name").fill(SPEC["name"])
        page.locator("[data-field='gamma.num']").fill(str(SPEC["gamma"]["num"]))
        page.get_by_label("contact model").select_option("rigid")
        page.get_by_role("button", name="Compute").click()
        page.locator(".progress[data-state=done]").wait_for()
        page.locator(".panel .plot[data-shown]").wait_for()
        page.screenshot(path=folder / "diagram.png")


#: What a user does, and how it is measured.
WAYS: Final[dict[str, tuple[str, Callable[[Path, Path, Environment], None]]]] = {
    "shell": ("2 commands: write sweep.toml, bounce run", shell),
    "notebook": ("2 lines of one cell: run(…), .bounce.plot()", notebook),
    "browser": ("2 commands: bounce serve, bounce open; Fig. 2, three fields, Compute", browser),
}


def _run(words: list[str], folder: Path, environment: Environment) -> None:
    subprocess.run(words, cwd=folder, env=environment, check=True, capture_output=True, timeout=LIMIT)


@contextmanager
def _serving(python: Path, folder: Path, environment: Environment) -> Iterator[str]:
    words = [str(python.with_name("bounce")), "serve", "--port", "0"]
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(
            words, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=log, text=True
        )
    assert process.stdout is not None
    try:
        yield process.stdout.readline().split("listens on ")[1].split()[0]
    finally:
        process.terminate()
        process.communicate(timeout=LIMIT)


def install(folder: Path) -> tuple[Path, float]:
    """The Python of a new environment with the project, and the seconds that this took."""
    began = time.perf_counter()
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    python = folder / "bin" / "python"
    subprocess.run([str(python), "-m", "pip", "install", "-q", "-e", str(ROOT)], check=True)
    return python, time.perf_counter() - began


def main() -> None:
    """Print the table."""
    arguments = options(__doc__, installed=False)
    print(describe(), f"load {os.getloadavg()[0]:.1f}", flush=True)
    with tempfile.TemporaryDirectory() as name:
        root, python = Path(name), Path(sys.executable)
        if not arguments.installed:
            python, seconds = install(root / "venv")
            print(f"install: 1 command, {seconds:.0f} s", flush=True)
        for way, (steps, make) in WAYS.items():
            environment = {
                **{name: value for name, value in os.environ.items() if not name.startswith("BOUNCE_")},
                "NUMBA_CACHE_DIR": str(root / f"cache-{way}"),
            }
            times = []
            for state in ("cold", "warm"):
                folder = root / f"{way}-{state}"
                folder.mkdir()
                began = time.perf_counter()
                make(python, folder, environment)
                times.append(time.perf_counter() - began)
                assert (folder / "diagram.png").stat().st_size > 1000
            cold, warm = times
            load = os.getloadavg()[0]
            print(f"| {way} | {steps} | {cold:.0f} s | {warm:.0f} s |   load {load:.1f}", flush=True)


if __name__ == "__main__":
    main()
