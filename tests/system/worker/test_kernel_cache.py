"""Kernel caches: one running process in each, kept for the next process, copied to new ones."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from paths import CACHE, ROOT

from worker import kernel_cache

CLAIM = "from worker.kernel_cache import claim_cache; print(claim_cache({root!r}), flush=True); input()"


class Process:
    """A process that holds a cache until `kill`."""

    def __init__(self, root: Path | None, environment: dict[str, str]) -> None:
        self._popen = subprocess.Popen(
            [sys.executable, "-c", CLAIM.format(root=str(root) if root else None)],
            cwd=ROOT,
            env={name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
            | environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._popen.stdout
        self.slot = Path(self._popen.stdout.readline().strip())

    def kill(self) -> None:
        self._popen.kill()
        self._popen.communicate()


@pytest.fixture
def claim() -> Iterator:
    started = []

    def begin(root: Path | None = None, **environment: str) -> Process:
        started.append(Process(root, environment))
        return started[-1]

    yield begin
    for process in started:
        process.kill()


def test_living_processes_have_caches_of_their_own(claim, tmp_path):
    slots = [claim(tmp_path).slot for _ in range(3)]
    assert [slot.name for slot in slots] == ["slot-0", "slot-1", "slot-2"]
    assert len({slot.parent for slot in slots}) == 1


def test_cache_of_a_dead_process_is_taken_over(claim, tmp_path):
    first, second = claim(tmp_path), claim(tmp_path)
    first.kill()
    assert claim(tmp_path).slot == first.slot
    assert second.slot != first.slot


def test_new_cache_begins_with_what_the_first_process_left(claim, tmp_path):
    folder = claim(tmp_path).slot.parent
    (folder / "ready" / "kernel").mkdir(parents=True)
    (folder / "ready" / "kernel" / "code.nbc").write_bytes(b"code")
    assert (claim(tmp_path).slot / "kernel" / "code.nbc").read_bytes() == b"code"


def test_root_comes_from_the_environment_and_is_handed_down(claim, tmp_path):
    first = claim(NUMBA_CACHE_DIR=str(tmp_path))
    assert first.slot.parents[1] == tmp_path
    # The environment that a process started by the first one inherits.
    assert claim(NUMBA_CACHE_DIR=str(first.slot)).slot == first.slot.parent / "slot-1"


def test_root_is_in_the_users_cache_otherwise(claim, tmp_path):
    assert claim(XDG_CACHE_HOME=str(tmp_path)).slot.parents[1] == tmp_path / "bouncing-spring"


def test_where_no_cache_can_be_kept_there_is_one_for_the_process(claim, tmp_path):
    file = tmp_path / "no folder"
    file.write_text("")
    slot = claim(file, TMPDIR=str(tmp_path)).slot
    assert slot.is_dir()
    assert slot.parents[1] == tmp_path


def test_kernels_declared_before_the_claim_keep_no_cache(tmp_path):
    late = (
        "import kernel.line; from worker.kernel_cache import claim_cache; "
        f"print(claim_cache({str(tmp_path)!r}))"
    )  # fmt: skip
    done = subprocess.run([sys.executable, "-c", late], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "None\n"
    assert not list(tmp_path.iterdir())


LATE = """
import shutil
from worker.kernel_cache import claim_cache, warm
slot = claim_cache({root!r})
shutil.copytree({ready!r}, slot.parent / "ready")
warm()
print(slot)
"""


def test_a_cache_claimed_before_there_was_one_to_copy_is_filled_when_warmed(tmp_path):
    """As that of the service on the machine's first start: its workers compile, the service does not."""
    kernel_cache.warm(CACHE)
    ready = kernel_cache.claim_cache().parent / "ready"
    code = LATE.format(root=str(tmp_path), ready=str(ready))
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    slot = Path(done.stdout.strip())
    made = {path.relative_to(ready): path.stat().st_mtime_ns for path in ready.rglob("*.nbc")}
    assert made
    assert {path.relative_to(slot): path.stat().st_mtime_ns for path in slot.rglob("*.nbc")} == made


