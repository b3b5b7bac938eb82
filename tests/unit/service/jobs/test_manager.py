"""Jobs from submission to their end, through cancels, restarts and errors.

The executors compute with the real task into real stores; scripts raise the errors.
"""

import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from scripted import DEADLINE, Held, Scripted, hanging, sweep, wait_for
from served import Running, running
from studies import spec_of

from kernel.params import KERNEL_VERSION, Outcome
from service.errors import IllegalTransition, KeyReused, QueueFull, UnknownJob
from service.jobs import manager
from service.jobs.budgets import Budget, Budgets
from service.jobs.manager import JobManager
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, JobState
from service.settings import Settings
from worker import store
from worker.executors.base import ClusterState
from worker.executors.inline import Inline
from worker.studies import parse, study_of
from worker.study import Chunk, ChunkReport
from worker.sweep import SweepSpec


def test_many_at_once_submitting_the_same_sweep_make_one_job(tmp_path: Path, inline: Inline):
    with running(tmp_path, inline) as service:
        answers: list[bool] = []
        threads = [
            threading.Thread(target=lambda: answers.append(service.manager.submit(sweep()).accepted))
            for _ in range(8)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        service.until(service.manager.submit(sweep()).job, JobState.DONE)
    assert sorted(answers) == [False] * 7 + [True]


class Late(Budgets):
    """Budgets whose thread is held up until the job that it would cancel has ended."""

    def may_cancel(self, job_id: str) -> bool:
        wait_for(lambda: self.manager.is_done(sweep()))
        return super().may_cancel(job_id)


def test_a_level_that_ends_with_its_time_does_not_end_the_budget(tmp_path: Path, inline: Inline):
    with running(tmp_path, inline) as service:
        budgets = Late(service.manager, service.ledger, lambda *_: None, lambda *_: None)
        assert not Budget(budgets, sweep(), 60.0, None, None).compute(sweep(), 0.0)


def of_cells(cells: int, omega: float = 0.5) -> SweepSpec:
    """A sweep of so many cells, its name their number; chunks have four of them, or an eighth."""
    return sweep(f"{cells}", gamma={"start": 0.5, "stop": 1.2, "num": cells}, omega=omega)


def test_every_job_gets_turns_however_many_smaller_ones_follow(tmp_path: Path):
    """Beside a stream of small jobs that does not end, a large one ends."""
    held = Held(capacity=2)
    with running(tmp_path, held, active_jobs=2) as service:
        large = service.submit(of_cells(28))
        small: list[JobRecord] = []

        def large_is_done() -> bool:
            unfinished = [job for job in small[-3:] if service.job(job).state is not JobState.DONE]
            if len(unfinished) < 3:
                small.append(service.submit(of_cells(8, omega=0.2 + len(small) / 1e4)))
            if held.held("8"):  # there always is a smaller job's chunk that could come first
                held.let_go_first()
            return service.job(large).state is JobState.DONE

        wait_for(large_is_done)
        assert len(small) > 2


# Cancelling and resuming


def test_a_running_job_is_cancelled_when_nothing_writes_any_more(tmp_path: Path):
    held = Held()
    with running(tmp_path, held) as service:
        job = service.submit(sweep())
        wait_for(lambda: held.held() == 4)
        held.let_go()  # one is written before the cancel
        wait_for(lambda: service.job(job).chunks_done == 1 and held.held() == 4)
        service.manager.cancel(job.id)
        url = service.settings.store_of(job.store)
        wait_for(lambda: store.is_cancelled(url))
        assert service.manager.cancel(job.id).state is JobState.RUNNING  # twice is once
        for _ in range(4):
            assert service.job(job).state is JobState.RUNNING
            held.let_go()
        job = service.until(job, JobState.CANCELLED)
    assert (job.chunks_done, job.error) == (1, None)
    assert held.held() == 0


def test_a_job_deleted_while_its_store_is_made_leaves_none(
    tmp_path: Path, inline: Inline, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    with running(tmp_path, inline) as service, hanging(monkeypatch, store, "create") as (making, go_on):
        job = service.submit(sweep())
        assert making.wait(DEADLINE)
        service.manager.cancel(job.id)
        service.manager.delete(job.id)
        assert service.ledger.find(job.id) is None
        caplog.set_level("INFO")
        go_on.set()
        wait_for(lambda: "deleted while its store was written" in caplog.text)
        wait_for(lambda: service.pending_deletions() == 0)
        assert list((tmp_path / "stores").iterdir()) == []


# What goes wrong


@pytest.mark.parametrize("where", [".", ".partial", "outcome"])
def test_nothing_is_written_through_a_link_in_the_data_folder(tmp_path: Path, where: str):
    link = Path(Settings(data=tmp_path).store_of(f"1-{sweep().job_id(KERNEL_VERSION)}.zarr"), where)
    link.parent.mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "their.partial").touch()
    link.symlink_to(tmp_path / "elsewhere")
    with closing(Scripted()) as executor, running(tmp_path, executor) as service:
        job = service.until(service.submit(sweep()), JobState.FAILED)
        assert f"nothing is written through a symbolic link: '{link}'" in str(job.error)
        link.unlink()
        service.manager.resume(job.id)
        service.until(job, JobState.DONE)
    assert [path.name for path in (tmp_path / "elsewhere").iterdir()] == ["their.partial"]


class Refusing(Scripted):
    """Refuses the chunks of jobs called "refused", `refusals` times, with an error nobody foresaw."""

    refusals = 1_000

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str, *_: Any) -> "Future[ChunkReport]":
        if spec.name == "refused" and self.refusals:
            self.refusals -= 1
            raise KeyError("a field of the executor's own")
        return super().submit(spec, chunk, store_url)


