"""Metrics for Prometheus."""

from collections.abc import Iterator, Mapping
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector
from prometheus_client.core import GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.registry import Collector

from service.jobs.manager import JobManager
from service.ledger.ledger import Ledger
from service.ledger.model import JobState
from service.software import software

#: Methods with their own label; the rest share one, so that callers cannot create labels.
_METHODS: Final = frozenset({"GET", "HEAD", "POST", "DELETE", "OPTIONS", "PUT", "PATCH"})


class Metrics:
    """Metrics of one service, in their own registry."""

    def __init__(self) -> None:
        registry = self.registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        labels = ["method", "route", "status"]
        self._requests = Counter("bounce_http_requests", "HTTP requests.", labels, registry=registry)
        meaning = "Seconds until the response was sent."
        self._seconds = Histogram("bounce_http_request_seconds", meaning, ["route"], registry=registry)

    def count_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request; `route` is the path's template, so that job ids do not become labels."""
        self._requests.labels(method if method in _METHODS else "other", route, str(status)).inc()
        self._seconds.labels(route).observe(seconds)


class JobsCollector(Collector):
    """Reads ledger and manager whenever metrics are collected."""

    def __init__(self, ledger: Ledger, manager: JobManager) -> None:
        self._ledger, self._manager = ledger, manager

    def collect(self) -> Iterator[Metric]:
        with self._ledger.reading() as ledger:
            jobs = {str(state): ledger.count((state,)) for state in JobState}
            chunks, cells = ledger.totals()
        supervisor = self._manager.supervisor
        cluster, in_flight = supervisor.cluster, supervisor.in_flight()
        yield _by_state("bounce_jobs", "Jobs in the ledger.", jobs)
        for name, meaning, value in (
            ("bounce_chunks_done", "Chunks marked done, of jobs in the ledger.", chunks),
            ("bounce_cells_done", "Cells marked done, of jobs in the ledger.", cells),
            ("bounce_ready", "Whether jobs are accepted and computed.", self._manager.fault() is None),
            ("bounce_chunks_in_flight", "Chunks that workers compute, or that wait for one.", in_flight),
            (
                "bounce_core_seconds_remaining",
                "Core-seconds that the unfinished jobs will take, by the cost table.",
                supervisor.remaining_seconds,
            ),
        ):
            yield GaugeMetricFamily(name, meaning, value)
        numbers = {"computing": cluster.workers, "refused": len(cluster.refused), "planned": cluster.planned}
        yield _by_state("bounce_workers", "Workers that compute, are planned, or are refused.", numbers)
        versions = {"version": software().release, "kernel_version": software().kernel_version}
        yield InfoMetricFamily("bounce_build", "What this service is.", versions)


def _by_state(name: str, meaning: str, numbers: Mapping[str, float | None]) -> Metric:
    """A gauge with a value for each state whose number is known."""
    gauge = GaugeMetricFamily(name, meaning, labels=["state"])
    for state, number in numbers.items():
        if number is not None:
            gauge.add_metric([state], number)
    return gauge
