"""`GET /v1/tradeoff` and `bounce tradeoff`: the table of costs and errors, the advice, and the picture."""

import json
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from paths import GOLDEN
from served import impatient

from service.api.app import create_app
from service.cli.tradeoff import table_lines
from service.results.work_precision import REFERENCES, advice
from service.settings import Settings
from worker.analysis import work_precision
from worker.analysis.work_precision import SETUPS, Measurement, Setup
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
    """As once measured: tests/system/worker/test_work_precision.py measures."""
    rows = json.loads((GOLDEN / "tradeoff_rows.json").read_text())["rows"]
    measurements = map(Measurement.model_validate, rows)
    return [
        row for row in measurements if Setup(**row.model_dump(include=set(Setup.model_fields))) in ADVISED
    ]


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


# Through the service


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
    impatient(monkeypatch)
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
