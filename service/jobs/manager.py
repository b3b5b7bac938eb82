"""What people ask of jobs: submit, cancel, resume, delete. Changes the ledger, rings for the supervisor."""

import hashlib
import json
import logging
import threading
import time
from typing import Final, NamedTuple

from kernel.params import KERNEL_VERSION
from service.errors import IllegalTransition, KeyReused, QueueFull, UnknownJob
from service.jobs.ledger import Ledger, WriteTransaction
from service.jobs.model import RESUMABLE, UNFINISHED, JobRecord, JobState, NewJob
from service.jobs.repair import Repairer
from service.jobs.scrub import Scrubber
from service.jobs.supervisor import Supervisor
from service.settings import Settings
from worker import store
from worker.cost import check_size, estimate
from worker.executors.base import Executor
from worker.plan import make_plan
from worker.spec import SweepSpec

log = logging.getLogger(__name__)

#: A bucket that does not answer may hold up the end, but not for longer.
STOP_SECONDS: Final = 4.0


class Submission(NamedTuple):
    """What became of a submitted sweep; `accepted`: there is something to compute that was not asked for."""

    job: JobRecord
    accepted: bool


class JobManager:
    """The jobs of one data folder. Its methods may be called from any thread."""

    def __init__(self, ledger: Ledger, executor: Executor, settings: Settings) -> None:
        self._ledger, self._settings = ledger, settings
        self._turn = threading.Lock()  # a sweep is not accepted again while its results are being deleted
        self._places = threading.Lock()  # no store is made while results are taken away
        self._supervisor = Supervisor(ledger, executor, settings, self._is_clear, self._places)
        self.repairer = Repairer(ledger, settings, self._supervisor.invalidated)
        self._scrubber = Scrubber(ledger, settings, self.repairer, self._supervisor.wake)

    def start(self) -> None:
        """Go on with every job that was queued or running when the service last stopped."""
        self._scrubber.start()
        self._supervisor.start()

    def stop(self) -> None:
        """Stop computing; unfinished jobs go on at the next start."""
        give_up = time.monotonic() + STOP_SECONDS
        self._scrubber.stop(STOP_SECONDS)
        self._supervisor.stop(max(give_up - time.monotonic(), 0.1))

    def _is_clear(self, job_id: str) -> bool:
        return self._scrubber.is_clear(job_id)

    def submit(self, spec: SweepSpec, key: str | None = None) -> Submission:
        """Accept a sweep, or find the job that it is already; one that failed or was cancelled goes on.

        A request repeated under an idempotency key changes nothing, whatever became of the job since.
        Raises SpecTooLarge, QueueFull, KeyReused.
        """
        self.check(spec)
        job = _new_job(spec)
        with self._turn, self._ledger.writing() as ledger:
            accepted = not self._repeats(ledger, job, key) and self._accept(ledger, job)
            record = _found(ledger.find(job.id), job.id)
            if key is not None and ledger.key(key) is None:
                ledger.remember_key(key, _fingerprint(job), record, time.time())
        if accepted:
            self._ledger.keep_reserve()
            self._supervisor.wake()
        return Submission(record, accepted)

    def check(self, spec: SweepSpec) -> None:
        """Raise SpecTooLarge for a sweep that would not be accepted."""
        check_size(
            estimate(spec, len(make_plan(spec))),
            max_cells=self._settings.max_cells,
            max_bytes=self._settings.max_bytes,
        )

    def cancel(self, job_id: str) -> JobRecord:
        """Stop a job: at once if it is queued, as soon as nothing writes any more if it is running.

        Cancelling twice is once. Raises UnknownJob, and IllegalTransition if it is done or failed.
        """
        with self._ledger.writing() as ledger:
            _cancel(ledger, _found(ledger.find(job_id), job_id))
            record = _found(ledger.find(job_id), job_id)
        self._supervisor.wake()
        return record

    def resume(self, job_id: str) -> Submission:
        """Let a job that failed or was cancelled go on where it stopped; one in work stays as it is.

        Raises UnknownJob, QueueFull, and IllegalTransition if it is done.
        """
        with self._ledger.writing() as ledger:
            job = _found(ledger.find(job_id), job_id)
            if job.state is JobState.DONE:
                raise IllegalTransition("the job is done: there is nothing to resume")
            accepted = self._accept(ledger, job)
            record = _found(ledger.find(job_id), job_id)
        if accepted:
            self._ledger.keep_reserve()
            self._supervisor.wake()
        return Submission(record, accepted)

    def delete(self, job_id: str) -> None:
        """Forget a job and remove what it computed; large results go on vanishing for a while.

        Raises UnknownJob, and IllegalTransition while workers may write: cancel it first.
        """
        with self._turn, self._places:
            doomed = self._forget(job_id)
        threading.Thread(target=_remove, args=[doomed], name="remove", daemon=True).start()

    def _forget(self, job_id: str) -> str:
        """Take a job out of the ledger and its results out of sight; gives where they are now."""
        with self._ledger.writing() as ledger:
            job = _found(ledger.find(job_id), job_id)
            if job.state in UNFINISHED:
                raise IllegalTransition(f"the job is {job.state}: cancel it first, and wait until it is")
            ledger.delete(job)
        # A worker that was lost sight of may still compute: the mark stops it, and without its
        # description the store takes nothing any more.
        url = self._settings.store_of(job_id)
        store.set_cancelled(url)
        return store.rename_for_deletion(url)

    def _repeats(self, ledger: WriteTransaction, job: NewJob, key: str | None) -> bool:
        """Whether this very request was made before under this key."""
        ledger.forget_keys(time.time() - self._settings.key_seconds)
        known = ledger.key(key) if key is not None else None
        if known is not None and known.body != _fingerprint(job):
            raise KeyReused(
                "the Idempotency-Key was used for another specification less than "
                f"{self._settings.key_seconds:g} s ago: take a new key"
            )
        return known is not None

    def _accept(self, ledger: WriteTransaction, job: NewJob) -> bool:
        known = ledger.find(job.id)
        if known is None:
            self._check_queue(ledger)
            ledger.insert(job, time.time())
        elif known.state in RESUMABLE:
            self._check_queue(ledger)
            ledger.queue(known)
        elif known.cancel_requested:
            ledger.request_cancel(known, wanted=False)
        else:
            return False
        return True

    def _check_queue(self, ledger: WriteTransaction) -> None:
        waiting = ledger.count(UNFINISHED)
        if waiting >= self._settings.max_queue:
            most = self._settings.max_queue
            raise QueueFull(f"{waiting} jobs are queued or running already, at most {most} may be")


