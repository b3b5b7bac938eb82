"""Random faults of the ledger, and what is left afterwards.

    python -m benchmarks.ledger_faults [--faults 50] [--seed 1] [--lock-seconds 60]

Each trial starts from a folder with done jobs and a backup of before some of them, adds jobs, one of which
waits, and draws a fault: of the file while no service runs, after a kill, or under the running service. It
then does what the messages say: puts the file back, or restores a backup and adopts what that does not know.

Prints one line per kind of fault: how often it was told (the start is refused with a reason, /readyz answers
503 with one, or it names unknown stores; or nothing was wrong), and what was lost. Exits with 1 if a store
or a job is lost that the ledger still held, if a fault was not told, or if the service does not work then.
"""

import argparse
import hashlib
import os
import random
import shutil
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

from fastapi.testclient import TestClient

from benchmarks.machine import describe
from service.api.app import create_app
from service.errors import NotAdoptable, NotStarted
from service.jobs import backup
from service.jobs.ledger_files import copies_of, size_of, wal_of
from service.jobs.stores import adoption
from service.settings import Settings
from worker.executors.inline import Inline

#: Seconds within which a fault must be told, and a job done.
SOON = 60.0


class Stoppable(Inline):
    """Computes in this process; without workers while `stopped`."""

    stopped = False

    def workers(self) -> int:
        return 0 if self.stopped else 1


def sweep(number: int) -> dict[str, Any]:
    return {
        "gamma": {"start": 0.5, "stop": 5.0, "num": 20},
        "omega": 0.4 + number / 1000,
        "xi": [0.05, 0.26],
        "model": {"kind": "rigid"},
        "settle": 20,
        "observe": 20,
        "keep": 8,
    }


class Service:
    """The application on a folder, in this process."""

    def __init__(self, client: TestClient, executor: Stoppable) -> None:
        self.client, self.executor = client, executor

    def submit(self, number: int) -> str:
        answer = self.client.post("/v1/jobs", json=sweep(number))
        if answer.status_code not in (200, 202):
            raise SystemExit(f"a job is refused: {answer.text}")
        return str(answer.json()["id"])

    def states(self) -> dict[str, str]:
        listed = self.client.get("/v1/jobs", params={"limit": 100}).json()["jobs"]
        return {job["id"]: job["state"] for job in listed}

    def until(self, condition: Callable[[], bool]) -> bool:
        deadline = time.monotonic() + SOON
        while not condition():
            if time.monotonic() > deadline:
                return False
            time.sleep(0.02)
        return True

    def done(self, *ids: str) -> bool:
        return self.until(lambda: all(self.states().get(job) == "done" for job in ids))

    def ready(self) -> bool:
        return self.client.get("/readyz").status_code == 200

    def notices(self) -> list[str]:
        return list(self.client.get("/readyz").json().get("notices", []))


@contextmanager
def service(folder: Path) -> Iterator[Service]:
    settings = Settings(data=folder, heartbeat_seconds=0.1)
    with closing(Stoppable()) as executor:
        app = create_app(settings, executor)
        with TestClient(app, base_url="http://localhost") as client:
            yield Service(client, executor)


def digests(folder: Path) -> dict[str, str]:
    """By store, of every file in it."""
    found = {}
    for store in sorted((folder / "stores").glob("*.zarr")):
        digest = hashlib.sha256()
        for path in sorted(path for path in store.rglob("*") if path.is_file()):
            digest.update(str(path.relative_to(store)).encode() + path.read_bytes())
        found[store.stem] = digest.hexdigest()
    return found


