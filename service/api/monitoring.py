"""Monitoring for operators: readiness, and metrics for Prometheus."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from kernel.params import KERNEL_VERSION
from service.jobs.ledger import Ledger
from service.jobs.manager import JobManager
from service.jobs.model import JobState
from worker.executors.base import Executor

#: Methods with their own label; the rest share one, so that callers cannot create labels.
_METHODS: Final = frozenset({"GET", "HEAD", "POST", "DELETE", "OPTIONS", "PUT", "PATCH"})


class Readiness:
    """Whether the ledger is usable, the scheduler answers and there are workers; thread-safe.

    Caches the executor's answer for `max_age` seconds. `ledger_fault` says why the ledger is unusable.
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
        self._fault: str | None = None

    def fault(self) -> str | None:
        """Why jobs are not accepted or computed; None if they are."""
        if (fault := self._ledger_fault()) is not None:
            return fault
        with self._lock:
            if time.monotonic() - self._checked > self._max_age:
                self._fault = self._executor.state().fault
                self._checked = time.monotonic()
            return self._fault

    def ready(self) -> bool:
        """Whether jobs are accepted and computed."""
        return self.fault() is None


class Metrics:
    """Metrics of one service, in their own registry."""

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

    def add_jobs(self, ledger: Ledger, readiness: Readiness, manager: JobManager) -> None:
        """Also report the ledger's jobs, their chunks and the scheduler's readiness."""
        self._registry.register(_JobsCollector(ledger, readiness, manager))

    def add_cluster(self, executor: Executor) -> None:
        """Also report the workers."""
        self._registry.register(_ClusterCollector(executor))

    def count_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request; `route` is the path's template, so that job ids do not become labels."""
        self._requests.labels(method if method in _METHODS else "other", route, str(status)).inc()
        self._seconds.labels(route).observe(seconds)

    def text(self) -> bytes:
        """All metrics in Prometheus's text format."""
        return generate_latest(self._registry)


class _JobsCollector(Collector):
    """Reads the ledger and the readiness whenever metrics are collected."""

    def __init__(self, ledger: Ledger, readiness: Readiness, manager: JobManager) -> None:
        self._ledger, self._readiness, self._manager = ledger, readiness, manager

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
        yield GaugeMetricFamily(
            "bounce_chunks_in_flight",
            "Chunks that workers compute, or that wait for one.",
            self._manager.supervisor.in_flight(),
        )
        tally = self._manager.supervisor.tally
        yield CounterMetricFamily(
            "bounce_chunks_computed", "Chunks computed since the start.", tally.computed
        )
        yield CounterMetricFamily(
            "bounce_chunk_seconds", "Seconds of workers for the chunks computed.", tally.seconds
        )
        returned = CounterMetricFamily(
            "bounce_chunks_returned",
            "Chunks that came back without a result, by action and kind of error.",
            labels=["action", "error"],
        )
        for (action, error), number in list(tally.returned.items()):
            returned.add_metric([action, error], number)
        yield returned
        durations = HistogramMetricFamily(
            "bounce_chunk_duration_seconds", "Seconds of workers for each chunk computed since the start."
        )
        buckets = [
            ("+Inf" if limit == math.inf else f"{limit:g}", float(number))
            for limit, number in tally.by_seconds
        ]
        durations.add_metric([], buckets, tally.seconds)
        yield durations
        yield GaugeMetricFamily(
            "bounce_core_seconds_remaining",
            "Core-seconds that the unfinished jobs will take, by the cost table.",
            self._manager.supervisor.remaining_seconds,
        )
        scrubber = self._manager.scrubber
        verified, damaged = scrubber.verified_chunks, scrubber.damaged_chunks
        yield CounterMetricFamily(
            "bounce_chunks_verified", "Stored chunks whose checksums were verified since the start.", verified
        )
        yield CounterMetricFamily(
            "bounce_chunks_damaged", "Stored chunks that verifying found damaged since the start.", damaged
        )

    def describe(self) -> list[Metric]:
        return []


class _ClusterCollector(Collector):
    """Asks the executor whenever metrics are collected."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    def collect(self) -> Iterator[Metric]:
        cluster = self._executor.state()
        workers = GaugeMetricFamily(
            "bounce_workers", "Workers that compute, are planned, or are refused.", labels=["state"]
        )
        workers.add_metric(["computing"], cluster.workers)
        workers.add_metric(["refused"], len(cluster.refused))
        if cluster.planned is not None:
            workers.add_metric(["planned"], cluster.planned)
        yield workers
        build = InfoMetricFamily("bounce_build", "What this service is.")
        build.add_metric([], {"version": version("bouncing-spring"), "kernel_version": KERNEL_VERSION})
        yield build

    def describe(self) -> list[Metric]:
        return []
