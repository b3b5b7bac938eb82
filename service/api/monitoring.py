"""What operators monitor: readiness, and metrics for Prometheus."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from service.jobs.ledger import Ledger
from service.jobs.model import JobState
from worker.executors.base import Executor

#: Methods with a label of their own; the rest share one, so that callers cannot create labels.
_METHODS: Final = frozenset({"GET", "HEAD", "POST", "DELETE", "OPTIONS", "PUT", "PATCH"})


class Readiness:
    """Whether the ledger can be used and the scheduler answers; thread-safe.

    Caches the executor's answer for `max_age` seconds. `ledger_fault` says why the ledger cannot be used.
    """

    def __init__(
        self,
        executor: Executor,
        max_age: float = 1.0,
        ledger_fault: Callable[[], str | None] = lambda: None,
    ) -> None:
        self._executor, self._max_age, self._ledger_fault = executor, max_age, ledger_fault
        self._lock = threading.Lock()
        self._checked = float("-inf")
        self._ready = False

    def fault(self) -> str | None:
        """Why no jobs are accepted or computed; None if they are."""
        if (fault := self._ledger_fault()) is not None:
            return fault
        return None if self._answers() else "the Dask scheduler does not answer; jobs wait until it does"

    def ready(self) -> bool:
        """Whether jobs are accepted and computed."""
        return self.fault() is None

    def _answers(self) -> bool:
        """Whether the executor could compute at most `max_age` seconds ago."""
        with self._lock:
            if time.monotonic() - self._checked > self._max_age:
                self._ready = self._executor.ready()
                self._checked = time.monotonic()
            return self._ready


class Metrics:
    """Metrics of one service, in a registry of their own."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        self._requests = Counter(
            "bounce_http_requests",
            "HTTP requests.",
            ["method", "route", "status"],
            registry=self._registry,
        )
        self._seconds = Histogram(
            "bounce_http_request_seconds",
            "Seconds until the response was sent.",
            ["route"],
            registry=self._registry,
        )

    def add_jobs(self, ledger: Ledger, readiness: Readiness) -> None:
        """Report the ledger's jobs and the scheduler's readiness too."""
        self._registry.register(_JobsCollector(ledger, readiness))

    def count_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request; `route` is the path's template, so that job ids do not become labels."""
        self._requests.labels(method if method in _METHODS else "other", route, str(status)).inc()
        self._seconds.labels(route).observe(seconds)

    def text(self) -> bytes:
        """All metrics in Prometheus's text format."""
        return generate_latest(self._registry)


class _JobsCollector(Collector):
    """Reads the ledger and the readiness whenever metrics are collected."""

    def __init__(self, ledger: Ledger, readiness: Readiness) -> None:
        self._ledger, self._readiness = ledger, readiness

    def collect(self) -> Iterator[Metric]:
        jobs = GaugeMetricFamily("bounce_jobs", "Jobs in the ledger.", labels=["state"])
        with self._ledger.reading() as ledger:
            for state in JobState:
                jobs.add_metric([state], ledger.count((state,)))
            chunks, cells = ledger.totals()
        yield jobs
        yield GaugeMetricFamily("bounce_chunks_done", "Chunks marked done, of jobs in the ledger.", chunks)
        yield GaugeMetricFamily("bounce_cells_done", "Cells marked done, of jobs in the ledger.", cells)
        yield GaugeMetricFamily(
            "bounce_ready", "Whether jobs are accepted and computed.", self._readiness.ready()
        )

    def describe(self) -> list[Metric]:
        return []