def test_a_job_that_the_executor_refuses_fails_with_the_reason_and_others_are_done(tmp_path: Path):
    with (
        closing(Refusing()) as executor,
        running(tmp_path, executor, chunk_tries=3, failed_chunks=2) as service,
    ):
        refused = service.submit(sweep("refused"))
        service.until(service.submit(sweep("taken", omega=0.7)), JobState.DONE)
        job = service.until(refused, JobState.FAILED)
        assert 'KeyError: "a field of the executor\'s own" (3 times) (and 1 more chunk failed)' in job.error
        assert Refusing.refusals - executor.refusals == 3 * 2
        executor.refusals = 0
        service.until(service.submit(sweep("refused")), JobState.DONE)


class Mistaken(Scripted):
    """A worker that computes what it is told, and first reports another chunk."""

    def __init__(self, **wrong: int) -> None:
        super().__init__()
        self.wrong, self.mistakes = wrong, 0

    def _run(self, spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
        report = super()._run(spec, chunk, store_url)
        self.mistakes += 1
        return replace(report, **self.wrong) if self.mistakes == 1 else report


@pytest.mark.parametrize("wrong", [{"index": 1}, {"index": 10**9}, {"cells": 10**6}])
def test_a_report_of_another_chunk_is_the_workers_failure(tmp_path: Path, wrong: dict[str, int]):
    with closing(Mistaken(**wrong)) as executor, running(tmp_path, executor) as service:
        job = service.until(service.submit(sweep()), JobState.DONE)
        assert executor.mistakes == job.chunks_total + 1
        assert job.cells_done == job.cells_total
        assert np.all(service.outcomes(job) != Outcome.MISSING)


def test_a_chunk_found_damaged_is_removed_and_computed_again_by_a_running_job_too(tmp_path: Path):
    held = Held(capacity=1)
    with running(tmp_path, held) as service:
        job = service.submit(sweep())
        for done in (1, 2):
            wait_for(lambda: held.held() > 0)
            held.let_go()
            wait_for(lambda done=done: service.job(job).chunks_done == done)
        outcome = Path(service.settings.store_of(job.store)) / "outcome" / "c.0.0.0.0"
        repair = service.manager.supervisor.repair(job.id, [(0, 0, 0, 0), (0, 0, 0, 7)])
        assert repair.detail.startswith("stored results are damaged and computed again: chunk 0 (rest, ")
        assert (list(repair.unmarked), outcome.exists()) == ([0], False)  # the other was not yet done
        held.let_go_until(lambda: service.job(job).state is JobState.DONE)
        assert service.manager.supervisor.repair(job.id, [(0, 0, 0, 0)]).unmarked == [0]
        assert service.job(job).repairing
        held.let_go_until(lambda: service.job(job).state is JobState.DONE)
        assert np.all(service.outcomes(job) != Outcome.MISSING)
        with pytest.raises(UnknownJob):
            service.manager.supervisor.repair("0" * 32, [])
    assert [chunk for _, chunk in held.order].count(0) == 3


def test_a_job_whose_run_breaks_is_made_anew_and_fails_the_third_time(
    tmp_path: Path, inline: Inline, monkeypatch: pytest.MonkeyPatch
):
    real, broken = store.sync_folders, list[str]()

    def sync_folders(url: str, *layout: Any) -> None:
        if url == service.settings.store_of(job.store):
            broken.append(url)
            raise KeyError("a field")
        real(url, *layout)

    with running(tmp_path, inline, heartbeat_seconds=0.02) as service:
        monkeypatch.setattr(store, "sync_folders", sync_folders)
        job, other = service.submit(sweep()), service.submit(sweep(omega=0.6))
        assert service.until(job, JobState.FAILED).error == "internal error: KeyError: 'a field'"
        assert len(broken) == 3
        service.until(other, JobState.DONE)


def test_without_workers_a_cancelled_job_ends_at_once(tmp_path: Path):
    class Vanishing(Held):
        def state(self) -> ClusterState:
            return ClusterState(connected=True, workers=self.capacity)

    held = Vanishing()
    with running(tmp_path, held, heartbeat_seconds=0.02) as service:
        job = service.submit(sweep())
        wait_for(held.held)
        held.capacity = 0
        service.manager.cancel(job.id)
        service.until(job, JobState.CANCELLED)
        assert all(future.cancelled() for future, *_ in held.chunks)


# Limits


def test_waiting_takes_no_processor_time(tmp_path: Path):
    """By the clocks of the service's own threads: other threads of this process may be busy."""
    held, others = Held(), {thread.native_id for thread in threading.enumerate()}

    def spent() -> float:
        ours = [thread for thread in psutil.Process().threads() if thread.id not in others]
        assert ours
        return sum(thread.user_time + thread.system_time for thread in ours)

    with running(tmp_path, held, heartbeat_seconds=600.0) as service:
        service.submit(sweep())
        wait_for(lambda: held.held() == 4)
        before = spent()
        time.sleep(0.5)
        assert spent() - before < 0.1


def test_stopping_is_prompt(tmp_path: Path):
    """Each thread ends at once, and not with the next heartbeat."""
    with running(tmp_path, Held(), heartbeat_seconds=2 * DEADLINE) as service:
        service.until(service.submit(sweep()), JobState.RUNNING)
        service.manager.stop()
        wait_for(lambda: not service.manager.supervisor._thread.is_alive())


# Jobs as users change them, while nothing is computed


@contextmanager
def unstarted(folder: Path, **options: Any) -> Iterator[Running]:
    """A job manager whose threads are not started."""
    settings = Settings(data=folder, **options)
    with Ledger(settings.ledger_path) as ledger:
        yield Running(ledger, JobManager(ledger, Held(), settings), settings)


def test_a_key_makes_a_repeated_request_one_request(tmp_path: Path):
    with unstarted(tmp_path) as service:
        first = service.manager.submit(sweep(), key="once")
        assert first.accepted
        assert not service.manager.submit(sweep(), key="once").accepted
        service.manager.cancel(first.job.id)
        again = service.manager.submit(sweep(), key="once")
        assert (again.accepted, again.job.state) == (False, JobState.CANCELLED)
        with pytest.raises(KeyReused, match="used for another specification less than 86400 s ago"):
            service.manager.submit(sweep(omega=0.6), key="once")
        assert service.manager.submit(sweep(), key="another").accepted
        assert service.manager.submit(sweep(omega=0.6)).accepted
    with unstarted(tmp_path, key_seconds=1e-9) as service:
        assert not service.manager.submit(sweep(), key="another").accepted  # it is queued
        service.manager.cancel(first.job.id)
        assert service.manager.submit(sweep(), key="another").accepted


@pytest.mark.parametrize(
    ("workers", "lines", "in_a_row"), [(2, 1, 1), (2, 2, 1), (2, 4, 2), (2, 5, None), (0, 1, None)]
)
def test_the_table_of_costs_tells_the_time_left_of_few_chunks(
    tmp_path: Path, monkeypatch, workers: int, lines: int, in_a_row: int | None
):
    gamma, omega = {"start": 1.5, "stop": 5.0, "num": 2000}, np.linspace(0.5, 1.0, lines).tolist()
    spec = parse(spec_of(gamma, omega, 0.26, protocol={"kind": "multistability"}))
    line = study_of(spec).estimate(spec, plan := study_of(spec).plan(spec)).core_seconds / len(plan)
    held = Held(capacity=workers)
    monkeypatch.setattr(held, "state", lambda: ClusterState(True, workers))  # connected without workers too
    with running(tmp_path, held) as service:
        job = service.until(service.submit(spec), JobState.RUNNING)
        assert job.chunks_total == lines
        assert job.seconds_left == (in_a_row and pytest.approx(in_a_row * line, abs=5.0))


def test_few_requests_wait_for_a_pace_and_others_get_the_table_at_once(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(manager, "WAITING", 2)
    with unstarted(tmp_path) as service, ThreadPoolExecutor(2) as threads:
        asked: list[Future[Any]] = []
        service.manager._executor.call = lambda *call: asked.append(Future()) or asked[-1]
        waiting = [threads.submit(service.manager.cost, sweep(omega=omega)) for omega in (0.6, 0.7)]
        wait_for(lambda: len(asked) == 2)
        assert service.manager.cost(sweep()).basis == "table"
        assert len(asked) == 2
        for told in asked:
            told.set_result(1.0)
        assert {each.result().basis for each in waiting} == {"measured"}


def test_a_job_is_resumed_by_whoever_asks_and_only_if_it_ended_undone(tmp_path: Path):
    with unstarted(tmp_path) as service:
        job = service.manager.submit(sweep(), owner="ann").job
        assert job.owner == "ann"
        assert not service.manager.resume(job.id, "dan").accepted
        assert service.job(job).owner == "ann"
        service.manager.cancel(job.id)
        resumed = service.manager.resume(job.id, "dan")
        assert (resumed.accepted, resumed.job.state, resumed.job.owner) == (True, JobState.QUEUED, "dan")
        with service.ledger.writing() as ledger:
            ledger.run(resumed.job, 1.0)
        assert service.manager.cancel(job.id).cancel_requested
        assert service.manager.resume(job.id).accepted  # the cancel is taken back
        assert not service.job(job).cancel_requested
        assert not service.manager.resume(job.id).accepted
        with service.ledger.writing() as ledger:
            ledger.finish(service.job(job), JobState.DONE, 2.0)
        with pytest.raises(IllegalTransition, match=r"nothing to resume$"):
            service.manager.resume(job.id)
        with service.ledger.writing() as ledger:
            ledger._sql.execute("UPDATE jobs SET kernel_version = '0'")
        with pytest.raises(IllegalTransition, match="submit the sweep again to compute it anew"):
            service.manager.resume(job.id)


def test_a_token_has_its_part_of_the_queue(tmp_path: Path):
    omegas = iter(np.arange(0.5, 1.5, 0.01).tolist())

    def submit(owner: str | None) -> JobRecord:
        return service.manager.submit(sweep(omega=next(omegas)), owner=owner).job

    with unstarted(tmp_path, max_queue=5, max_queue_per_token=2) as service:
        first = submit("ann")
        submit("ann")
        with pytest.raises(
            QueueFull, match="2 jobs of the token ann are queued or running already, at most 2"
        ):
            submit("ann")
        submit("dan")
        submit(None)
        submit(None)
        with pytest.raises(QueueFull, match="5 jobs are queued or running already, at most 5 may be"):
            submit(None)
        service.manager.cancel(first.id)
        submit("dan")
        with pytest.raises(QueueFull):
            service.manager.resume(first.id, "ann")


def test_the_end_of_a_job_removes_what_a_slice_of_an_earlier_start_left(tmp_path: Path):
    held = Held()
    with running(tmp_path, held) as service:
        job = service.submit(sweep())
        wait_for(lambda: held.held() > 0)
        url = service.settings.store_of(service.job(job).store)
        store.write_checkpoint(url, 0, {"late": np.zeros(1)})
        held.let_go_until(lambda: service.job(job).state is JobState.DONE)
        assert store.checkpoints_in(url) == []
