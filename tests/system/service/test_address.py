"""The address of a service that was killed."""

import multiprocessing
import os
from pathlib import Path

from service import tokens

URL = "http://127.0.0.1:8123"


def _die_while_recorded(folder: Path) -> None:
    with tokens.recorder(folder) as record:
        record(URL)
        os._exit(0)


def test_what_a_killed_service_left_says_nothing(tmp_path: Path):
    process = multiprocessing.get_context("spawn").Process(target=_die_while_recorded, args=(tmp_path,))
    process.start()
    process.join()
    assert (tmp_path / "service.json").exists()
    assert tokens.find_service(tmp_path) is None
    with tokens.recorder(tmp_path) as record:
        record(URL)
        assert tokens.find_service(tmp_path) == URL
