"""`GET /v1/tradeoff` and `bounce tradeoff`: the table of costs and errors, the advice, and the picture."""

import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import psutil
import pytest
from click.testing import CliRunner
from fastapi.testclient import TestClient
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox
from paths import CACHE, GOLDEN
from scripted import DEADLINE

from service.api.app import create_app
from service.cli.main import main
from service.cli.tradeoff import table_lines
from service.client import Client
from service.render.style import DPI
from service.render.work_precision import SIZE, compose, draw
from service.results.work_precision import REFERENCES, advice
from service.server.embedded import running
from service.settings import Settings
from worker.analysis import work_precision
from worker.analysis.work_precision import SETUPS, Measurement, measure
from worker.executors.dask import Dask
from worker.executors.inline import Inline

#: The setups that the advice needs; to measure them all takes a minute.
ADVISED = tuple(
    setup
    for setup in SETUPS
    if setup.model == "rigid" or (setup.purpose == "adhesive" and setup.model in ("soft", "ball"))
    or (setup.purpose, setup.scheme, setup.steps_per_contact) == ("adhesive", "verlet", 20)
)  # fmt: skip


@pytest.fixture(scope="module")
def measured() -> list[Measurement]:
    return [measure(setup) for setup in ADVISED]


# Table, advice and picture


def test_the_table_and_the_advice(measured: list[Measurement]):
    rows = [row.model_dump() for row in measured]
    lines = table_lines(rows, REFERENCES)
    assert len(lines) == len(ADVISED) + 9
    assert lines[0] == f"Errors relative to the {REFERENCES['adhesive']}"
    assert lines[2].split()[:3] == ["soft,", "d", "="]
    assert lines[2].split()[-3:] == ["exact", "exact", "100%"]
    text = advice(measured)
    assert text.startswith("Take rigid for a hard plate (")
    assert text.endswith("and auto to choose the model on the cells of your own sweep.")
    assert "nan" not in text


@pytest.mark.parametrize("format", ["png", "svg"])
def test_the_picture(measured: list[Measurement], format: str):
    picture = draw(measured, format)
    assert picture.startswith(b"\x89PNG" if format == "png" else b"<?xml")
    assert draw(measured, format) == picture


def test_no_label_of_the_picture_covers_another_or_a_marker():
    golden = json.loads((GOLDEN / "tradeoff_rows.json").read_text())
    rows = [Measurement.model_validate(row) for row in golden["rows"]]
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")
    compose(figure, rows)
    renderer = FigureCanvasAgg(figure).get_renderer()
    written = 0
    for axes in figure.axes:
        labels = [text.get_window_extent(renderer) for text in axes.texts if isinstance(text, Annotation)]
        boxes = [Text.get_window_extent(text, renderer) for text in axes.texts]
        points = [line.get_xydata()[0] for line in axes.lines if line.get_marker() != "None"]
        markers = [Bbox.from_bounds(x - 8, y - 8, 16, 16) for x, y in axes.transData.transform(points)]
        legend = axes.get_legend()
        others = [*markers, *([legend.get_window_extent(renderer)] if legend else [])]
        written += len(labels)
        for i, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in (*boxes[:i], *others))
    labelled = sum(row.error != 0.0 and (row.scheme or row.model) in ("verlet", "euler", "ball")
                   for row in rows if row.error is not None and row.cost is not None)  # fmt: skip
    assert written == labelled + 4 + 2  # the ends of two lines of depths, and two references


