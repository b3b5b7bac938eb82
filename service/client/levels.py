"""The levels of a budget at a service: plain jobs, one after another."""

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from service.client.display import display_line
from service.client.errors import Busy, InvalidSpecification, NotComputedYet, WaitTimeout
from service.client.specification import Specification, body

if TYPE_CHECKING:
    from service.client.job import Job
    from service.client.models import Estimate


class Levels:
    """Computes levels as jobs; `job` is the last one that is done."""

    def __init__(
        self, submit: "Callable[[Any], Job]", estimate: "Callable[[Any], Estimate]", progress: bool
    ) -> None:
        self._submit, self._estimate, self._progress = submit, estimate, progress
        self.job: Job | None = None

    def within(self, spec: Specification, budget: float) -> "Job":
        """The job of the finest level that fits. Raises InvalidSpecification."""
        from service.budget import check, within
        from worker.spec.axes import kind_of
        from worker.spec.errors import SpecInvalid
        from worker.sweep import SweepSpec

        try:
            fields = json.loads(body(spec))
            check(kind_of(fields.get("protocol")), budget)
            whole = SweepSpec.parse(fields)
            within(whole, budget, self, display_line if self._progress else lambda _: None)
        except SpecInvalid as error:
            raise InvalidSpecification.before_sending(str(error)) from error
        assert self.job is not None
        return self.job

    def seconds(self, spec: Any) -> float:
        estimate = self._estimate(spec)
        return estimate.core_seconds / max(estimate.workers, 1)

    def compute(self, spec: Any, seconds: float) -> bool:
        job = self._submit(spec)
        others = job._retry_after is None  # not accepted now, but before
        try:
            self.job = job.wait(self._progress, timeout=seconds)
        except WaitTimeout:
            if not others:
                job.cancel()
            return False
        return True

    def audit(self, spec: Any, seconds: float) -> str | None:
        assert self.job is not None
        try:
            return str(self.job.audit(timeout=seconds, progress=self._progress).attrs["sentence"])
        except (NotComputedYet, Busy):
            return None
