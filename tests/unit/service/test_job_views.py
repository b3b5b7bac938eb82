"""How a job of the ledger is shown: its view, its tag, when to ask again, and the bounds of a list."""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from scripted import Held, sweep, wait_for
from served import get, service
from tables import for_each

from kernel.params import KERNEL_VERSION
from service.api.conditional import job_headers
from service.api.schemas import job_view
from service.jobs.model import JobRecord, JobState

SPEC = json.dumps(sweep().as_submitted())


def record(**changes: Any) -> JobRecord:
    """A running job of 1000 cells, of which 400 are done, 200 in this run, since second 100."""
    facts: dict[str, Any] = {
        "id": "a" * 32, "name": "", "spec": SPEC, "kernel_version": KERNEL_VERSION, "chunk_shape": (1, 1, 1),
        "chunks_total": 10, "cells_total": 1000, "seq": 1, "state": JobState.RUNNING,
        "cancel_requested": False, "error": None, "created": 90.0, "started": 95.0, "finished": None,
        "run_started": 100.0, "run_cells": 200, "chunks_done": 4, "cells_done": 400, "cells_settling": 0,
        "cells_computed": 0, "choice": None, "replaced_by": None,
    }  # fmt: skip
    return JobRecord(**facts | changes)


def test_the_time_left_is_that_at_the_moment_of_the_view():
    assert job_view(record(), 110.0).progress.eta_seconds == pytest.approx(30.0)
    assert job_view(record(), 120.0).progress.eta_seconds == pytest.approx(60.0)
    now = job_view(record(run_started=time.time() - 10.0)).progress.eta_seconds
    assert now is not None
    assert 30.0 <= now < 1e6


def test_a_notice_of_the_service_stands_in_for_that_of_the_job():
    assert job_view(record(), notice="no workers yet").notice == "no workers yet"
    old = record(kernel_version="1")
    assert job_view(old).notice == old.notice is not None
    assert job_view(old, notice="no workers yet").notice == "no workers yet"
    assert job_view(record()).notice is None


def test_a_list_leaves_out_a_specification_that_is_too_long():
    assert job_view(record(), longest_spec=len(SPEC)).spec == json.loads(SPEC)
    assert job_view(record(), longest_spec=len(SPEC) - 1).spec is None
    assert job_view(record()).spec == json.loads(SPEC)


@for_each("change", [
    {"failures": 1}, {"notice": "no workers yet"}, {"job": record(chunks_done=5)},
    {"job": record(state=JobState.DONE)}, {"job": record(pinned=True)},
])  # fmt: skip
def test_the_tag_changes_with_what_is_shown(change: dict[str, Any]):
    before = job_headers(record())
    assert before["ETag"].startswith('W/"')
    assert before["Cache-Control"] == "no-cache"
    assert job_headers(record()) == before
    assert job_headers(**{"job": record(), **change})["ETag"] != before["ETag"]


def test_a_job_that_is_not_computed_says_why_until_it_ends(tmp_path: Path):
    with service(tmp_path, Held(capacity=0)) as client:
        here = client.post("/v1/jobs", json=sweep().as_submitted()).headers["Location"]
        manager = client.app.state.service.manager  # type: ignore[attr-defined]
        wait_for(lambda: manager.cluster_fault is not None)
        assert get(client, here)["notice"] == manager.cluster_fault
        client.post(f"{here}/cancel")
        wait_for(lambda: bool(get(client, here)["state"] == "cancelled"))
        assert get(client, here)["notice"] is None


# When to ask again


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with service(tmp_path_factory.mktemp("data"), Held()) as client:
        yield client
