"""A job made ready to run: its store laid out, its workers' cancel mark gone, what is done counted."""

from kernel.params import KERNEL_VERSION
from service.jobs.ledger import Ledger
from service.jobs.model import JobRecord
from service.jobs.model_selection import attributes_of, computed_spec
from service.jobs.run import JobRun
from service.settings import Settings
from worker import store
from worker.plan import make_plan
from worker.schema import layout
from worker.spec import SweepSpec


class KernelChanged(Exception):
    """A job was begun by a kernel whose numbers may differ."""


def opened(job: JobRecord, ledger: Ledger, settings: Settings) -> JobRun:
    """The run of a job whose model is decided, with nothing in flight.

    Raises KernelChanged, a StoreError, an OSError, or one of `store.UNREACHABLE`.
    """
    if job.kernel_version != KERNEL_VERSION:
        raise KernelChanged(
            f"kernel {job.kernel_version} began it, this is {KERNEL_VERSION}: submit it again"
        )
    spec = SweepSpec.from_json(job.spec)
    plan = make_plan(spec, chunk_shape=job.chunk_shape)
    url = settings.store_of(job.id)
    store.create(url, layout(spec, plan.chunk_shape), attributes_of(job))
    store.clear_cancelled(url)
    run = JobRun(job, computed_spec(job), plan, url, ledger.done_mask(job))
    run.stopping = job.cancel_requested  # the service stopped before the job could
    return run