@pytest.fixture
def cache(claim, tmp_path: Path) -> Path:
    """A cache that this user's processes have made, and one of its kernels."""
    slot = claim(tmp_path / "cache").slot
    (slot / "kernel").mkdir()
    (slot / "kernel" / "code.nbc").write_bytes(b"code")
    return tmp_path / "cache"


def refusal(cache: Path) -> str:
    with pytest.raises(
        kernel_cache.CacheRefused, match="so others could run code here; remove it"
    ) as refused:
        kernel_cache._check(cache)
    return str(refused.value)


def test_a_cache_is_made_for_this_user_alone(claim, tmp_path):
    umask = os.umask(0)
    try:
        slot = claim(tmp_path / "deep" / "cache").slot
    finally:
        os.umask(umask)
    for folder in (slot, slot.parent, slot.parents[1]):
        assert folder.stat().st_mode & 0o777 == 0o700
    kernel_cache._check(tmp_path / "deep" / "cache")


@pytest.mark.parametrize("inner", ["", "*", "*/*", "*/*/kernel", "*/*/kernel/code.nbc"])
def test_a_cache_that_others_can_write_to_is_refused(cache, inner):
    for folder in (cache, *cache.rglob("*")):
        folder.chmod(0o755)
    kernel_cache._check(cache)
    [opened] = cache.glob(inner) if inner else [cache]
    opened.chmod(0o775)
    assert f"{opened} can be written by other users (mode 0775)" in refusal(cache)


def test_behind_a_closed_folder_permissions_do_not_matter(cache):
    """As numba makes its folders with umask 0."""
    for folder in cache.rglob("*"):
        folder.chmod(0o777)
    kernel_cache._check(cache)


def test_a_cache_in_a_folder_where_others_could_replace_it_is_refused(cache):
    above = cache.parent
    above.chmod(0o777)
    try:
        assert f"{above} can be written by every user" in refusal(cache)
        above.chmod(0o1777)
        kernel_cache._check(cache)
    finally:
        above.chmod(0o700)


def test_a_link_in_a_cache_is_refused(cache, tmp_path):
    (cache / "digest").symlink_to(tmp_path)
    assert f"{cache / 'digest'} is a link" in refusal(cache)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to another user")
@pytest.mark.parametrize("inner", ["", "*", "*/*/kernel/code.nbc"])
def test_a_cache_of_another_user_is_refused(cache, inner):
    [given] = cache.glob(inner) if inner else [cache]
    os.chown(given, 65534, 65534)
    assert f"{given} belongs to another user" in refusal(cache)


def test_a_process_does_not_use_a_cache_that_is_refused(cache):
    cache.chmod(0o777)
    code = f"from worker.kernel_cache import claim_cache; claim_cache({str(cache)!r})"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "CacheRefused" in done.stderr


def test_this_process_keeps_its_claim():
    assert str(kernel_cache.claim_cache()) == os.environ["NUMBA_CACHE_DIR"]


def test_finished_cache_is_published_once_and_old_ones_are_forgotten(tmp_path):
    old, other, new = (tmp_path / name for name in ("old", "other", "new"))
    for folder in (old, other, new):
        (folder / "slot-0").mkdir(parents=True)
        (folder / "slot-0" / "held").touch()
    long_ago = time.time() - 15 * 24 * 3600
    os.utime(old / "slot-0" / "held", (long_ago, long_ago))
    (tmp_path / "somebody's").mkdir()
    (new / "slot-0" / "code.nbc").write_bytes(b"code")

    kernel_cache._publish(new / "slot-0")
    assert [path.name for path in (new / "ready").iterdir()] == ["code.nbc"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "other", "somebody's"]

    (new / "slot-0" / "more.nbc").write_bytes(b"more")
    kernel_cache._publish(new / "slot-0")
    assert [path.name for path in (new / "ready").iterdir()] == ["code.nbc"]
