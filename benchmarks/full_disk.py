"""A disk that becomes full, or has no inode left, at random moments of jobs, exports and backups.

    python -m benchmarks.full_disk [--moments 30] [--seed 1]

Runs `bounce serve` with its data on a small file system in memory, which needs root. At each moment a job is
computed, a file exported or the ledger backed up; meanwhile all bytes, or all inodes, of the disk are taken.
What was asked for must end, with a result or with the reason. Then the disk is emptied: the job is submitted
again, the export and the backup repeated, and each must give the same bytes as on an empty disk. Exits with 1
if the service does not live, something wrong is stored, or something is not repeatable.
"""

import argparse
import hashlib
import random
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from itertools import count
from pathlib import Path
from typing import Any, Final

import httpx2

from benchmarks.machine import describe
from benchmarks.serving import TIMEOUT, Serving, sweep

#: Enough for the ledger, a job and an export; few enough inodes to be used up in a moment.
OPTIONS: Final = "size=48m,nr_inodes=2500"
#: Seconds that the disk stays full after what was asked for has ended.
STILL_FULL: Final = 1.0
#: Seconds within which a job must end on a full disk and on an empty one.
PATIENCE: Final = 240.0


@contextmanager
def mounted(folder: Path, options: str) -> Iterator[Path]:
    """A file system in memory. Raises OSError where none can be mounted."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        raise OSError("file systems cannot be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(path: Path) -> None:
    """Write until not a byte is free."""
    with path.open("wb", buffering=0) as file:
        for size in (1 << 16, 1 << 12, 1):
            try:
                while True:
                    file.write(b"x" * size)
            except OSError:
                continue


def use_up_inodes(folder: Path) -> None:
    """Make files until the file system refuses: OSError."""
    for number in count():
        (folder / f"file {number}").touch()


class Moments:
    """The service, what it gave on an empty disk, and what happened."""

    def __init__(self, service: Serving, seed: int) -> None:
        self._service, self._rng = service, random.Random(seed)
        self.ends, self.wrong = Counter[str](), list[str]()
        self._took: dict[str, float] = {}
        self._spec = sweep(1, gammas=4_000, settle=100)
        self._kept = service.submit(sweep(2, gammas=2_000, settle=50))
        service.wait(self._kept)
        self._kinds: dict[str, Callable[[], str]] = {
            "job": self._job, "export nc": lambda: self._export("nc"),
            "export parquet": lambda: self._export("parquet"), "backup": self._backup,
        }  # fmt: skip
        self._expected = {kind: self._timed(kind) for kind in self._kinds}
        self._kept_digest = self._digest(self._kept)

    def _timed(self, kind: str) -> str:
        began = time.monotonic()
        result = self._kinds[kind]()
        self._took[kind] = time.monotonic() - began
        if kind == "job":
            self._delete()
        return result

    # What is asked for: each returns a digest of the result, or `refused: ` and the reason

    def _job(self) -> str:
        answer = httpx2.post(f"{self._service.url}/v1/jobs", json=self._spec, timeout=TIMEOUT)
        if answer.status_code in (503, 507):
            return f"refused: {answer.json()['detail']}"
        path = answer.raise_for_status().headers["Location"]
        until = time.monotonic() + PATIENCE
        while (job := self._get(path))["state"] in ("queued", "running"):
            if time.monotonic() > until:
                return f"hangs: {job}"
            time.sleep(0.05)
        return self._digest(path) if job["state"] == "done" else f"refused: {job['error']}"

    def _export(self, format: str) -> str:
        url = f"{self._service.url}{self._kept}/export?format={format}"
        answer = httpx2.get(url, timeout=PATIENCE)
        if answer.status_code == 507:
            return f"refused: {answer.json()['detail']}"
        if answer.status_code != 200:
            return f"{answer.status_code}: {answer.text[:300]}"
        # libhdf5 writes times into a file: of NetCDF the size is compared.
        return str(len(answer.content)) if format == "nc" else hashlib.sha256(answer.content).hexdigest()

    def _backup(self) -> str:
        target = self._service.data / "backup.sqlite"
        target.unlink(missing_ok=True)
        command = [sys.executable, "-m", "service.cli.main", "backup", str(target)]
        command += ["--data", str(self._service.data)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            left = " (a part of the file is left)" if target.exists() else ""
            return f"refused: {(done.stderr or done.stdout).strip()[-200:]}{left}"
        # Immutable: nothing is written beside it, for which there may be no room.
        with closing(sqlite3.connect(f"file:{target}?immutable=1", uri=True)) as backup:
            (whole,) = backup.execute("PRAGMA integrity_check").fetchone()
            (kept,) = backup.execute(
                "SELECT state FROM jobs WHERE id = ?", [Path(self._kept).name]
            ).fetchone()
        return f"{whole} {kept}"

    def _get(self, path: str) -> dict[str, Any]:
        job: dict[str, Any] = httpx2.get(self._service.url + path, timeout=TIMEOUT).json()
        return job

    def _digest(self, path: str) -> str:
        return self._service.digest({"id": Path(path).name})

    def _delete(self) -> None:
        """Remove the job of the last moment, and wait until its files are gone."""
        job_id = httpx2.post(f"{self._service.url}/v1/jobs", json=self._spec, timeout=TIMEOUT).json()["id"]
        store = self._service.data / "stores" / f"{job_id}.zarr"
        self._service.wait(f"/v1/jobs/{job_id}")
        self._service.delete(f"/v1/jobs/{job_id}")
        while store.exists():
            time.sleep(0.05)

    # The moments

    def try_one(self, number: int) -> None:
        """Fill the disk during one of them, see how it ends, and repeat it on an empty disk."""
        kind = list(self._kinds)[number % len(self._kinds)]
        what = self._rng.choice(["bytes", "inodes"])
        ballast = self._service.data / "ballast"
        results: list[str] = []
        working = threading.Thread(target=lambda: results.append(self._kinds[kind]()))
        working.start()
        moment = self._rng.uniform(0.0, self._took[kind])
        time.sleep(moment)
        ballast.mkdir()
        try:
            if what == "bytes":
                fill(ballast / "file")
            else:
                use_up_inodes(ballast)
        except OSError:
            pass  # no inode is left
        working.join(PATIENCE)
        time.sleep(STILL_FULL)
        status = httpx2.get(f"{self._service.url}/healthz", timeout=TIMEOUT).status_code
        for file in sorted(ballast.iterdir()):
            file.unlink()
        ballast.rmdir()
        again = self._kinds[kind]()
        self._judge(f"{kind} at {moment:.2f} s, no {what}", kind, results[0] if results else "hangs", again)
        if status != 200 or self._service.process.poll() is not None:
            self.wrong.append(f"{kind}, no {what}: the service does not live ({status})")
        if self._digest(self._kept) != self._kept_digest:
            self.wrong.append(f"{kind}, no {what}: stored results have changed")
        if list((self._service.data / "exports").iterdir()):
            self.wrong.append(f"{kind}, no {what}: a part of an export is left")
        if kind == "job":
            self._delete()

    def _judge(self, what: str, kind: str, first: str, again: str) -> None:
        refused = first.startswith("refused: ")
        self.ends[f"{kind}: {'refused' if refused else 'as on an empty disk'}"] += 1
        print(f"{what}: {first[:160] if refused else 'done'}", flush=True)
        if not refused and first != self._expected[kind]:
            self.wrong.append(f"{what}: {first}")
        if refused and not any(word in first for word in ("space", "disk", "full", "inode")):
            self.wrong.append(f"{what}: another reason: {first}")
        if "is left" in first:
            self.wrong.append(f"{what}: {first}")
        if again != self._expected[kind]:
            self.wrong.append(f"{what}: again: {again}")


def main() -> int:
    """Print what happened."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--moments", type=int, default=30)
    options.add_argument("--seed", type=int, default=1)
    arguments = options.parse_args()
    print(describe("zarr", "h5py", "pyarrow"), flush=True)
    with tempfile.TemporaryDirectory() as folder, mounted(Path(folder) / "data", OPTIONS):
        service = Serving(Path(folder))
        try:
            moments = Moments(service, arguments.seed)
            for number in range(arguments.moments):
                moments.try_one(number)
        finally:
            print(f"shut down in {service.end():.1f} s")
    print(f"{arguments.moments} moments: {dict(moments.ends)}; wrong: {len(moments.wrong)}")
    print("\n".join(moments.wrong))
    return int(bool(moments.wrong))


if __name__ == "__main__":
    sys.exit(main())
