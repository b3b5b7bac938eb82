"""Proofs over HTTP and in the client: on demand, and nothing of them without."""

from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from service.client import Client
from service.views import proofs

pytest.importorskip("flint", reason="needs the extra proofs")

SPRING: dict[str, Any] = {"omega": 0.6, "xi": 0.05}


def test_a_threshold_has_a_proven_bound_and_says_what_was_taken(python_client: Client):
    answer = python_client.threshold(**SPRING, prove=True)
    assert (answer.proof, answer.down_at_most) == ("proven", "0.553244593224092932")
    low, high = map(float, answer.proven_flight_time.values)
    assert low <= high < low + 1e-14
    assert abs(low - 4.18293) < 1e-4
    assert "omega = 0.6 and xi = 0.05 are these decimals" in str(answer.proof_says.values)


def test_events_say_whether_all_of_their_kind_were_counted(python_client: Client):
    answer = python_client.orbits(**SPRING, modes="1-1,1-2", prove=True)
    counted = {kind: set() for kind in ("fold", "flip", "graze-flight")}
    for kind, complete in zip(answer.event_kind.values, answer.event_complete.values, strict=True):
        counted.setdefault(str(kind), set()).add(bool(complete))
    assert counted.pop("fold") == counted.pop("flip") == {True}
    assert set.union(*counted.values()) == {False}
    assert "event_complete" not in python_client.orbits(**SPRING)


def test_a_cell_that_settled_is_proven_and_one_at_rest_says_why_not(python_client: Client):
    cell = {"gamma": 1.5, "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"}, "prove": True}
    answer = python_client.trajectory(cell)
    assert answer.proof == "proven"
    assert float(answer.proven_flight_times[0, 0]) <= 4.855013427295 + 1e-9
    at_rest = python_client.trajectory(cell | {"settle": 0})
    assert at_rest.proof == "not proven"
    assert "settle" in str(at_rest.proof_says.values)
    assert python_client.trajectory(cell | {"model": {"kind": "ball"}}).proof == "not covered"


def test_the_cycle_that_is_proven_is_that_of_the_motion(python_client: Client):
    """A stable cycle of one plate period lies beside the cell's, of three."""
    cell = {"gamma": 2.0858125898, "omega": 0.46287759736, "xi": 0.05046395205, "settle": 2000}
    motion = python_client.trajectory(cell | {"periods": 4, "prove": True})
    proven = motion.proven_flight_times.values.astype(float)
    for flight_time in motion.flight_time.values:
        assert np.any((proven[:, 0] - 1e-9 < flight_time) & (flight_time < proven[:, 1] + 1e-9))


def test_without_the_extra_one_sentence_says_what_to_install(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(proofs, "find_spec", lambda name: None)
    cell = {"gamma": 1.5, "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"}, "prove": True}
    answer = client.post("/v1/trajectories", json=cell)
    assert answer.status_code == 501
    assert 'pip install -e ".[proofs]"' in answer.json()["detail"]
