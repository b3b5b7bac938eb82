"""The operations of users on jobs. They change the ledger and wake the supervisor."""

import hashlib
import json
import logging
import threading
import time
from concurrent.futures import wait
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final, NamedTuple

from kernel.numerics.cache import Compilation
from kernel.params import KERNEL_VERSION
from service.errors import IllegalTransition, KeyReused, LedgerUnavailable, QueueFull, UnknownJob
from service.jobs.prepare import JobPreparer, new_job
from service.jobs.supervisor import Supervisor
from service.ledger.ledger import NOT_LOCAL, Ledger
from service.ledger.model import RESUMABLE, UNFINISHED, JobRecord, JobState, NewJob
from service.ledger.paths import network_file_system
from service.ledger.transactions import ReadTransaction, WriteTransaction
from service.settings import Settings
from worker.executors.base import Executor, ExecutorError
from worker.spec.errors import SpecError
from worker.studies import pace_of, renewed, study_of
from worker.study import Cost, Plan
from worker.study.chunks import check_size

log = logging.getLogger(__name__)

#: Seconds for the threads to end: an unresponsive bucket must not delay the exit.
STOP_SECONDS: Final = 4.0
#: Seconds to wait for a worker that tells the pace of a study: the others compute a slice each.
PACE_SECONDS: Final = 2.0
#: Paces that are kept, and requests that wait for one at a time: others keep threads.
PACES, WAITING = 1000, 16


class Submission(NamedTuple):
    """The job of a submitted study; `accepted`: whether the submission created or resumed it."""

    job: JobRecord
    accepted: bool


