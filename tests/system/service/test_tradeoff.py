"""`bounce tradeoff`: the costs and errors of contact models, as a table and as a picture."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from paths import GOLDEN

from service.cli.main import main
from service.figures import tradeoff
from service.figures.tradeoff import SETTINGS, Setting
from worker.spec.contact_models import Rigid, Soft


def test_the_command_shows_progress_prints_the_table_and_writes_the_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    picture = tmp_path / "tradeoff.png"
    monkeypatch.setattr(tradeoff, "SETTINGS", [Setting("plate", Rigid()), Setting("plate", Soft())])
    done = CliRunner().invoke(main, ["tradeoff", "-o", str(picture)])
    assert done.exit_code == 0, done.output
    first, *_, last = done.stderr.splitlines()
    assert (first, last.split()[0]) == ("measured 0 of 2 contacts", "took")
    assert [line.split()[2] for line in done.stdout.splitlines()[:3]] == ["contact", "rigid", "soft,"]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_what_the_published_picture_shows_is_what_is_measured():
    columns = json.loads((GOLDEN / "tradeoff_rows.json").read_text())["variables"]
    assert columns["contact"] == [setting.name for setting in SETTINGS]