def _remove(url: str) -> None:
    """Remove what a deleted job leaves; what cannot be is swept at the next start."""
    try:
        store.remove(url)
    except Exception as error:  # noqa: BLE001 - a bucket out of reach, a folder gone already
        log.warning("%s cannot be removed now: %s", url, error)


def _cancel(ledger: WriteTransaction, job: JobRecord) -> None:
    if job.state is JobState.QUEUED:
        ledger.finish(job, JobState.CANCELLED, time.time())
    elif job.state is JobState.RUNNING:
        ledger.request_cancel(job, wanted=True)
    elif job.state is not JobState.CANCELLED:
        raise IllegalTransition(f"the job is {job.state}: only a queued or running job can be cancelled")


def _found(job: JobRecord | None, job_id: str) -> JobRecord:
    if job is None:
        raise UnknownJob.of(job_id)
    return job


def _fingerprint(job: NewJob) -> str:
    """Of what was submitted, its label too, and not of how the JSON was laid out."""
    return hashlib.sha256(job.spec.encode()).hexdigest()


def _new_job(spec: SweepSpec) -> NewJob:
    plan = make_plan(spec)
    return NewJob(
        id=spec.job_id(KERNEL_VERSION),
        name=spec.name,
        spec=json.dumps(spec.as_submitted()),
        kernel_version=KERNEL_VERSION,
        chunk_shape=plan.chunk_shape,
        chunks_total=len(plan),
        cells_total=plan.cells,
    )
