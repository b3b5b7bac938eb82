"""Access tokens: files of named ones, and the one that a service makes and its user's clients find."""

import os
import stat
import webbrowser
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from tables import for_each

from service import tokens
from service.cli.main import main
from service.client import Client
from service.errors import NotStarted
from service.settings import Settings

ANA, BEN = "ana-has-a-token-of-her-own", "ben-has-a-token-of-his-own"


def written(folder: Path, text: str, mode: int = 0o600) -> Path:
    file = folder / "tokens"
    file.write_text(text)
    file.chmod(mode)
    return file


# Files of named tokens


def test_a_file_names_one_token_on_each_line(tmp_path: Path):
    file = written(tmp_path, f"# lab\nana: {ANA}\n\n  ben@lab.example :{BEN}:x  \n")
    assert tokens.read_tokens(file, private=True) == {"ana": ANA, "ben@lab.example": f"{BEN}:x"}


@for_each(("text", "rule"), [
    ("", "holds no token: add a line NAME: TOKEN"),
    (f"{ANA}\n", "line 1: must be NAME: TOKEN"),
    (f"a b: {ANA}\n", "line 1: the name must be"),
    (f"ben: {BEN}\nana: s3cret\n", "line 2: the token of ana must be at least 16 ASCII characters"),
    (f"ana: {ANA}\nana: {BEN}\n", "line 2: the name ana is given twice"),
    (f"ana: {ANA}\nben: {ANA}\n", "line 2: the token of ben is that of another name too"),
])  # fmt: skip
def test_a_line_that_breaks_a_rule_is_named_and_its_token_not_shown(tmp_path: Path, text: str, rule: str):
    file = written(tmp_path, text)
    with pytest.raises(NotStarted) as refused:
        Settings(token_file=file).access_tokens()
    assert str(refused.value).startswith(f"token_file: {file}")
    assert rule in str(refused.value)
    assert not [secret for secret in (ANA, BEN, "s3cret") if secret in str(refused.value)]


def test_a_pipe_in_place_of_the_file_is_not_waited_for(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(NotStarted, match="holds no token"):
        Settings(token_file=tmp_path / "pipe").access_tokens()


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620])
def test_a_file_that_is_open_to_others_is_refused(tmp_path: Path, mode: int):
    file = written(tmp_path, f"ana: {ANA}", mode)
    with pytest.raises(
        NotStarted, match=f"open to other users \\(mode 0{mode:o}\\): close it with `chmod 600"
    ):
        Settings(token_file=file).access_tokens()
    assert Settings(token_file=file, private=False).access_tokens() == {ANA: "ana"}


# The service of a data folder, and the token that it makes


def test_its_address_is_found_while_it_runs_and_others_cannot_write_it(tmp_path: Path):
    url, file = "http://127.0.0.1:8123", tmp_path / "service.json"
    assert tokens.find_service(tmp_path) is None
    with tokens.recorder(tmp_path) as record:
        assert tokens.find_service(tmp_path) is None
        record(url)
        assert tokens.find_service(tmp_path) == url
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        file.chmod(0o644)
        assert tokens.find_service(tmp_path) is None
    assert list(tmp_path.iterdir()) == []


