"""Settings: every one is described, and values that cannot be used are refused with the rule."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from tables import for_each

from service.errors import NotStarted
from service.settings import Settings

AWS = "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"


@for_each("name", sorted(Settings.model_fields))
def test_every_setting_is_described_in_one_sentence(name: str):
    description = Settings.model_fields[name].description or ""
    assert description.endswith(".")
    assert description[0].isupper() or description[0] == "`"


@for_each(("given", "rule"), [
    ({"scheduler": "tcp://127.0.0.1:1", "cluster": "module:make"}, "only one of scheduler, scheduler_"),
    ({"scheduler_ca": Path(__file__)}, "TLS to the scheduler needs scheduler_ca, scheduler_cert and"),
    ({"scheduler_key": "none.pem"}, "scheduler_key\\n.*not point to a file"),
    ({"host": "0.0.0.0"}, "needs a token: set BOUNCE_TOKEN or BOUNCE_TOKEN_FILE"),
    ({"workers": 100_000}, "workers"),
    ({"token": "short"}, "must be at least 16 ASCII characters without spaces, or auto"),
    ({"token": "sixteen characters with s3cret"}, "must be at least 16 ASCII characters without spaces"),
    ({"stores": "ftp://somewhere"}, "stores"),
    ({"data": "s3://bucket/prefix"}, "must be a folder; only `stores` can be in a bucket"),
    ({"port": 65536}, "port"),
    ({"worker_memory": 1000}, "worker_memory"),
    ({"allowed_hosts": "a.org, http://b.org"}, "http://b.org: a host is a name or an address"),
    ({"token": "s3cret"}, "token"),
    ({"host": "0.0.0.0", "token": ["s3cret"]}, "token"),
    ({"scheduler": "tls://name:s3cret@host:8786"}, "must not contain credentials: scheduler_cert"),
    ({"stores": "s3://name:s3cret@bucket/prefix"}, AWS),
    ({"stores": "https://name:s3cret@host/prefix"}, AWS),
    ({"stores": "s3:name:s3cret@bucket"}, AWS),
])  # fmt: skip
def test_a_setting_that_cannot_be_used_is_refused_and_no_secret_shown(given: dict[str, Any], rule: str):
    with pytest.raises(ValidationError, match=rule) as refused:
        Settings(**given)
    assert "s3cret" not in str(refused.value)


@pytest.mark.parametrize(("stores", "url", "folders"), [
    (None, "/d/stores", ["/d", "/d/stores"]),
    ("/else/me@home", "/else/me@home", ["/d", "/else/me@home"]),
    ("s3://bucket/prefix/", "s3://bucket/prefix", ["/d"]),
])  # fmt: skip
def test_the_stores_are_in_the_data_folder_another_one_or_a_bucket(
    stores: str | None, url: str, folders: list[str]
):
    settings = Settings(data=Path("/d"), stores=stores)
    assert settings.stores_url == url
    assert settings.store_of("a" * 32 + ".zarr") == f"{url}/{'a' * 32}.zarr"
    assert settings.folders == tuple(map(Path, folders))


def test_the_addresses_of_stores_do_not_depend_on_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    for settings in (Settings(data=Path("data")), Settings(data=Path("data"), stores="data/stores")):
        assert settings.stores_url == str(tmp_path / "data" / "stores")
    assert settings.exports_path == tmp_path / "data" / "exports"


def test_a_token_that_is_still_to_be_made_lets_nobody_in():
    assert Settings(token="auto").makes_token
    with pytest.raises(NotStarted, match="auto is not replaced"):
        Settings(token="auto").access_tokens()
    assert not Settings(token="a-token-of-the-service").makes_token
    assert Settings(token="a-token-of-the-service").access_tokens() == {"a-token-of-the-service": None}
    assert Settings(token="").access_tokens() == {}
