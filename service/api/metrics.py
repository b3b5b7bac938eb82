"""Figures for Prometheus: requests as they were answered, jobs and workers as they are when asked."""

from collections.abc import Iterator
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from service.api.readiness import Health
from service.jobs.ledger import Ledger
from service.jobs.model import JobState

METHODS: Final = frozenset({"GET", "HEAD", "POST", "DELETE", "OPTIONS", "PUT", "PATCH"})


class Metrics:
    """One service's figures, in a registry of their own."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        self._requests = Counter(
            "bounce_http_requests",
            "Requests answered.",
            ["method", "route", "status"],
            registry=self._registry,
        )
        self._seconds = Histogram(
            "bounce_http_request_seconds", "Until the answer was sent.", ["route"], registry=self._registry
        )

    def watch(self, ledger: Ledger, health: Health) -> None:
        """Tell of the jobs and the workers too."""
        self._registry.register(_Jobs(ledger, health))

    def answered(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request; `route` is the path's pattern, so that ids make no series of their own."""
        self._requests.labels(method if method in METHODS else "other", route, str(status)).inc()
        self._seconds.labels(route).observe(seconds)

    def text(self) -> bytes:
        """All figures in Prometheus's text form."""
        return generate_latest(self._registry)


class _Jobs(Collector):
    """What the ledger and the executor say at the moment."""

    def __init__(self, ledger: Ledger, health: Health) -> None:
        self._ledger, self._health = ledger, health

    def collect(self) -> Iterator[Metric]:
        jobs = GaugeMetricFamily("bounce_jobs", "Jobs in the ledger.", labels=["state"])
        with self._ledger.reading() as ledger:
            for state in JobState:
                jobs.add_metric([state], ledger.count((state,)))
            chunks, cells = ledger.totals()
        yield jobs
        yield GaugeMetricFamily("bounce_chunks_done", "Chunks marked done, of jobs in the ledger.", chunks)
        yield GaugeMetricFamily("bounce_cells_done", "Cells marked done, of jobs in the ledger.", cells)
        yield GaugeMetricFamily("bounce_ready", "Whether the scheduler answers.", self._health.ready())

    def describe(self) -> list[Metric]:
        return []
