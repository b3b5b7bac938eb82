"""The estimated cost of a sweep, before it is computed.

Core-seconds come from the speed of recent jobs with the same contact model, relative to the cost table, or
from the table alone if there are none.
"""

from collections.abc import Sequence
from typing import Any, Final

from service.jobs.prepare import JobPreparer
from service.jobs.transactions import Pace
from worker.cost import Cost
from worker.spec.errors import SpecError
from worker.studies import Plan, study_of
from worker.tasks import Study

#: Number of recent jobs whose speed counts, and maximum characters of their specifications.
RECENT_JOBS: Final = 20
MAX_SPEC_CHARS: Final = 20_000

#: Minimum core-seconds that measure a contact model: in less, starting up dominates.
MIN_SECONDS: Final = 0.05


def cost(spec: Any, plan: Plan, paces: Sequence[Pace], preparer: JobPreparer) -> Cost:
    """The cost of a study, from the speed of the jobs in `paces`."""
    by_table = study_of(spec).estimate(spec, plan)
    ratio = _measured_to_table(_kind(spec), paces, preparer)
    if ratio is None:
        return by_table
    measured = {
        name: seconds * ratio
        for name in ("core_seconds", "least_core_seconds", "longest_core_seconds")
        if (seconds := getattr(by_table, name)) is not None
    }
    return by_table.model_copy(update={**measured, "basis": "measured"})


def _kind(spec: Any) -> tuple[Study, str | None]:
    """The kinds with separate speeds: a kind of study, and its contact model if it has one."""
    return study_of(spec), getattr(getattr(spec, "model", None), "kind", None)


def _measured_to_table(
    kind: tuple[Study, str | None], paces: Sequence[Pace], preparer: JobPreparer
) -> float | None:
    """Measured seconds over those of the table; None if too little of the kind has been computed."""
    taken = expected = 0.0
    for pace in paces:
        try:
            job = preparer.prepare(pace.job)
        except SpecError:  # an older version accepted it
            continue
        # An adaptive map's done cells are not all computed: they do not show the speed.
        if _kind(job.submitted) == kind and getattr(job.submitted, "refine", None) is None:
            taken += pace.seconds
            by_table = job.study.estimate(job.submitted, job.plan)
            expected += pace.cells * by_table.core_seconds / by_table.cells
    return taken / expected if min(taken, expected) >= MIN_SECONDS else None
