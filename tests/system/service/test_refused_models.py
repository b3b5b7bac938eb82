"""Specifications that a contact model cannot compute: refused with the reason and a value that works."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import httpx2
import pytest
from click.testing import CliRunner

from service.cli.main import main
from service.client import Client, InvalidSpecification
from service.server.embedded import running
from service.settings import Settings
from worker.executors.inline import Inline

SWEEP: dict[str, Any] = {"gamma": 1.5, "omega": 0.5, "xi": 0.26, "settle": 0, "observe": 1}


class Case(NamedTuple):
    """A specification, the rule that refuses it, the nearest one that works, and one just beyond that."""

    refused: dict[str, Any]
    rule: str
    works: dict[str, Any]
    beyond: dict[str, Any]


CASES = {
    "restitution 0 with stepped": Case(
        {"model": {"kind": "stepped", "restitution": 0}},
        "model.restitution: must be at least 1e-06 for 'stepped', not 0.0: at 0 a contact has no end",
        {"model": {"kind": "stepped", "restitution": 1e-6}},
        {"model": {"kind": "stepped", "restitution": 9.9e-7}},
    ),
    "restitution 0 without pull": Case(
        {"model": {"kind": "soft", "restitution": 0, "adhesive": False}},
        "model.restitution: must be at least 1e-06 where adhesive is false, not 0.0: without pull",
        {"model": {"kind": "soft", "restitution": 1e-6, "adhesive": False}},
        {"model": {"kind": "soft", "restitution": 9.9e-7, "adhesive": False}},
    ),
    "no tolerance": Case(
        {"model": {"kind": "auto", "tolerance": 0}},
        "model.tolerance: must be at least 1e-09, not 0.0: the exact solution's own rounding",
        {"model": {"kind": "auto", "tolerance": 1e-9}},
        {"model": {"kind": "auto", "tolerance": 9.9e-10}},
    ),
    "steps too long to be stable": Case(
        {"model": {"kind": "stepped", "scheme": "euler", "steps_per_contact": 2}, "xi": 100.0},
        "model.steps_per_contact: must be at least 8, not 2: longer steps are unstable with 'euler' at",
        {"model": {"kind": "stepped", "scheme": "euler", "steps_per_contact": 8}, "xi": 100.0},
        {"model": {"kind": "stepped", "scheme": "euler", "steps_per_contact": 7}, "xi": 100.0},
    ),
    "more steps than a period may take": Case(
        {"model": {"kind": "stepped", "penetration": 1e-4, "steps_per_contact": 5000}},
        "model.steps_per_contact: asks for 5.64e+07 steps in a plate period, at most 1e+07 are allowed; 887 ",
        {"model": {"kind": "stepped", "penetration": 1e-4, "steps_per_contact": 887}},
        {"model": {"kind": "stepped", "penetration": 1e-4, "steps_per_contact": 888}},
    ),
    "more steps than a cell may take": Case(
        {"model": {"kind": "stepped", "penetration": 1e-4}, "settle": 100_000},
        "at most 1e+05 are allowed over 100001 periods; 8 would do",
        {"model": {"kind": "stepped", "penetration": 1e-4, "steps_per_contact": 8}, "settle": 100_000},
        {"model": {"kind": "stepped", "penetration": 1e-4, "steps_per_contact": 9}, "settle": 100_000},
    ),
}

EVERY = pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    executor = Inline()
    with running(Settings(data=tmp_path_factory.mktemp("data"), port=0), executor) as address:
        yield address
    executor.close()


@EVERY
def test_over_rest(address: str, case: Case):
    response = httpx2.post(f"{address}/v1/jobs", json=SWEEP | case.refused)
    assert (response.status_code, response.headers["Content-Type"]) == (422, "application/problem+json")
    (error,) = response.json()["errors"]
    assert case.rule in f"{error['field']}: {error['rule']}"
    validation = f"{address}/v1/jobs?validate_only=true"
    assert httpx2.post(validation, json=SWEEP | case.works).status_code == 200
    assert httpx2.post(validation, json=SWEEP | case.beyond).status_code == 422


@EVERY
def test_by_the_client(address: str, case: Case):
    with Client(address) as client:
        with pytest.raises(InvalidSpecification) as caught:
            client.submit(SWEEP | case.refused)
        assert case.rule in str(caught.value)
        assert client.estimate(SWEEP | case.works).cells == 1


@EVERY
def test_in_the_shell(address: str, case: Case, tmp_path: Path):
    file = tmp_path / "sweep.json"
    file.write_text(json.dumps(SWEEP | case.refused))
    done = CliRunner().invoke(main, ["submit", str(file), "--url", address])
    assert done.exit_code == 1
    assert case.rule in done.stderr
    assert "Traceback" not in done.output


@EVERY
def test_for_one_cell(address: str, case: Case):
    """A trajectory is refused for the same reasons; it has no model of its own to choose."""
    cell = {name: value for name, value in (SWEEP | case.refused).items() if name != "observe"}
    response = httpx2.post(f"{address}/v1/trajectories", json=cell)
    assert response.status_code in (413, 422)
    assert "model." in response.json()["detail"] or "periods" in response.json()["detail"]
