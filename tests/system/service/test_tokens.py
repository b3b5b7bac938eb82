"""Tokens of a service that runs, and its address."""

import json
import multiprocessing
import os
from contextlib import suppress
from pathlib import Path

import httpx2
import psutil
import pytest
from click.testing import CliRunner
from scripted import DEADLINE, Held, wait_for
from served import service_at, serving

from service import tokens
from service.cli.main import main
from service.client import Client, Unauthorized
from service.server import embedded
from service.settings import read_settings

ANA = "ana-has-a-token-of-her-own"
URL = "http://127.0.0.1:8123"


def status_with(url: str, token: str) -> int:
    headers = {"Authorization": f"Bearer {token}"}
    return httpx2.get(f"{url}/v1/jobs", headers=headers, timeout=DEADLINE).status_code


def test_a_client_of_the_same_user_finds_the_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    data = tmp_path / "bounce-data"
    with service_at(data, Held(), token="auto") as url:
        with Client(url) as stranger, pytest.raises(Unauthorized):
            next(iter(stranger.jobs()), None)
        monkeypatch.chdir(tmp_path)  # where ./bounce-data is
        with Client(url) as client:
            assert list(client.jobs()) == []
        for given in ([], ["--token", "auto"]):
            done = CliRunner().invoke(main, ["list", "--url", url, *given])
            assert (done.exit_code, done.output.split()[0]) == (0, "ID")
        token = json.loads((tmp_path / "bounce-data" / tokens.FILE_NAME).read_text())["token"]
        assert [status_with(url, each) for each in ("auto", token)] == [401, 200]
    port = int(url.rpartition(":")[2])
    assert tokens.find_token(port) is None
    with service_at(data, Held(), token="auto") as url, Client(url) as client:
        assert list(client.jobs()) == []
    assert json.loads((tmp_path / "bounce-data" / tokens.FILE_NAME).read_text())["token"] == token


def test_the_token_of_the_environment_is_there_again_after_the_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("BOUNCE_TOKEN", ANA)
    with embedded.running(read_settings(data=tmp_path, port=0), Held()) as url:
        assert "BOUNCE_TOKEN" not in os.environ
        assert status_with(url, ANA) == 200
    assert os.environ["BOUNCE_TOKEN"] == ANA


def die_while_recorded(folder: Path) -> None:
    with tokens.recorder(folder) as record:
        record(URL)
        os._exit(0)


def test_the_address_that_a_killed_service_left_says_nothing(tmp_path: Path):
    process = multiprocessing.get_context("spawn").Process(target=die_while_recorded, args=(tmp_path,))
    process.start()
    process.join()
    assert (tmp_path / "service.json").exists()
    assert tokens.find_service(tmp_path) is None
    with tokens.recorder(tmp_path) as record:
        record(URL)
        assert tokens.find_service(tmp_path) == URL


def test_the_processes_of_a_service_do_not_inherit_its_token(tmp_path: Path):
    """A worker runs whatever a study needs; of the service's secrets it needs none."""
    with serving(tmp_path, variables={"BOUNCE_TOKEN": ANA, "BOUNCE_WORKERS": "1"}) as service:

        def have_their_own() -> bool:
            """Not while one is being started, which shows the environment of the service until it is."""
            environments = []
            for child in service.family():
                with suppress(psutil.NoSuchProcess):
                    environments.append(child.environ())
            know_the_cache = all("NUMBA_CACHE_DIR" in environment for environment in environments)
            return bool(environments) and know_the_cache and ANA not in str(environments)

        wait_for(have_their_own)
        assert service.ask("GET", "/v1/jobs").status_code == 401
