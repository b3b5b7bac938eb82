"""The estimated cost of a sweep, before anything of it is computed.

Core-seconds come from the speed measured here: what the done chunks of recent jobs with the same contact
model took, relative to the cost table. Where there are none, from the table alone.
"""

from collections.abc import Sequence
from typing import Final

from service.jobs.prepare import JobPreparer
from service.jobs.transactions import Pace
from worker.cost import Cost, cell_seconds, estimate
from worker.plan import make_plan
from worker.spec import SweepSpec
from worker.spec.errors import SpecError

#: The recent jobs whose speed counts, and the longest specification parsed for it.
RECENT_JOBS: Final = 20
MAX_SPEC_CHARS: Final = 20_000

#: Core-seconds of a contact model that make a measurement: of less, starting up is the larger part.
MIN_SECONDS: Final = 0.05


def cost(spec: SweepSpec, paces: Sequence[Pace], preparer: JobPreparer) -> Cost:
    """The cost of a sweep, by the speed of the jobs in `paces`."""
    by_table = estimate(spec, len(make_plan(spec)))
    ratio = _measured_to_table(spec.model.kind, paces, preparer)
    if ratio is None:
        return by_table
    return by_table.model_copy(update={"core_seconds": by_table.core_seconds * ratio, "basis": "measured"})


def _measured_to_table(kind: str, paces: Sequence[Pace], preparer: JobPreparer) -> float | None:
    """Seconds taken over seconds by the table; None where too little of the model has been computed."""
    taken = expected = 0.0
    for pace in paces:
        try:
            spec = preparer.prepare(pace.job).submitted
        except SpecError:  # an older version accepted it
            continue
        if spec.model.kind == kind:
            taken += pace.seconds
            expected += pace.cells * cell_seconds(spec)
    return taken / expected if min(taken, expected) >= MIN_SECONDS else None
