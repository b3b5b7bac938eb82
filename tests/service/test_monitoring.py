"""Metrics of a service that computes, and the dashboard that shows them."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from paths import ROOT
from prometheus_client.parser import text_string_to_metric_families
from scripted import Scripted, wait_for
from served import RAMP, finished, get, service
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from service.api.middleware.access_log import AccessLog
from service.api.monitoring import Metrics

DASHBOARD: dict[str, Any] = json.loads((ROOT / "docs" / "grafana.json").read_text())

#: Samples of PromQL: a name and its labels.
_SELECTOR = re.compile(r"\b((?:bounce|process)_\w+)\{([^}]*)\}")


def samples(client: TestClient) -> dict[str, list[tuple[dict[str, str], float]]]:
    """Labels and values by name."""
    found: dict[str, list[tuple[dict[str, str], float]]] = {}
    for family in text_string_to_metric_families(client.get("/metrics").text):
        for sample in family.samples:
            found.setdefault(sample.name, []).append((sample.labels, sample.value))
    return found


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[dict[str, str], float]]]:
    """After a job of which one chunk failed once, and a restart that verified it."""
    folder = tmp_path_factory.mktemp("data")
    executor = Scripted()
    executor.script[1] = [ValueError("not yet")]
    with service(folder, executor) as client:
        here = finished(client, RAMP)
        before = samples(client)
        chunks = get(client, here)["progress"]["chunks_total"]
    assert before["bounce_chunks_computed_total"] == [({}, chunks)]
    with service(folder, executor) as client:
        wait_for(lambda: samples(client)["bounce_chunks_verified_total"] == [({}, chunks)])
        after = samples(client)
    executor.close()
    return before | {
        name: after[name] for name in ("bounce_chunks_verified_total", "bounce_chunks_damaged_total")
    }


def test_chunks_are_counted_by_what_became_of_them(measured: dict[str, Any]):
    [(_, computed)] = measured["bounce_chunks_computed_total"]
    buckets = [(labels["le"], value) for labels, value in measured["bounce_chunk_duration_seconds_bucket"]]
    assert buckets[-1] == ("+Inf", computed)
    assert [value for _, value in buckets] == sorted(value for _, value in buckets)
    assert measured["bounce_chunk_duration_seconds_sum"] == measured["bounce_chunk_seconds_total"]
    assert ({"action": "retry", "error": "ValueError"}, 1.0) in measured["bounce_chunks_returned_total"]
    assert measured["bounce_chunks_in_flight"] == [({}, 0.0)]
    assert measured["bounce_chunks_damaged_total"] == [({}, 0.0)]


def test_workers_and_what_is_left_are_told(measured: dict[str, Any]):
    assert {labels["state"] for labels, _ in measured["bounce_workers"]} >= {"computing", "refused"}
    assert measured["bounce_core_seconds_remaining"][0][1] >= 0.0
    [(build, _)] = measured["bounce_build_info"]
    assert set(build) == {"version", "kernel_version"}


def expressions() -> list[str]:
    return [target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]]


@pytest.mark.parametrize("expression", expressions())
def test_the_dashboard_asks_for_what_there_is(expression: str, measured: dict[str, Any]):
    """Names, labels and the values of labels; `instance` and `le` are Prometheus's own."""
    selectors = _SELECTOR.findall(expression)
    assert selectors
    assert len(selectors) == len(re.findall(r"\b(?:bounce|process)_", expression))
    for name, conditions in selectors:
        assert name in measured, name
        labels = set().union(*(labels for labels, _ in measured[name])) | {"instance", "le"}
        for label in re.findall(r"(\w+)=~?", conditions):
            assert label in labels, (name, label)
        for group in re.findall(r"by \(([^)]*)\)", expression):
            assert {label.strip() for label in group.split(",")} <= labels


def test_what_the_dashboard_selects_by_state_exists(measured: dict[str, Any]):
    for name in ("bounce_jobs", "bounce_workers"):
        known = {labels["state"] for labels, _ in measured[name]}
        for expression in expressions():
            for states in re.findall(name + r"\{[^}]*state=~?\"([^\"]*)\"", expression):
                assert set(states.split("|")) <= known


def test_every_metric_of_the_service_is_on_the_dashboard(measured: dict[str, Any]):
    shown = {name for expression in expressions() for name, _ in _SELECTOR.findall(expression)}
    families = {
        re.sub(r"_(bucket|sum|count|created)$", "", name) for name in measured if name.startswith("bounce")
    }
    missing = {name for name in families if not any(known.startswith(name) for known in shown)}
    assert missing == set()


def test_the_dashboard_can_be_imported():
    identifiers = [panel["id"] for panel in DASHBOARD["panels"]]
    assert len(set(identifiers)) == len(identifiers)
    places = {(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in DASHBOARD["panels"]}
    assert len(places) == len(identifiers)
    assert {panel["type"] for panel in DASHBOARD["panels"]} <= {"timeseries", "stat"}
    assert all(panel["title"] and panel["description"] for panel in DASHBOARD["panels"])
    assert str(Path("docs/grafana.json").name) in (ROOT / "docs" / "deployment.md").read_text()


@pytest.mark.parametrize(("status", "level"), [(200, "DEBUG"), (399, "DEBUG"), (400, "INFO"), (503, "INFO")])
def test_polls_are_logged_if_they_fail(caplog: pytest.LogCaptureFixture, status: int, level: str):
    async def answer(request: Request) -> Response:
        return Response(status_code=status)

    caplog.set_level("DEBUG", logger="service.requests")
    app = Starlette(routes=[Route("/readyz", answer)])
    with TestClient(AccessLog(app, Metrics())) as client:
        client.get("/readyz")
    assert [(record.message, record.levelname) for record in caplog.records] == [("request", level)]