class Trial:
    """One fault: `base` is a folder with done jobs beside a backup of before the last of them."""

    def __init__(self, base: Path, folder: Path, rng: random.Random, lock_seconds: float) -> None:
        self.folder, self.rng, self.lock_seconds = folder, rng, lock_seconds
        shutil.copytree(base, folder)
        self.data, self.ledger = folder / "data", folder / "data" / "ledger.sqlite"
        self.told = False
        self.ledger_lost = False  # what it held since the backup

    def run(self, fault: Callable[["Trial"], None]) -> Counter[str]:
        with service(self.data) as running:
            new = [running.submit(100 + number) for number in range(2)]
            running.done(*new)
            running.executor.stopped = True
            self.waiting = running.submit(200)
            self.acknowledged = set(running.states())
            self.stored = {job: digest for job, digest in digests(self.data).items() if job != self.waiting}
            if fault in WHILE_RUNNING:
                self.running = running
                fault(self)
            elif fault in AFTER_KILL:
                shutil.copytree(self.data, self.folder / "killed")  # as a kill leaves the files
        if fault in AFTER_KILL:
            shutil.rmtree(self.data)
            (self.folder / "killed").rename(self.data)
        if fault not in WHILE_RUNNING:
            fault(self)
        self._start_or_restore()
        return self._judge()

    def _start_or_restore(self) -> None:
        """Start the service as an operator does who follows its messages."""
        settings = Settings(data=self.data)
        try:
            with adoption.open_ledger(settings) as ledger:
                unknown = adoption.find_unknown(ledger, settings)
        except NotStarted as refused:
            self.told = self.told or "restore" in str(refused)
            rescued = [copy for copy in copies_of(self.ledger) if "rescued" in copy.name]
            self.ledger_lost = not rescued
            backup.restore(self.ledger, rescued[-1] if rescued else self.folder / "backup.sqlite")
        else:
            with service(self.data) as running:
                running.until(lambda: bool(running.notices()) == bool(unknown))
                nothing_wrong = not unknown and self.acknowledged <= set(running.states())
                self.told = self.told or nothing_wrong or any("does not know" in n for n in running.notices())
        with adoption.open_ledger(settings) as ledger:
            for url in adoption.find_unknown(ledger, settings):
                try:
                    adoption.adopt(ledger, settings, Path(url).stem)
                except NotAdoptable as refused:
                    print(f"  {refused}")

    def _judge(self) -> Counter[str]:
        with service(self.data) as running:
            usable = running.done(running.submit(300))
            states = running.states()
            expected = set(self.stored) if self.ledger_lost else self.acknowledged
            lost = {job for job in expected if job not in states}
            if self.waiting in states:
                usable = running.done(self.waiting) and usable
        now = digests(self.data)
        return Counter(
            trials=1,
            told=int(self.told),
            stores_lost=sum(now.get(job) != digest for job, digest in self.stored.items()),
            jobs_lost=len(lost),
            usable=int(usable),
        )

    # While the service runs

    def refused(self) -> None:
        """Wait until the service says that it is not ready, and see that it accepts nothing."""
        self.told = self.running.until(lambda: not self.running.ready())
        answer = self.running.client.post("/v1/jobs", json=sweep(400))
        self.told = self.told and answer.status_code == 503 and "ledger" in answer.json()["detail"]

    def locked(self) -> None:
        with closing(sqlite3.connect(self.ledger, isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            until = time.monotonic() + self.rng.uniform(5.0, max(self.lock_seconds, 5.0))
            self.running.client.post("/v1/jobs", json=sweep(400))  # waits for ten seconds
            self.told = self.running.until(lambda: not self.running.ready()) or time.monotonic() > until
            time.sleep(max(until - time.monotonic(), 0.0))
            other.execute("ROLLBACK")
        self.told = self.running.until(self.running.ready) and self.told

    def moved(self) -> None:
        path = self.rng.choice([self.data, self.ledger, self.data / "ledger.lock"])
        path.rename(self.folder / "elsewhere")
        self.refused()
        (self.folder / "elsewhere").rename(path)
        self.told = self.running.until(self.running.ready) and self.told

    def replaced(self) -> None:
        shutil.copyfile(self.folder / "backup.sqlite", self.folder / "other.sqlite")
        (self.folder / "other.sqlite").replace(self.ledger)
        self.refused()
        self.ledger.unlink()  # the operator takes what the service has kept

    def removed(self) -> None:
        self.ledger.unlink()
        self.refused()

    def overwritten(self) -> None:
        """With an older copy, in place."""
        self.ledger.write_bytes((self.folder / "backup.sqlite").read_bytes())
        self.refused()
        self.ledger_lost = True

    def log_lost(self) -> None:
        wal_of(self.ledger).unlink()
        if self.rng.random() < 0.5:
            wal_of(self.ledger).write_bytes(os.urandom(9_000))
        self.told = self.running.until(lambda: size_of(wal_of(self.ledger)) not in (0, 9_000))

    # While it does not

    def emptied(self) -> None:
        os.truncate(self.ledger, 0)

    def cut(self) -> None:
        os.truncate(self.ledger, self.rng.randrange(1, self.ledger.stat().st_size))

    def page(self) -> None:
        pages = self.ledger.stat().st_size // 4096
        with self.ledger.open("r+b") as file:
            file.seek(4096 * self.rng.randrange(pages))
            file.write(os.urandom(4096))

    def older(self) -> None:
        for path in self.data.glob("ledger.sqlite*"):
            path.unlink()
        shutil.copyfile(self.folder / "backup.sqlite", self.ledger)
        self.ledger_lost = True

    def log_removed(self) -> None:
        wal_of(self.ledger).unlink()
        self.ledger_lost = True

    def log_foreign(self) -> None:
        """That of a copy of the backup, in which something else was written."""
        other = self.folder / "other.sqlite"
        shutil.copyfile(self.folder / "backup.sqlite", other)
        with closing(sqlite3.connect(other, isolation_level=None)) as connection:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("UPDATE jobs SET name = 'another'")
            shutil.copyfile(wal_of(other), wal_of(self.ledger))
        self.ledger_lost = True


WHILE_RUNNING = (
    Trial.locked, Trial.moved, Trial.replaced, Trial.removed, Trial.overwritten, Trial.log_lost,
)  # fmt: skip
AFTER_KILL = (Trial.log_removed, Trial.log_foreign, Trial.page)
WHILE_STOPPED = (Trial.emptied, Trial.cut, Trial.older)
KINDS = (*WHILE_RUNNING, *AFTER_KILL, *WHILE_STOPPED)


def prepare(folder: Path) -> None:
    """A folder with done jobs, and a backup of before the last of them."""
    with service(folder / "data") as running:
        running.done(*[running.submit(number) for number in range(3)])
        backup.backup(folder / "data" / "ledger.sqlite", folder / "backup.sqlite")
        running.done(*[running.submit(number) for number in range(3, 6)])


def main() -> int:
    """Draw faults and print what became of them."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--faults", type=int, default=50)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--lock-seconds", type=float, default=60.0)
    arguments = options.parse_args()
    print(describe("fastapi", "zarr"))
    rng, sums = random.Random(arguments.seed), {kind.__name__: Counter[str]() for kind in KINDS}
    order = [KINDS[number % len(KINDS)] for number in range(arguments.faults)]
    rng.shuffle(order)
    with ExitStack() as stack:
        base = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        prepare(base)
        for kind in order:
            with tempfile.TemporaryDirectory() as folder:
                trial = Trial(base, Path(folder) / "trial", rng, arguments.lock_seconds)
                sums[kind.__name__] += trial.run(kind)
    print(f"{'fault':<14}{'trials':>8}{'told':>8}{'usable':>8}{'stores lost':>13}{'jobs lost':>11}")
    total = sum(sums.values(), Counter[str]())
    for name, counts in [*sums.items(), ("all", total)]:
        numbers = [counts[column] for column in ("trials", "told", "usable")]
        print(f"{name:<14}" + "".join(f"{number:>8}" for number in numbers), end="")
        print(f"{counts['stores_lost']:>13}{counts['jobs_lost']:>11}", flush=True)
    whole = total["trials"] == total["told"] == total["usable"]
    return int(not whole or total["stores_lost"] > 0 or total["jobs_lost"] > 0)


if __name__ == "__main__":
    sys.exit(main())
