"""Results that workers compute on request: awaited for a short time, kept, computed once."""

import time
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from scripted import wait_for

from service.background import Asker
from service.errors import Busy, NotComputed
from service.jobs import on_demand
from service.jobs.on_demand import OnDemandCache, Pending
from worker.executors.base import ClusterLost, ClusterState, WorkerDied, WorkerLeft


class Call(Future[Any]):
    """A timed call that a worker begins at once."""

    def __init__(self) -> None:
        super().__init__()
        self.began = on_demand.time.monotonic()

    def set_result(self, result: Any) -> None:
        super().set_result((result, on_demand.time.monotonic() - self.began))


class Pool:
    """An executor of 8 workers whose calls the test completes."""

    def __init__(self) -> None:
        self.futures: list[Call] = []
        self.calls: list[tuple[Any, ...]] = []
        self.capacity = 8

    def state(self) -> ClusterState:
        return ClusterState(True, self.capacity)

    def call(self, *call: Any) -> Future[Any]:
        self.calls.append(call)
        self.futures.append(Call())
        return self.futures[-1]


#: A result of two parts.
TWO = [(print,), (print,)]


def started(**options: Any) -> tuple[Pool, OnDemandCache]:
    pool = Pool()
    return pool, OnDemandCache(pool, **{"timeout": 0.01, **options})


def pending(cache: OnDemandCache, key: str, parts: list[Any]) -> None:
    with pytest.raises(Pending):
        cache.get(key, parts)


