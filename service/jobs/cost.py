"""What a sweep will cost before anything of it is computed.

Core-seconds come from the speed measured here: what the finished chunks of the last jobs with the same
contact model took, compared with the plan's cost table. Before there are any, from that table alone.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

from service.jobs.ledger import Pace
from worker.cost import Cost, cell_seconds, estimate
from worker.plan import make_plan
from worker.spec import SweepSpec
from worker.spec.errors import SpecError

#: The finished jobs whose speed counts, and the longest specification read for it.
RECENT_JOBS: Final = 20
LONGEST_SPEC: Final = 20_000

#: Fewer core-seconds of the kind than this say nothing: starting up is most of them.
LEAST_SECONDS: Final = 0.05


def cost(spec: SweepSpec, paces: Sequence[Pace]) -> Cost:
    """The cost of a sweep, by the speed of jobs before it."""
    found = estimate(spec, len(make_plan(spec)))
    ratio = _against_table(spec.model.kind, paces)
    if ratio is None:
        return found
    return found.model_copy(update={"core_seconds": found.core_seconds * ratio, "basis": "measured"})


def _against_table(kind: str, paces: Sequence[Pace]) -> float | None:
    """Seconds taken over seconds expected; None where nothing of the kind has been computed."""
    taken = expected = 0.0
    for pace in paces:
        known = _kind_and_cost(pace.spec)
        if known is not None and known[0] == kind:
            taken += pace.seconds
            expected += pace.cells * known[1]
    return taken / expected if min(taken, expected) >= LEAST_SECONDS else None


@lru_cache(maxsize=4 * RECENT_JOBS)
def _kind_and_cost(text: str) -> tuple[str, float] | None:
    """A specification's contact model and the table's seconds for one cell."""
    try:
        spec = SweepSpec.from_json(text)
    except SpecError:  # an older version accepted it
        return None
    return spec.model.kind, cell_seconds(spec)
