"""What models cost and how far off they are: measured, told in words, columns and a picture."""

import json
import math
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from fastapi.testclient import TestClient

from service.api.app import create_app
from service.cli.main import main
from service.cli.tradeoff import table_lines
from service.client import Client
from service.render.work_precision import draw
from service.results.work_precision import REFERENCES, advice
from service.server.embedded import running
from service.settings import Settings
from worker.analysis import work_precision
from worker.analysis.work_precision import CELLS_A_LINE, LINES, RUNGS, Measured, Rung, measure
from worker.executors.dask import Dask
from worker.executors.inline import Inline
from worker.spec.contact_models import CONTACT_MODELS

#: The cheap ones, and those that the advice speaks of.
FEW = tuple(rung for rung in RUNGS if rung.model != "stepped" or
            (rung.purpose, rung.scheme, rung.steps_per_contact) == ("contact", "verlet", 20))  # fmt: skip
#: And only the latter.
TOLD = tuple(rung for rung in FEW if rung.purpose == "contact" or rung.model == "rigid")


@pytest.fixture(scope="module")
def measured() -> list[Measured]:
    return [measure(rung) for rung in FEW]


def found(rows: list[Measured], purpose: str, model: str, **wanted: Any) -> Measured:
    wanted = {"purpose": purpose, "model": model, **wanted}
    (row,) = (row for row in rows if all(getattr(row, name) == value for name, value in wanted.items()))
    return row


# What is measured


def test_every_cell_is_compared_and_has_an_answer(measured: list[Measured]):
    for row in measured:
        assert (row.unresolved, row.refused) == (0.0, 0.0)
        assert row.cells > (5 if row.locked_only else len(LINES) * CELLS_A_LINE / 2)


def test_the_reference_is_no_way_off_itself(measured: list[Measured]):
    exact = found(measured, "contact", "soft")
    assert (exact.error, exact.error_95, exact.agree) == (0.0, 0.0, 1.0)


def test_a_soft_contact_becomes_a_hard_plate_in_proportion_to_its_depth(measured: list[Measured]):
    for d in (1e-2, 1e-3, 1e-4, 1e-5):
        assert found(measured, "plate", "soft", penetration=d).error == pytest.approx(2 * d, rel=0.1)


def test_a_rigid_plate_is_the_hard_one_to_the_reference_s_own_depth(measured: list[Measured]):
    rigid = found(measured, "plate", "rigid")
    assert rigid.error == pytest.approx(2e-7, rel=0.1)
    assert rigid.agree == 1.0


def test_a_ball_is_a_spring_only_where_the_dashpot_locks(measured: list[Measured]):
    for purpose in ("contact", "plate"):
        assert found(measured, purpose, "ball", locked_only=False).error > 1.0
        assert found(measured, purpose, "ball", locked_only=True).error < 0.03


def test_each_rung_costs_less_than_the_next(measured: list[Measured]):
    ladder = [found(measured, "contact", model, **which).cost for model, which in (
        ("ball", {"locked_only": False}), ("rigid", {}), ("soft", {}), ("stepped", {}))]  # fmt: skip
    assert ladder == sorted(ladder)
    assert ladder[-1] > 10 * ladder[-2]


def test_the_plan_reckons_with_what_is_measured(measured: list[Measured]):
    """But for how fast this machine is."""
    which = {"ball": {"locked_only": False}, "rigid": {}, "soft": {"penetration": 1e-3}}
    told = {
        model: found(measured, "plate", model, **given).cost / CONTACT_MODELS[model].cost_us
        for model, given in which.items()
    }
    assert max(told.values()) < 12 * min(told.values()), told


def test_steps_come_nearer_at_the_scheme_s_order():
    """Second order: 2.5 times the steps, some 6 times nearer."""
    twenty, fifty = (
        measure(Rung(purpose="contact", model="stepped", restitution=0.01, penetration=1e-3,
                     steps_per_contact=steps, scheme="verlet", locked_only=True))
        for steps in (20, 50)
    )  # fmt: skip
    assert 3.0 < twenty.error / fifty.error < 15.0


def test_steps_that_a_specification_would_refuse_are_counted_not_computed():
    """Euler with 20 steps in a contact of d = 0.1: too long for the dashpot that locks, and for it alone."""
    deep = Rung(purpose="contact", model="stepped", restitution=0.01, penetration=0.1, scheme="euler")
    some = measure(deep.model_copy(update={"steps_per_contact": 20}))
    assert some.refused == CELLS_A_LINE / (len(LINES) * CELLS_A_LINE)
    none = measure(deep.model_copy(update={"steps_per_contact": 1}))
    assert (none.refused, none.cells, none.cost, none.error) == (1.0, 0, None, None)