def test_a_client_finds_it_unless_another_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("BOUNCE_URL", raising=False)
    monkeypatch.setenv("BOUNCE_DATA", str(tmp_path))
    assert Client().url == tokens.DEFAULT_URL
    with tokens.recorder(tmp_path) as record:
        record("http://127.0.0.1:8123")
        assert Client().url == "http://127.0.0.1:8123"
        monkeypatch.setenv("BOUNCE_URL", "http://localhost:9")
        assert Client().url == "http://localhost:9"


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The token of a service on port 8000, whose data folder is that of the clients."""
    monkeypatch.setenv("BOUNCE_DATA", str(tmp_path))
    with tokens.recorder(tmp_path) as record:
        record("http://127.0.0.1:8000")
        yield tokens.own_token(tmp_path)


def test_a_made_token_is_kept_for_this_user_alone(tmp_path: Path):
    token = tokens.own_token(tmp_path)
    assert tokens.is_valid(token)
    assert len(token) == 43  # of 32 random bytes
    assert stat.S_IMODE((tmp_path / tokens.FILE_NAME).stat().st_mode) == 0o600
    assert tokens.own_token(tmp_path) == token
    assert [path.name for path in tmp_path.iterdir()] == [tokens.FILE_NAME]
    (tmp_path / tokens.FILE_NAME).unlink()
    assert tokens.own_token(tmp_path) != token


def test_a_token_is_found_for_its_own_port_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("BOUNCE_DATA", str(tmp_path))
    with tokens.recorder(tmp_path) as record:
        assert tokens.find_token(8000) is None
        token = tokens.own_token(tmp_path)
        assert tokens.find_token(8000) is None
        record("http://0.0.0.0:8000")
        assert tokens.find_token(8000) == token
        assert tokens.find_token(8001) is None  # another's service
        with Client("http://127.0.0.1:8000") as client, Client("http://127.0.0.1:8001") as other:
            assert (client._transport.token, other._transport.token) == (token, None)
    assert tokens.find_token(8000) is None  # stopped: somebody else may listen there now


@pytest.mark.parametrize("planted", ["open", "link", "pipe", "folder"])
def test_a_file_that_others_may_have_made_does_not_count(tmp_path: Path, made: str, planted: str):
    file, elsewhere = tmp_path / tokens.FILE_NAME, tmp_path / "elsewhere"
    if planted == "open":
        file.chmod(0o644)
    else:
        file.rename(elsewhere)
        {
            "link": lambda: file.symlink_to(elsewhere),
            "pipe": lambda: os.mkfifo(file, 0o600),
            "folder": file.mkdir,
        }[planted]()
    assert tokens.find_token(8000) is None
    if planted != "folder":
        assert tokens.own_token(tmp_path) != made
        assert tokens.find_token(8000) is not None


def opened(*options: str) -> str:
    """What `bounce open` prints."""
    done = CliRunner().invoke(main, ["open", *options])
    assert done.exit_code == 0, done.output
    return done.stdout.strip()


def test_the_pages_address_has_the_token_in_its_fragment(made: str):
    assert opened("--print") == f"http://127.0.0.1:8000/#token={made}"
    assert opened("--print", "--url", "http://localhost:8000") == f"http://localhost:8000/#token={made}"
    for other in ("http://127.0.0.1:8001", "http://192.0.2.7:8000", "https://example.org"):
        assert opened("--print", "--url", other) == f"{other}/"
    coded = "http://127.0.0.1:8000/#token=one%2Fof%23mine%26%3Dmore"
    assert opened("--print", "--token", "one/of#mine&=more") == coded


def test_the_page_is_opened_without_its_token_on_a_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: str
):
    urls, opens = list[str](), True
    monkeypatch.setattr(webbrowser, "open", lambda url: urls.append(url) or opens)
    assert opened() == ""
    assert urls == [(tmp_path / "open.html").as_uri()]
    assert f"url=http://127.0.0.1:8000/#token={made}" in (tmp_path / "open.html").read_text()
    assert stat.S_IMODE((tmp_path / "open.html").stat().st_mode) == 0o600
    assert opened("--url", "http://127.0.0.1:8001") == ""
    assert urls[1:] == ["http://127.0.0.1:8001/"]
    opens = False
    assert opened("--url", "http://127.0.0.1:8001") == "http://127.0.0.1:8001/"
    monkeypatch.setenv("BOUNCE_DATA", str(tmp_path / "missing"))
    refused = CliRunner().invoke(main, ["open", "--token", made])
    assert (refused.exit_code, "use --print, or set BOUNCE_DATA" in refused.stderr) == (1, True)
