"""`bounce tradeoff`: the table of costs and errors, and the picture."""

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from paths import GOLDEN

from service import tradeoff
from service.cli.main import main
from service.tradeoff import CELLS_PER_LINE, LINES, PURPOSES, SETUPS, Measurement, Setup


def known(kind: type[Any], row: dict[str, Any]) -> Any:
    return kind(**{field.name: row[field.name] for field in fields(kind)})


#: As once measured: tests/system/service/test_tradeoff.py measures.
TABLE = json.loads((GOLDEN / "tradeoff_rows.json").read_text())["rows"]
ROWS = {known(Setup, row): known(Measurement, row) for row in TABLE}


@pytest.fixture
def bounce(monkeypatch: pytest.MonkeyPatch):
    """The command, without the minute that it measures."""
    monkeypatch.setattr(tradeoff, "measure", ROWS.__getitem__)

    def run(*arguments: str) -> Result:
        return CliRunner().invoke(main, ["tradeoff", *arguments])

    return run


def test_what_is_measured_is_the_published_table():
    assert list(ROWS) == list(SETUPS)


def test_the_table_and_the_picture(bounce, tmp_path: Path):
    done = bounce("-o", str(tmp_path / "tradeoff.png"))
    assert done.exit_code == 0, done.output
    assert done.stderr.startswith("measuring")  # it takes minutes
    lines = done.stdout.splitlines()
    assert lines[0] == f"Errors relative to the {PURPOSES['adhesive'].text}"
    assert lines[2].split()[:3] == ["soft,", "d", "="]
    assert lines[2].split()[-3:] == ["exact", "exact", "100%"]
    assert len(lines) == len(ROWS) + 3 * 3 + 3  # headings and gaps, the legend
    assert (tmp_path / "tradeoff.png").read_bytes().startswith(b"\x89PNG")


def test_a_picture_of_another_kind_is_refused_before_anything_is_measured(bounce):
    done = bounce("-o", "tradeoff.gif")
    assert done.exit_code == 2
    assert "does not end in .png, .svg" in done.stderr
    assert "measuring" not in done.stderr


def test_steps_that_a_specification_would_refuse_are_not_computed():
    """Euler with 20 steps in a contact of d = 0.1: too long for the dashpot that locks, and for it alone."""
    deep = Setup(purpose="adhesive", model="stepped", restitution=0.01, penetration=0.1, scheme="euler")
    some = tradeoff.measure(replace(deep, steps_per_contact=20))
    assert 0.0 < some.agree <= 1.0 - CELLS_PER_LINE / (len(LINES) * CELLS_PER_LINE)
    none = tradeoff.measure(replace(deep, steps_per_contact=1))
    assert (none.cost, none.error, none.agree) == (None, None, 0.0)