# What is told


def test_the_table_and_its_last_words(measured: list[Measured]):
    rows = [row.model_dump() for row in measured]
    lines = table_lines(rows, REFERENCES)
    assert len(lines) == len(FEW) + 6
    assert (
        lines[0]
        == "Errors relative to the exact soft contact, d = 1e-3, e = 0.01: for studies of this contact"
    )
    assert lines[2].split()[:3] == ["soft,", "d", "="]
    assert lines[2].split()[-3:] == ["exact", "exact", "100%"]
    text = advice(measured)
    assert text.startswith("Take rigid for a hard plate (")
    assert text.endswith("and auto to choose the model on the cells of your own sweep.")
    assert "nan" not in text


@pytest.mark.parametrize("format", ["png", "svg"])
def test_the_picture(measured: list[Measured], format: str):
    picture = draw(measured, format)
    assert picture.startswith(b"\x89PNG" if format == "png" else b"<?xml")
    assert draw(measured, format) == picture


# Through the service


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, cluster: Dask) -> Iterator[str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(work_precision, "RUNGS", TOLD)  # all of them take a minute
        with running(Settings(data=tmp_path_factory.mktemp("data"), port=0), cluster) as address:
            yield address


def test_workers_measure_once_for_all_who_ask(address: str):
    with Client(address) as client:
        one, two = client.tradeoff(), client.tradeoff()
        assert one == two
        assert [row["model"] for row in one["rows"]] == [rung.model for rung in TOLD]
        assert one["cells"] == 80
        assert set(one["references"]) == {"contact", "plate"}
        assert client.tradeoff_picture("svg").startswith(b"<?xml")


def test_the_command_prints_the_table_and_writes_the_picture(address: str, tmp_path: Path):
    def bounce(*arguments: str) -> str:
        done = CliRunner().invoke(main, ["tradeoff", "--url", address, *arguments])
        assert done.exit_code == 0, done.output
        return done.stdout

    said = bounce("-o", str(tmp_path / "tradeoff.png")).splitlines()
    assert said[0].startswith("Errors relative to the exact soft contact")
    assert said[-1].startswith("Take rigid")
    assert (tmp_path / "tradeoff.png").read_bytes().startswith(b"\x89PNG")
    rows = json.loads(bounce("--json"))["rows"]
    assert all(math.isfinite(row["cost"]) for row in rows)


def test_a_picture_of_another_kind_is_refused_before_anything_is_measured():
    done = CliRunner().invoke(main, ["tradeoff", "-o", "tradeoff.pdf"])
    assert done.exit_code == 2
    assert "does not end in .png, .svg" in done.stderr


def test_another_format_is_refused(tmp_path: Path):
    executor = Inline()
    with TestClient(create_app(Settings(data=tmp_path), executor), base_url="http://localhost") as client:
        refused = client.get("/v1/tradeoff", params={"format": "pdf"})
    executor.close()
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == "format"


# An answer that takes a while


class Slow(Inline):
    """An executor whose calls a test completes."""

    def __init__(self) -> None:
        super().__init__()
        self.futures: list[Future[Any]] = []

    def call(self, function: Any, *arguments: Any) -> Any:
        self.futures.append(Future())
        return self.futures[-1]


def test_a_request_is_told_how_far_the_workers_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(work_precision, "RUNGS", TOLD[:2])
    executor = Slow()
    with TestClient(create_app(Settings(data=tmp_path), executor), base_url="http://localhost") as client:
        first = client.get("/v1/tradeoff")
        assert (first.status_code, first.headers["Retry-After"]) == (202, "1")
        assert first.headers["Content-Type"] == "application/json"
        progress = {"parts_done": 0, "parts_total": 2, "percent": 0.0}
        assert first.json() == {"state": "running", "progress": progress}
        executor.futures[0].set_result(None)
        assert client.get("/v1/tradeoff").json()["progress"] == {**progress, "parts_done": 1, "percent": 50.0}
        answers = client.get("/openapi.json").json()["paths"]["/v1/tradeoff"]["get"]["responses"]
        assert answers["202"]["content"]["application/json"]["schema"]["$ref"].endswith("/PendingView")
    executor.close()
    assert executor.futures[1].cancelled()
