"""The watchdog of a worker: what it lets a chunk do, and why it ends the process."""

import faulthandler
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from chunks import planned
from distributed import Client, LocalCluster
from scripted import DEADLINE, small, wait_for

from worker import store, watchdog
from worker.study import ChunkCancelled
from worker.study.chunks import USUAL
from worker.watchdog import Watchdog, run_watched

LIMIT = 1000 << 20


class Process:
    """What the watchdog reads of a worker: the memory that it uses, and its limit."""

    def __init__(self, used: int = 0, limit: int | None = None) -> None:
        self.memory_manager = SimpleNamespace(memory_limit=limit)
        self.monitor = SimpleNamespace(get_process_memory=lambda: used)


def test_a_chunk_that_does_not_stop_a_second_after_its_cancel_was_seen_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The flag is looked for twice a second."""
    monkeypatch.setattr(watchdog, "time", SimpleNamespace(monotonic=lambda: 0.0))
    url = str(tmp_path / "a.zarr")
    dog = Watchdog(Process(), url, 100.0, print)
    store.set_cancelled(url)
    ended = [now for now in (0.5, 0.75, 1.25, 1.75, 2.0) if dog._reason_to_terminate(now)]
    assert ended == [2.0]
    assert dog._reason_to_terminate(2.0) == (
        "it was cancelled and did not stop; its worker process was terminated"
    )
    store.clear_cancelled(url)  # it was resumed
    assert dog._reason_to_terminate(3.0) is None
    store.set_cancelled(url)
    assert [now for now in (4.0, 4.75, 5.25) if dog._reason_to_terminate(now)] == [5.25]


def test_a_store_out_of_reach_is_no_reason_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def away(_: str) -> bool:
        raise ConnectionError

    monkeypatch.setattr(watchdog, "time", SimpleNamespace(monotonic=lambda: 0.0))
    monkeypatch.setattr(store, "is_cancelled", away)
    dog = Watchdog(Process(), str(tmp_path / "a.zarr"), 100.0, print)
    assert [dog._reason_to_terminate(now) for now in (1.0, 2.0, 3.0)] == [None] * 3


def watching() -> bool:
    return any(thread.name == "watchdog" for thread in threading.enumerate())


def test_nothing_is_ended_whose_chunk_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(watchdog, "CHECK_SECONDS", 0.001)
    looking, done, whys, process = threading.Event(), threading.Event(), [], Process(limit=LIMIT)

    def memory() -> int:
        looking.set()
        assert done.wait(DEADLINE)
        return LIMIT

    process.monitor.get_process_memory = memory
    with Watchdog(process, str(tmp_path / "a.zarr"), 100.0, whys.append):
        assert looking.wait(DEADLINE)
    done.set()
    wait_for(lambda: not watching())
    assert whys == []


def test_a_job_cancelled_while_its_kernel_is_compiled_does_not_begin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """On a worker that is a thread of this process, which must not end."""
    url, spec, compiled, begun = str(tmp_path / "a.zarr"), small(), threading.Event(), []
    chunk = planned(url, spec)[0]

    def compile_for(_: Any) -> None:
        store.set_cancelled(url)
        assert compiled.wait(DEADLINE)

    for name in ("dump_traceback_later", "cancel_dump_traceback_later"):
        monkeypatch.setattr(faulthandler, name, lambda *_, **__: None)
    monkeypatch.setattr(watchdog, "FLAG_SECONDS", 0.001)
    monkeypatch.setattr(watchdog, "compile_for", compile_for)
    monkeypatch.setattr(watchdog, "run_task", lambda *_: begun.append(1))
    options = {"n_workers": 1, "threads_per_worker": 1, "memory_limit": None, "dashboard_address": None}
    with (
        LocalCluster(processes=False, **options) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        try:
            answer = client.submit(run_watched, spec, chunk, url, USUAL, pure=False).result(DEADLINE)
        finally:
            compiled.set()
    assert isinstance(answer, ChunkCancelled)
    assert begun == []
