"""Metrics of a service that computes, and the dashboard that shows them."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from paths import ROOT
from prometheus_client.parser import text_string_to_metric_families
from scripted import Held, Scripted, wait_for
from served import RAMP, finished, get, service
from tables import for_each

from worker.executors.base import ClusterState

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
    """After a job of which one chunk failed once."""
    folder = tmp_path_factory.mktemp("data")
    executor = Scripted()
    executor.script[1] = [ValueError("not yet")]
    with service(folder, executor) as client:
        here = finished(client, RAMP)
        found = samples(client)
        chunks = get(client, here)["progress"]["chunks_total"]
    assert found["bounce_chunks_computed_total"] == [({}, chunks)]
    executor.close()
    return found


def test_chunks_jobs_and_cells_are_counted_by_what_became_of_them(measured: dict[str, Any]):
    [(_, computed)] = measured["bounce_chunks_computed_total"]
    buckets = [(labels["le"], value) for labels, value in measured["bounce_chunk_duration_seconds_bucket"]]
    assert buckets[-1] == ("+Inf", computed)
    assert [value for _, value in buckets] == sorted(value for _, value in buckets)
    assert measured["bounce_chunk_duration_seconds_sum"] == measured["bounce_chunk_seconds_total"]
    assert ({"action": "retry", "error": "ValueError"}, 1.0) in measured["bounce_chunks_returned_total"]
    assert measured["bounce_chunks_in_flight"] == [({}, 0.0)]
    assert measured["bounce_chunks_damaged_total"] == [({}, 0.0)]
    jobs = {labels["state"]: value for labels, value in measured["bounce_jobs"]}
    assert jobs == {"queued": 0.0, "running": 0.0, "done": 1.0, "failed": 0.0, "cancelled": 0.0}
    assert measured["bounce_chunks_done"] == measured["bounce_chunks_computed_total"]
    assert measured["bounce_cells_done"] == [({}, 88.0)]
    assert measured["bounce_ready"] == [({}, 1.0)]


class Cluster(Held):
    """Three workers compute, one is refused, and five are planned, or nobody knows how many."""

    planned: int | None = 5

    def state(self) -> ClusterState:
        return ClusterState(True, 3, planned=self.planned, refused=("an old one",))


def test_workers_are_counted_by_what_becomes_of_them(tmp_path: Path):
    cluster = Cluster()
    with service(tmp_path, cluster) as client:
        counted = {labels["state"]: value for labels, value in samples(client)["bounce_workers"]}
        assert counted == {"computing": 3.0, "refused": 1.0, "planned": 5.0}
        cluster.planned = None
        wait_for(lambda: len(samples(client)["bounce_workers"]) == 2)


def test_a_method_that_callers_make_up_is_no_label_of_its_own(tmp_path: Path):
    with service(tmp_path, Held()) as client:
        client.request("BREW", "/v1/jobs")
        client.put("/v1/jobs")
        methods = [labels["method"] for labels, _ in samples(client)["bounce_http_requests_total"]]
    assert sorted(methods) == ["PUT", "other"]


def expressions() -> list[str]:
    return [target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]]


@for_each("expression", expressions())
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


def test_every_metric_of_the_service_is_on_the_dashboard(measured: dict[str, Any]):
    shown = {name for expression in expressions() for name, _ in _SELECTOR.findall(expression)}
    families = {
        re.sub(r"_(bucket|sum|count|created)$", "", name) for name in measured if name.startswith("bounce")
    }
    missing = {name for name in families if not any(known.startswith(name) for known in shown)}
    assert missing == set()
