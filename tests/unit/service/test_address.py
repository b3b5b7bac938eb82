"""Where the service of a data folder answers: found while it runs, and only by its own user."""

import stat
from pathlib import Path

import pytest

from service import tokens
from service.client import Client

URL = "http://127.0.0.1:8123"


def test_it_is_found_while_the_service_runs(tmp_path: Path):
    assert tokens.find_service(tmp_path) is None
    with tokens.recorder(tmp_path) as record:
        assert tokens.find_service(tmp_path) is None
        record(URL)
        assert tokens.find_service(tmp_path) == URL
        assert stat.S_IMODE((tmp_path / "service.json").stat().st_mode) == 0o600
    assert tokens.find_service(tmp_path) is None
    assert list(tmp_path.iterdir()) == []


def test_a_client_finds_it_unless_another_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("BOUNCE_URL", raising=False)
    monkeypatch.setenv("BOUNCE_DATA", str(tmp_path))
    assert Client().url == tokens.DEFAULT_URL
    with tokens.recorder(tmp_path) as record:
        record(URL)
        assert Client().url == URL
        monkeypatch.setenv("BOUNCE_URL", "http://localhost:9")
        assert Client().url == "http://localhost:9"


def test_a_file_that_others_can_write_does_not_count(tmp_path: Path):
    with tokens.recorder(tmp_path) as record:
        record(URL)
        (tmp_path / "service.json").chmod(0o644)
        assert tokens.find_service(tmp_path) is None
