"""The folder of compiled kernels: whose it is, and what identifies it."""

import os
import shutil
import time
from pathlib import Path

import pytest
from paths import ROOT

from worker import kernel_cache


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A cache that this user's processes have made, and one of its kernels."""
    folder = kernel_cache._cache_folder(tmp_path / "deep" / "cache")
    (folder / "run").write_bytes(b"code")
    return tmp_path / "deep" / "cache"


def refusal(root: Path) -> str:
    with pytest.raises(
        kernel_cache.CacheRefused, match="so others could run code here; remove it"
    ) as refused:
        kernel_cache._cache_folder(root)
    return str(refused.value)


def test_a_copy_of_the_sources_has_the_same_digest_and_a_change_another(tmp_path, monkeypatch):
    before = kernel_cache.digest_of("kernel")
    shutil.copytree(ROOT / "kernel", tmp_path / "kernel")
    monkeypatch.setattr(kernel_cache, "_PACKAGES", tmp_path)
    assert kernel_cache.digest_of("kernel") == before
    with (tmp_path / "kernel" / "numerics" / "quartic.py").open("a") as source:
        source.write("# another digit\n")
    assert kernel_cache.digest_of("kernel") != before


@pytest.mark.parametrize(("variables", "expected"), [
    ({"NUMBA_CACHE_DIR": "/somewhere"}, Path("/somewhere")),
    ({"XDG_CACHE_HOME": "/cache"}, Path("/cache/bouncing-spring")),
    ({"HOME": "/ana"}, Path("/ana/.cache/bouncing-spring")),
])  # fmt: skip
def test_the_root_comes_from_the_environment(variables, expected, monkeypatch):
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert kernel_cache.default_root() == expected


@pytest.mark.parametrize("inner", ["", "*", "*/run"])
def test_a_cache_that_others_can_write_to_is_refused(root, inner):
    for each in (root, *root.rglob("*")):
        each.chmod(0o755)
    kernel_cache._cache_folder(root)
    [opened] = root.glob(inner) if inner else [root]
    opened.chmod(0o775)
    assert f"{opened} can be written by other users (mode 0775)" in refusal(root)


def test_caches_of_other_sources_are_removed_after_two_weeks(root):
    long_ago = time.time() - 15 * 24 * 3600
    for name in ("old", "recent"):
        (root / name).mkdir(mode=0o700)
        (root / name / "used").touch()
    os.utime(root / "old" / "used", (long_ago, long_ago))
    (root / "somebody's").mkdir(mode=0o700)
    kept = kernel_cache._cache_folder(root)
    assert sorted(path.name for path in root.iterdir()) == sorted([kept.name, "recent", "somebody's"])
