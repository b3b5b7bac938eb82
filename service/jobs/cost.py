"""The estimated cost of a sweep, before it is computed.

Core-seconds come from the speed of recent jobs with the same contact model, relative to the cost table, or
from the table alone if there are none.
"""

from collections.abc import Sequence
from typing import Any, Final

from service.jobs.model import JobRecord
from service.jobs.prepare import JobPreparer
from worker.cost import Cost
from worker.spec.errors import SpecError
from worker.studies import Plan, Study, study_of

#: Number of recent jobs whose speed counts, and maximum characters of their specifications.
RECENT_JOBS: Final = 20
MAX_SPEC_CHARS: Final = 20_000

#: Minimum core-seconds that measure a contact model: in less, starting up dominates.
MIN_SECONDS: Final = 0.05


def cost(spec: Any, plan: Plan, measured: Sequence[JobRecord], preparer: JobPreparer) -> Cost:
    """The cost of a study, from the speed of these jobs."""
    by_table = study_of(spec).estimate(spec, plan)
    taken = expected = 0.0
    for job in measured:
        try:
            other = preparer.prepare(job)
        except SpecError:  # an older version accepted it
            continue
        # An adaptive map's done cells are not all computed: they do not show the speed.
        if _kind(other.submitted) == _kind(spec) and getattr(other.submitted, "refine", None) is None:
            taken += job.core_seconds
            other_table = other.study.estimate(other.submitted, other.plan)
            expected += job.cells_timed * other_table.core_seconds / other_table.cells
    if min(taken, expected) < MIN_SECONDS:
        return by_table
    scaled = {
        name: seconds * taken / expected
        for name in ("core_seconds", "least_core_seconds", "longest_core_seconds")
        if (seconds := getattr(by_table, name)) is not None
    }
    return by_table.model_copy(update={**scaled, "basis": "measured"})


def _kind(spec: Any) -> tuple[Study, str | None]:
    """The kinds with separate speeds: a kind of study, and its contact model if it has one."""
    return study_of(spec), getattr(getattr(spec, "model", None), "kind", None)