class JobManager:
    """The jobs of one data folder. Its methods may be called from any thread."""

    def __init__(self, ledger: Ledger, executor: Executor, settings: Settings) -> None:
        self._ledger, self._executor, self._settings = ledger, executor, settings
        self.preparer = JobPreparer(settings)
        self._paces: dict[str, float] = {}  # by job id
        self._waiting = threading.BoundedSemaphore(WAITING)
        self.supervisor = Supervisor(ledger, executor, settings, self.preparer)

    def compiling(self, job: JobRecord) -> Compilation | None:
        """The kernel that a worker compiles for a job at present, or None. Does not block."""
        if job.state is not JobState.RUNNING or job.chunks_done == job.chunks_total:
            return None
        return self._executor.compiling(self._settings.store_of(job.store))

    def start(self) -> None:
        """Continue every job that was queued or running when the service last stopped.

        Jobs of another kernel version end, and new jobs compute their studies anew.
        """
        self._replace_outdated()
        with suppress(LedgerUnavailable):  # then the first request is refused
            self._ledger.check()
        self.supervisor.start()

    def stop(self) -> None:
        """Stop computing; unfinished jobs continue at the next start."""
        self.supervisor.stop(STOP_SECONDS)

    def fault(self) -> str | None:
        """Why jobs are not accepted or computed, as of the last sync; None if nothing is wrong."""
        supervisor, cluster = self.supervisor, self.supervisor.cluster
        idle = cluster.connected and cluster.planned == 0 and not supervisor.remaining_seconds
        return self._ledger.fault() or supervisor.bucket_fault or (None if idle else cluster.fault)

    def notices(self) -> list[str]:
        """What an operator should know, although jobs are computed."""
        notices = []
        if refused := len(self.supervisor.cluster.refused):
            notices.append(f"workers refused: {refused}; the log names them")
        if unknown := len(self.supervisor.unknown_stores or ()):
            notices.append(
                f"stores that the ledger does not know: {unknown}; bounce doctor names them, "
                "bounce adopt takes them in"
            )
        if network := network_file_system(self._settings.data):
            notices.append(f"the data folder is on a network file system ({network}): {NOT_LOCAL}")
        return notices

    def submit(
        self,
        spec: Any,
        key: str | None = None,
        owner: str | None = None,
        *,
        replaces: JobRecord | None = None,
        limited: bool = True,
    ) -> Submission:
        """Accept a study, or return its existing job; a failed or cancelled one is resumed.

        key: an idempotency key; a repeated request with the same key changes nothing, unless the job
        was deleted. owner: name of the caller's access token, if it has one. replaces: an outdated job of the
        same study. Raises SpecTooLarge, KeyReused, and QueueFull if `limited`.
        """
        plan = self.check(spec)
        job = new_job(spec, plan, owner)
        with self._ledger.writing() as ledger:
            new = ledger.find(job.id) is None
            accepted = not self._is_repeated(ledger, job, key) and self._accept(ledger, job, limited)
            record = _existing(ledger, job.id)
            versions = ledger.other_versions() if new else []
            for outdated in [replaces, *(ledger.find(spec.job_id(version)) for version in versions)]:
                if outdated is not None:
                    ledger.update(outdated, replaced_by=job.id)
            if key is not None and ledger.key(key) is None:
                ledger.remember_key(key, _fingerprint(job), record, time.time())
        if accepted:
            self.supervisor.wake()
        return Submission(record, accepted)

    def check(self, spec: Any) -> Plan:
        """The plan of a study. Raises SpecTooLarge if the study would be refused."""
        plan, limits = self.preparer.plan(spec), self._settings
        check_size(
            study_of(spec).estimate(spec, plan),
            max_cells=limits.max_cells,
            max_bytes=limits.max_bytes,
            max_core_seconds=limits.max_core_seconds,
        )
        return plan

    def is_done(self, spec: Any) -> bool:
        """Whether the study's job is done."""
        job = self._ledger.find(spec.job_id(KERNEL_VERSION))
        return job is not None and job.state is JobState.DONE

    def took(self, spec: Any) -> float:
        """The time that a study's job took, as on the present workers; 0 if that is not known."""
        job = self._ledger.find(spec.job_id(KERNEL_VERSION))
        return job.core_seconds / max(min(self.workers(), job.chunks_total), 1) if job else 0.0

    def cost(self, spec: Any) -> Cost:
        """The estimated cost of a study on the present workers. Raises SpecTooLarge as `submit`."""
        cost = study_of(spec).estimate(spec, self.check(spec)).at(self.pace(spec))
        return cost.model_copy(update={"workers": self.workers()})

    def pace(self, spec: Any) -> float | None:
        """The pace of a study (`worker.pace`) on a worker.

        None if none tells it within PACE_SECONDS, or if WAITING others wait. It is kept, so that a repeated
        request for a plan is the same.
        """
        key = spec.job_id(KERNEL_VERSION)
        if key in self._paces or self.workers() == 0:
            return self._paces.get(key)
        if not self._waiting.acquire(blocking=False):
            return None
        try:
            answer = self._executor.call(pace_of, spec)
            if not wait([answer], PACE_SECONDS).done:
                answer.cancel()
                return None
        except ExecutorError:
            return None
        finally:
            self._waiting.release()
        pace = None if answer.cancelled() or answer.exception() else answer.result()
        if pace is not None:
            if len(self._paces) >= PACES:
                self._paces.clear()
            self._paces[key] = pace
        return pace

    def seconds(self, spec: Any) -> float:
        """The expected time of a study on the present workers, by the table of costs. Raises as `cost`."""
        return study_of(spec).estimate(spec, self.check(spec)).seconds_on(self.workers())

    def workers(self) -> int:
        """The number of tasks that can run at once; may be a second old."""
        return self._executor.state().workers

    def cancel(self, job_id: str) -> JobRecord:
        """Stop a job: a queued one at once, a running one as soon as workers have stopped writing.

        Cancelling a cancelled job changes nothing. Raises UnknownJob, and IllegalTransition if the job is
        done or failed.
        """
        with self._ledger.writing() as ledger:
            job = _existing(ledger, job_id)
            if job.state is JobState.QUEUED:
                ledger.finish(job, JobState.CANCELLED, time.time())
            elif job.state is JobState.RUNNING:
                ledger.update(job, cancel_requested=True)
            elif job.state is not JobState.CANCELLED:
                rule = "only a queued or running job can be cancelled"
                successor = "" if job.replaced_by is None else f"; job {job.replaced_by} computes it anew"
                raise IllegalTransition(f"the job is {job.state}: {rule}{successor}")
            record = _existing(ledger, job_id)
        self.supervisor.wake()
        return record

    def resume(self, job_id: str, owner: str | None = None) -> Submission:
        """Continue a failed or cancelled job where it stopped; an unfinished one stays as it is.

        A job of another kernel version starts anew as another job, which is returned. Raises UnknownJob,
        QueueFull, and IllegalTransition if the job is done; for a new job also as `submit`, and SpecError if
        this release refuses the specification.
        """
        with self._ledger.reading() as reading:
            job = _existing(reading, job_id)
        if job.state is JobState.DONE:
            again = ": submit the sweep again to compute it anew" if job.outdated else ""
            raise IllegalTransition(f"the job is done: there is nothing to resume{again}")
        if job.outdated:
            return self.submit(renewed(json.dumps(job.named_spec)), owner=owner, replaces=job)
        with self._ledger.writing() as ledger:
            accepted = self._accept(ledger, replace(job, owner=owner))
            record = _existing(ledger, job_id)
        if accepted:
            self.supervisor.wake()
        return Submission(record, accepted)

    def label(self, job_id: str, **labels: str | bool) -> JobRecord:
        """Set a job's `name`, or whether it is `pinned`, no parts of its identity. Raises UnknownJob."""
        with self._ledger.writing() as ledger:
            ledger.update(_existing(ledger, job_id), **labels)
            return _existing(ledger, job_id)

    def delete(self, job_id: str) -> None:
        """Remove a job; its results are removed in the background, at the latest after the next start.

        Raises UnknownJob, and IllegalTransition while workers may write: cancel the job first.
        """
        with self._ledger.writing() as ledger:
            job = _existing(ledger, job_id)
            if job.state in UNFINISHED:
                raise IllegalTransition(
                    f"the job is {job.state}: cancel it first, and wait until it is cancelled"
                )
            ledger.delete(job)
        self.supervisor.wake()

    def _replace_outdated(self) -> None:
        """End the unfinished jobs of other kernel versions. Accept their studies anew unless cancelled."""
        with self._ledger.reading() as reading:
            outdated = reading.outdated_unfinished()
        for job in outdated:
            state, reason = JobState.CANCELLED, None
            if not job.cancel_requested:
                try:
                    spec = renewed(json.dumps(job.named_spec))
                    successor, _ = self.submit(spec, owner=job.owner, replaces=job, limited=False)
                    fate = f"job {successor.id} computes all of it anew"
                except SpecError as error:
                    fate = f"it cannot start anew: {error}"
                versions = f"{job.kernel_version} began it, this release computes {KERNEL_VERSION}"
                state, reason = JobState.FAILED, f"kernel version {versions}: {fate}"
                log.warning("job %s ends: %s", job.id, reason)
            with self._ledger.writing() as ledger:
                ledger.finish(job, state, time.time(), reason)

    def _is_repeated(self, ledger: WriteTransaction, job: NewJob, key: str | None) -> bool:
        ledger.forget_keys(time.time() - self._settings.key_seconds)
        used = ledger.key(key) if key is not None else None
        if used not in (None, _fingerprint(job)):
            raise KeyReused(
                "the Idempotency-Key was used for another specification less than "
                f"{self._settings.key_seconds:g} s ago: take a new key"
            )
        return used is not None

    def _accept(self, ledger: WriteTransaction, job: NewJob, limited: bool = True) -> bool:
        """Insert or resume a job, or revoke its cancel; whether anything changed. Raises QueueFull."""
        existing = ledger.find(job.id)
        if limited and (existing is None or existing.state in RESUMABLE):
            all_jobs, limit = ledger.count(UNFINISHED), self._settings.max_queue
            if all_jobs >= limit:
                raise QueueFull(f"{all_jobs} jobs are queued or running already, at most {limit} may be")
            own = 0 if job.owner is None else ledger.count(UNFINISHED, job.owner)
            if own >= (limit := self._settings.max_queue_per_token):
                raise QueueFull(
                    f"{own} jobs of the token {job.owner} are queued or running already, "
                    f"at most {limit} of one token may be (max_queue_per_token)"
                )
        if existing is None:
            ledger.insert(job, time.time())
        elif existing.state in RESUMABLE:
            ledger.queue(existing, job.owner)
        elif existing.cancel_requested:
            ledger.update(existing, cancel_requested=False)
        else:
            return False
        return True


def _existing(ledger: ReadTransaction, job_id: str) -> JobRecord:
    if (job := ledger.find(job_id)) is None:
        raise UnknownJob.of(job_id)
    return job


def _fingerprint(job: NewJob) -> str:
    """Digest of a submission with its name, independent of the layout of its JSON."""
    return hashlib.sha256(job.spec.encode()).hexdigest()
