"""A disk that fills up at random moments of jobs, exports and backups: each ends, and can be repeated."""

import os
import random
import re
import shutil
import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from pathlib import Path

import httpx2
import pytest
from disks import fill, mounted, use_up_inodes
from paths import CACHE

from benchmarks.serving import Serving, sweep

RUNS, PATIENCE = int(os.environ.get("BOUNCE_TEST_RUNS", "8")), 240.0  # s


def job(service: Serving, kept: str) -> str:
    """The digest of a job's files, or the reason against it."""
    answer = httpx2.post(f"{service.url}/v1/jobs", json=sweep(1, gammas=4_000, settle=100), timeout=PATIENCE)
    if answer.status_code in (503, 507):
        return answer.text
    try:
        return service.digest(service.wait(answer.raise_for_status().headers["Location"]))
    except SystemExit as failed:
        return str(failed)


def export(service: Serving, kept: str) -> str:
    """The size of a file, in which libhdf5 writes times, or the reason against it."""
    answer = httpx2.get(f"{service.url}{kept}/export?format=nc", timeout=PATIENCE)
    return answer.text if answer.status_code == 507 else str(len(answer.raise_for_status().content))


def back_up(service: Serving, kept: str) -> str:
    """The state of a job in a backup, or the reason against it."""
    target = service.data / "backup.sqlite"
    target.unlink(missing_ok=True)
    words = [sys.executable, "-m", "service.cli.entry", "backup", str(target), "--data", str(service.data)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert target.exists() == (done.returncode == 0)
    if done.returncode:
        return done.stderr
    with closing(sqlite3.connect(f"file:{target}?immutable=1", uri=True)) as copy:
        return str(copy.execute("PRAGMA integrity_check").fetchone())


@pytest.mark.timeout(1800)
def test_what_was_asked_for_ends_and_can_be_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(CACHE))
    chance = random.Random(1)
    with mounted(tmp_path / "data", "size=48m,nr_inodes=2500") as folder, Serving(tmp_path) as service:
        kept = service.submit(sweep(2, gammas=2_000, settle=50))
        whole, ballast = service.digest(service.wait(kept)), folder / "ballast"
        for number in range(RUNS):
            kind = (job, export, back_up)[number % 3]
            began, expected = time.monotonic(), kind(service, kept)
            took = time.monotonic() - began
            if kind is job:
                service.delete(service.submit(sweep(1, gammas=4_000, settle=100)))
            with ThreadPoolExecutor(1) as pool:
                first = pool.submit(kind, service, kept)
                time.sleep(chance.uniform(0.0, took))
                ballast.mkdir()
                with suppress(OSError):
                    fill(ballast / "file") if number % 2 else use_up_inodes(ballast)
                ended = first.result(PATIENCE)
            assert ended == expected or re.search("space|disk|full|inode", ended), ended
            assert httpx2.get(f"{service.url}/healthz", timeout=PATIENCE).status_code == 200
            shutil.rmtree(ballast)
            assert kind(service, kept) == expected
            assert service.digest({"id": Path(kept).name}) == whole
            assert list(folder.glob("exports/*")) == []
