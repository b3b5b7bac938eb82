"""Where the service of a data folder answers: found while it runs, and only by its own user."""

import stat
from pathlib import Path

import pytest
from tables import for_each

from service import tokens

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


def test_it_is_forgotten_when_the_service_is_ended(tmp_path: Path):
    def serve() -> None:
        with tokens.recorder(tmp_path) as record:
            record(URL)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        serve()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("listening", "answers"),
    [("http://0.0.0.0:80", "http://127.0.0.1:80"), ("http://[::]:80", "http://[::1]:80")],
)
def test_a_service_on_every_interface_answers_on_loopback(tmp_path: Path, listening: str, answers: str):
    with tokens.recorder(tmp_path) as record:
        record(listening)
        assert tokens.find_service(tmp_path) == answers


def test_the_next_service_keeps_its_own(tmp_path: Path):
    with tokens.recorder(tmp_path) as record:
        with tokens.recorder(tmp_path) as earlier:
            earlier(URL)
            record("http://127.0.0.1:8124")
        assert tokens.find_service(tmp_path) == "http://127.0.0.1:8124"


def test_a_file_that_others_can_write_does_not_count(tmp_path: Path):
    with tokens.recorder(tmp_path) as record:
        record(URL)
        (tmp_path / "service.json").chmod(0o644)
        assert tokens.find_service(tmp_path) is None


@for_each("content", ["", "[]", "{}", '{"url": 1}', "é"])
def test_another_content_does_not_count(tmp_path: Path, content: str):
    with tokens.recorder(tmp_path) as record:
        record(URL)
        (tmp_path / "service.json").write_text(content, encoding="utf-8")
        assert tokens.find_service(tmp_path) is None