# Through the service


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, cluster: Dask) -> Iterator[str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(work_precision, "SETUPS", ADVISED)  # all of them take a minute
        with running(Settings(data=tmp_path_factory.mktemp("data"), port=0), cluster) as address:
            yield address


def test_workers_measure_once_for_all_requests(address: str):
    with Client(address) as client:
        first, second = client.tradeoff(), client.tradeoff()
        assert first == second
        assert [row["model"] for row in first["rows"]] == [setup.model for setup in ADVISED]
        assert first["cells"] == 80
        assert set(first["references"]) == {"adhesive", "nonadhesive", "plate"}
        assert client.tradeoff_picture("svg").startswith(b"<?xml")


def test_the_command_prints_the_table_and_writes_the_picture(address: str, tmp_path: Path):
    def bounce(*arguments: str) -> str:
        done = CliRunner().invoke(main, ["tradeoff", "--url", address, *arguments])
        assert done.exit_code == 0, done.output
        assert done.stderr.startswith("measuring")  # it may take a minute
        return done.stdout

    lines = bounce("-o", str(tmp_path / "tradeoff.png")).splitlines()
    assert lines[0].startswith("Errors relative to the exact soft contact")
    assert lines[-1].startswith("Take rigid")
    assert (tmp_path / "tradeoff.png").read_bytes().startswith(b"\x89PNG")
    rows = json.loads(bounce("--json"))["rows"]
    assert all(math.isfinite(row["cost"]) for row in rows)


def test_a_picture_of_another_kind_is_refused_before_anything_is_measured():
    done = CliRunner().invoke(main, ["tradeoff", "-o", "tradeoff.gif"])
    assert done.exit_code == 2
    assert "does not end in .png, .svg" in done.stderr


def test_another_format_is_refused(tmp_path: Path):
    executor = Inline()
    with TestClient(create_app(Settings(data=tmp_path), executor), base_url="http://localhost") as client:
        refused = client.get("/v1/tradeoff", params={"format": "bmp"})
    executor.close()
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == "format"


# While the workers measure


class Slow(Inline):
    """An executor whose calls a test completes."""

    def __init__(self) -> None:
        super().__init__()
        self.futures: list[Future[Any]] = []

    def call(self, function: Any, *arguments: Any) -> Any:
        self.futures.append(Future())
        return self.futures[-1]


def test_a_request_before_the_end_gets_the_progress(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(work_precision, "SETUPS", ADVISED[:3])
    executor = Slow()
    with TestClient(create_app(Settings(data=tmp_path), executor), base_url="http://localhost") as client:
        first = client.get("/v1/tradeoff")
        assert (first.status_code, first.headers["Retry-After"]) == (202, "1")
        assert first.headers["Content-Type"] == "application/json"
        progress = {"parts_done": 0, "parts_total": 3, "percent": 0.0}
        assert first.json() == {"state": "running", "progress": progress}
        executor.futures[0].set_result(None)
        assert client.get("/v1/tradeoff").json()["progress"] == {**progress, "parts_done": 1, "percent": 33.3}
        answers = client.get("/openapi.json").json()["paths"]["/v1/tradeoff"]["get"]["responses"]
        assert answers["202"]["content"]["application/json"]["schema"]["$ref"].endswith("/PendingView")
    executor.close()
    assert executor.futures[1].cancelled()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_no_folder_and_no_process(tmp_path: Path, number: signal.Signals):
    """The service of its own that `bounce tradeoff` computes with."""
    env = os.environ | {"TMPDIR": str(tmp_path), "NUMBA_CACHE_DIR": str(CACHE)}
    command = [sys.executable, "-m", "service.cli.main", "tradeoff", "--workers", "1"]
    with subprocess.Popen(
        command, env=env, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
        # Not ignored, as `nohup` has it for all that it starts.
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # noqa: PLW1509
    ) as process:  # fmt: skip
        assert process.stderr
        lines = iter(process.stderr.readline, b"")
        assert next(line for line in lines if line.startswith(b"measuring"))
        family = psutil.Process(process.pid).children(recursive=True)
        assert family
        assert any(tmp_path.iterdir())
        process.send_signal(number)
        assert process.wait(DEADLINE) == 128 + number
    assert list(tmp_path.iterdir()) == []
    assert psutil.wait_procs(family, DEADLINE)[1] == []
