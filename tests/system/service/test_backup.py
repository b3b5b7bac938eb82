"""`bounce doctor` beside a service."""

from pathlib import Path

import httpx2
import pytest
from click.testing import CliRunner, Result
from scripted import DEADLINE, Held, wait_for
from served import service_at

from service import tokens
from service.cli.main import main


def bounce(*arguments: str) -> Result:
    return CliRunner().invoke(main, arguments)


@pytest.mark.parametrize(
    ("workers", "stores", "mark", "said"),
    [
        (1, [], "ok", "is ready"),
        (0, [], "!!", "is not ready: the Dask scheduler does not answer; jobs wait until it does"),
        (1, ["f" * 32], "!!", "is ready: stores that the ledger does not know: 1"),
    ],
)
def test_the_doctor_asks_the_service_on_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int, stores: list[str], mark: str, said: str
):
    """Without the proxy that other requests may need."""
    for store in stores:
        (tmp_path / "stores" / f"{store}.zarr").mkdir(parents=True)
    with service_at(tmp_path, Held(capacity=workers)) as url, tokens.recorder(tmp_path) as record:
        record(url)
        if stores:
            wait_for(lambda: bool(httpx2.get(f"{url}/readyz", timeout=DEADLINE).json().get("notices")))
        with monkeypatch.context() as patch:
            for name in ("NO_PROXY", "no_proxy", "BOUNCE_URL"):
                patch.delenv(name, raising=False)
            patch.setenv("http_proxy", "http://127.0.0.1:9")
            answer = bounce("doctor", "--data", str(tmp_path))
    (line,) = [line for line in answer.output.splitlines() if line[4:].startswith("service")]
    assert line.startswith(f"{mark}  service           {url} {said}")
    assert answer.exit_code == (mark == "!!")