def test_a_result_that_nobody_asks_for_any_more_is_given_up(monkeypatch: pytest.MonkeyPatch):
    now = [100.0]
    monkeypatch.setattr(on_demand, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(on_demand, "LOOK_SECONDS", 0.01)
    monkeypatch.setattr(on_demand, "ABANDONED_SECONDS", 4.0)
    pool, cache = started(timeout=0.05)
    for _ in range(3):
        pending(cache, "key", TWO)
        now[0] += 3.0
    assert len(pool.futures) == 2
    now[0] += 2.0
    wait_for(lambda: all(future.cancelled() for future in pool.futures))
    pending(cache, "key", TWO)
    assert len(pool.futures) == 4
    cache.close()


def test_a_result_is_given_up_when_the_last_client_leaves():
    pool, cache = started()
    clients = [Asker(1), Asker(2)]
    for client in clients:
        client.run(lambda: pending(cache, "key", TWO))
    for client in clients:
        assert not any(future.cancelled() for future in pool.futures)
        client.leave()
    assert all(future.cancelled() for future in pool.futures)
    with pytest.raises(NotComputed):
        clients[0].run(lambda: cache.get("key", TWO))
    assert len(pool.futures) == 4


def test_what_a_client_waits_for_is_not_computed_anew_with_more_chunks():
    pool, cache = started()
    with pytest.raises(Pending):
        cache.get("key", [(print,)], chunks=1)
    pool.futures[0].set_result("of one chunk")
    assert cache.get("key", [(print,)], chunks=2) == ["of one chunk"]
    assert cache.get("key", [(print,)], chunks=3) == ["of one chunk"]
    cache.note_delivered(["key"])
    with pytest.raises(Pending):
        cache.get("key", [(print,)], chunks=3)
    assert len(pool.futures) == 2


@pytest.mark.parametrize(
    ("error", "raised"), [(WorkerDied("no memory"), NotComputed), (ValueError("a defect"), ValueError)]
)
def test_a_result_that_was_lost_or_failed_is_computed_again(error: Exception, raised: type[Exception]):
    pool, cache = started()
    pending(cache, "key", TWO)
    pool.futures[0].set_exception(error)
    pool.futures[1].set_result(1)
    with pytest.raises(raised):
        cache.get("key", TWO)
    pending(cache, "key", TWO)
    assert len(pool.futures) == 4


def test_a_part_whose_worker_was_told_to_leave_is_computed_by_another():
    pool, cache = started()
    pending(cache, "key", TWO)
    pool.futures[0].set_result(0)
    pool.futures[1].set_exception(WorkerLeft("its time is over"))
    pending(cache, "key", TWO)
    pool.futures[2].set_result(1)
    assert cache.get("key", TWO) == [0, 1]


def test_the_number_of_results_being_computed_is_limited(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(on_demand, "MAX_PENDING", 2)
    pool, cache = started()
    for key in ("one", "two"):
        pending(cache, key, TWO)
    with pytest.raises(Busy, match=r"^2 results are being computed already"):
        cache.get("three", TWO)
    for future in pool.futures:
        future.set_result(None)
    pending(cache, "three", TWO)


def test_only_the_results_requested_last_are_kept(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(on_demand, "MAX_RESULTS", 2)
    pool, cache = started()
    for key in ("one", "two", "three"):
        pending(cache, key, TWO)
        for future in pool.futures[-2:]:
            future.set_result(key)
    assert cache.get("two", TWO) == ["two", "two"]
    pending(cache, "one", TWO)
    assert len(pool.futures) == 8


def test_without_workers_nothing_is_computed(monkeypatch: pytest.MonkeyPatch):
    pool, cache = started()
    monkeypatch.setattr(pool, "call", Mock(side_effect=ClusterLost("gone")))
    with pytest.raises(NotComputed, match=r"^no worker has computed it \(gone\): repeat the request$"):
        cache.get("key", TWO)


@pytest.mark.parametrize(("workers", "share"), [(0, 1), (5, 2), (8, 4)])
def test_jobs_keep_half_of_the_workers_and_results_take_turns(workers: int, share: int):
    pool, cache = started()
    pool.capacity = workers
    pending(cache, "many", [(print, part) for part in range(9)])
    pending(cache, "more", [(print, part) for part in (9, 10)])
    assert len(pool.futures) == share
    for number in range(11):
        pool.futures[number].set_result(pool.calls[number][-1])
        assert len(pool.futures) == min(number + 1 + share, 11)
    assert [call[-1] for call in pool.calls[share : share + 4]] == [share, 9, share + 1, 10]
    assert cache.get("many", TWO) == list(range(9))
    assert cache.get("more", TWO) == [9, 10]


def test_beside_jobs_calls_keep_to_their_share(monkeypatch: pytest.MonkeyPatch):
    """As if it were an eighth of the time: of 8 workers a core-second per second, and ten at once."""
    now, jobs = [100.0], [True]
    monkeypatch.setattr(on_demand, "time", SimpleNamespace(monotonic=lambda: now[0]))
    for name, value in {"LOOK_SECONDS": 0.01, "SHARE": 1 / 8, "CREDIT_SECONDS": 10.0}.items():
        monkeypatch.setattr(on_demand, name, value)
    pool, cache = started(jobs_compute=lambda: jobs[0])
    pending(cache, "many", [(print,)] * 16)
    assert len(pool.futures) == 4
    now[0] += 5.0
    for number in range(4):
        pool.futures[number].set_result(number)
    assert len(pool.futures) == 6  # two were begun before 15 core-seconds were used of 10 and 5 earned
    now[0] += 4.0
    time.sleep(0.1)
    assert len(pool.futures) == 6  # 5 core-seconds too many were used: 4 are earned
    now[0] += 2.0
    wait_for(lambda: len(pool.futures) == 8)
    now[0] += 60.0
    for number in range(4, 8):
        pool.futures[number].set_result(number)
    assert len(pool.futures) == 8
    jobs[0] = False
    wait_for(lambda: len(pool.futures) == 12)
    for number in range(8, 16):
        pool.futures[number].set_result(number)
    assert cache.get("many", TWO) == list(range(16))


def test_after_a_long_call_another_result_soon_begins(monkeypatch: pytest.MonkeyPatch):
    """As if calls had no share: neither the rest of the result goes on, nor a third one begins soon."""
    now = [100.0]
    monkeypatch.setattr(on_demand, "time", SimpleNamespace(monotonic=lambda: now[0]))
    for name, value in {"SHARE": 0.0, "REST_SECONDS": 10.0, "LOOK_SECONDS": 0.01}.items():
        monkeypatch.setattr(on_demand, name, value)
    pool, cache = started(jobs_compute=lambda: 1)
    pool.capacity = 2
    pending(cache, "long", TWO)
    now[0] += 3600.0
    pool.futures[0].set_result("long")
    pending(cache, "short", [(print, "short")])
    pending(cache, "third", [(print, "third")])
    now[0] += 9.0
    time.sleep(0.1)
    assert len(pool.calls) == 1
    now[0] += 2.0
    wait_for(lambda: len(pool.calls) == 2)
    pool.futures[1].set_result("short")
    assert cache.get("short", []) == ["short"]
    time.sleep(0.1)
    assert [call[-1] for call in pool.calls] == [print, "short"]
    cache.close()


def test_a_call_that_waited_for_workers_or_their_chunks_delays_no_other(monkeypatch: pytest.MonkeyPatch):
    now = [100.0]
    monkeypatch.setattr(on_demand, "time", SimpleNamespace(monotonic=lambda: now[0]))
    pool, cache = started(jobs_compute=lambda: 1)
    pool.capacity = 0
    pending(cache, "first", [(print,)])
    now[0] += 3600.0
    pending(cache, "first", [(print,)])
    pool.capacity = 8
    pending(cache, "first", [(print,)])
    now[0] += 3600.0
    pool.futures[0].began = now[0]
    pool.futures[0].set_result("computed")
    assert cache.get("first", [(print,)]) == ["computed"]
    pending(cache, "second", [(print,)])
    assert len(pool.futures) == 2


def test_a_part_that_fails_leaves_its_turn_to_the_next():
    pool, cache = started()
    pending(cache, "many", [(print,)] * 6)
    pool.futures[0].set_exception(ValueError())
    pool.futures[1].cancel()
    assert len(pool.futures) == 6


def test_the_end_cancels_what_is_being_computed_and_no_call_begins_after_it():
    pool, cache = started()
    pending(cache, "many", [(print,)] * 6)
    cache.close()
    pending(cache, "late", TWO)
    assert [future.cancelled() for future in pool.futures] == [True] * 4
