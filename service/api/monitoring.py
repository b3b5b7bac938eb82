"""Metrics for Prometheus."""

import math
from collections.abc import Iterable, Iterator
from typing import Final, TypeVar

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from service.jobs.manager import JobManager
from service.ledger.ledger import Ledger
from service.ledger.model import JobState
from service.software import software

Family = TypeVar("Family", CounterMetricFamily, GaugeMetricFamily)

#: Methods with their own label; the rest share one, so that callers cannot create labels.
_METHODS: Final = frozenset({"GET", "HEAD", "POST", "DELETE", "OPTIONS", "PUT", "PATCH"})


class Metrics:
    """Metrics of one service, in their own registry."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        self._requests = Counter(
            "bounce_http_requests",
            "HTTP requests.",
            ["method", "route", "status"],
            registry=self.registry,
        )
        self._seconds = Histogram(
            "bounce_http_request_seconds",
            "Seconds until the response was sent.",
            ["route"],
            registry=self.registry,
        )

    def count_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request; `route` is the path's template, so that job ids do not become labels."""
        self._requests.labels(method if method in _METHODS else "other", route, str(status)).inc()
        self._seconds.labels(route).observe(seconds)

    def text(self) -> bytes:
        """All metrics in Prometheus's text format."""
        return generate_latest(self.registry)


class JobsCollector(Collector):
    """Reads ledger and manager whenever metrics are collected."""

    def __init__(self, ledger: Ledger, manager: JobManager) -> None:
        self._ledger, self._manager = ledger, manager

    def collect(self) -> Iterator[Metric]:
        with self._ledger.reading() as ledger:
            jobs = [([state], ledger.count((state,))) for state in JobState]
            chunks, cells = ledger.totals()
        supervisor = self._manager.supervisor
        tally, cluster = supervisor.tally, supervisor.cluster
        yield _labelled(GaugeMetricFamily("bounce_jobs", "Jobs in the ledger.", labels=["state"]), jobs)
        for name, meaning, value in (
            ("bounce_chunks_done", "Chunks marked done, of jobs in the ledger.", chunks),
            ("bounce_cells_done", "Cells marked done, of jobs in the ledger.", cells),
            ("bounce_ready", "Whether jobs are accepted and computed.", self._manager.fault() is None),
            (
                "bounce_chunks_in_flight",
                "Chunks that workers compute, or that wait for one.",
                supervisor.in_flight(),
            ),
            (
                "bounce_core_seconds_remaining",
                "Core-seconds that the unfinished jobs will take, by the cost table.",
                supervisor.remaining_seconds,
            ),
        ):
            yield GaugeMetricFamily(name, meaning, value)
        for name, meaning, value in (
            ("bounce_chunks_computed", "Chunks computed since the start.", tally.computed),
            ("bounce_chunk_seconds", "Seconds of workers for the chunks computed.", tally.seconds),
            ("bounce_chunks_damaged", "Stored chunks found damaged since the start.", tally.damaged),
        ):
            yield CounterMetricFamily(name, meaning, value)
        meaning = "Chunks that came back without a result, by action and kind of error."
        returned = CounterMetricFamily("bounce_chunks_returned", meaning, labels=["action", "error"])
        yield _labelled(returned, tally.returned.items())
        buckets = [
            ("+Inf" if limit == math.inf else f"{limit:g}", float(number))
            for limit, number in tally.by_seconds
        ]
        meaning = "Seconds of workers for each chunk computed since the start."
        yield HistogramMetricFamily("bounce_chunk_duration_seconds", meaning, buckets, tally.seconds)
        numbers = {"computing": cluster.workers, "refused": len(cluster.refused), "planned": cluster.planned}
        meaning = "Workers that compute, are planned, or are refused."
        workers = GaugeMetricFamily("bounce_workers", meaning, labels=["state"])
        yield _labelled(workers, (([state], n) for state, n in numbers.items() if n is not None))
        versions = {"version": software().release, "kernel_version": software().kernel_version}
        yield InfoMetricFamily("bounce_build", "What this service is.", versions)


def _labelled(family: Family, values: Iterable[tuple[Iterable[str], float]]) -> Family:
    for labels, value in values:
        family.add_metric(list(labels), value)
    return family
