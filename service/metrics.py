"""`/metrics`: what the engine and this application measure, in the text form of Prometheus.

A scrape reads what is in memory and a few counts along indexes; two within two seconds share those.
Counters begin at 0 with the process, as Prometheus expects.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)
from prometheus_client.exposition import generate_latest
from prometheus_client.registry import Collector
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from matiere.jobs import measure
from matiere.jobs.engine import Engine
from matiere.jobs.engine_gauges import Gauge
from matiere.jobs.job import FINAL_STATES
from matiere.jobs.measure import Measures

FRESH_S = 2.0
CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
OTHER = "other"  # an address without a route
_BOUNDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0)


class Metrics:
    """The registry of one application."""

    def __init__(self, engine: Callable[[], Engine]) -> None:
        """Measure the engine that `engine` returns."""
        self.registry = CollectorRegistry()
        self.requests = Counter(
            "matiere_http_requests",
            "Requests answered",
            ("method", "route", "status"),
            registry=self.registry,
        )
        self.seconds = Histogram(
            "matiere_http_request_seconds",
            "From the request's head to the end of its answer; streams of events are left out",
            ("method", "route"),
            buckets=_BOUNDS,
            registry=self.registry,
        )
        self.registry.register(_Engine(engine))
        ProcessCollector(registry=self.registry)

    def text(self) -> bytes:
        """Return all metrics."""
        return generate_latest(self.registry)


class MetricsMiddleware:
    """Count requests by method, route and status."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self.app, self.metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        begun, status = time.perf_counter(), 0

        async def noting(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        place: dict[str, str] = {}
        scope["matiere.route"] = place  # a wrapped copy of the scope holds the same dict
        try:
            await self.app(scope, receive, noting)
        finally:
            route = place.get("path", OTHER)
            method = scope["method"] if route != OTHER else OTHER  # any text may stand there
            self.metrics.requests.labels(method, route, str(status)).inc()
            if not route.endswith("/events"):
                took = time.perf_counter() - begun
                self.metrics.seconds.labels(method, route).observe(took)


class RouteNote:
    """Innermost: tells `MetricsMiddleware` which route was found."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        try:
            await self.app(scope, receive, send)
        finally:
            if "matiere.route" in scope and (path := getattr(scope.get("route"), "path", None)):
                scope["matiere.route"]["path"] = path


class _Engine(Collector):
    def __init__(self, engine: Callable[[], Engine]) -> None:
        self._engine = engine
        self._lock = threading.Lock()
        self._seen: tuple[float, Engine | None, Gauge | None] = (0.0, None, None)

    def _gauge(self, engine: Engine) -> Gauge:
        with self._lock:  # one scrape looks, the others wait for what it finds
            at, of, gauge = self._seen
            if gauge is None or of is not engine or time.monotonic() - at > FRESH_S:
                gauge = engine.gauge()
                self._seen = (time.monotonic(), engine, gauge)
            return gauge

    def describe(self) -> Iterable[Metric]:
        """Name nothing: the registry need not ask the engine when it is made."""
        return ()

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics of the engine."""
        engine = self._engine()
        gauge = self._gauge(engine)
        yield from _queue(gauge)
        yield from _children(gauge)
        yield from _work(engine.measures, gauge)
        yield from _histograms(engine.measures)
        yield _one("matiere_store_bytes", "Size of the job store", gauge.store_bytes)
        yield _one("matiere_disk_free_bytes", "Free disk of the data directory",
                   gauge.disk_free_bytes)  # fmt: skip
        for name, words, value in (
            ("disk_low", "Whether new work waits for disk space", gauge.disk_low),
            ("draining", "Whether the service is stopping", gauge.draining),
            ("scheduling", "Whether this process hands out work", gauge.scheduling),
        ):
            yield _one(f"matiere_{name}", words, int(value))


def _one(name: str, words: str, value: float) -> Metric:
    return GaugeMetricFamily(name, words, value=value)


def _queue(gauge: Gauge) -> Iterator[Metric]:
    jobs = GaugeMetricFamily("matiere_jobs", "Jobs that have not ended", labels=["state"])
    for state, count in gauge.jobs.items():
        jobs.add_metric([state], count)
    yield jobs
    depth = GaugeMetricFamily("matiere_queue_jobs", "Jobs that wait", labels=["priority"])
    age = GaugeMetricFamily(
        "matiere_queue_oldest_seconds", "Age of the oldest job that waits", labels=["priority"]
    )
    for priority, count, since in gauge.queue:
        depth.add_metric([str(priority)], count)
        age.add_metric([str(priority)], since)
    yield depth
    yield age
    yield _one("matiere_sweep_cells_waiting", "Cells of sweeps without a job yet", gauge.cells)


def _children(gauge: Gauge) -> Iterator[Metric]:
    ready = GaugeMetricFamily("matiere_child_ready", "Whether a child answers", labels=["child"])
    held = GaugeMetricFamily("matiere_child_claims", "Claims a child holds", labels=["child"])
    rss = GaugeMetricFamily(
        "matiere_child_resident_bytes", "Resident memory of a child", labels=["child"]
    )
    for name, is_ready, claims, size in gauge.children:
        ready.add_metric([name], int(is_ready))
        held.add_metric([name], claims)
        rss.add_metric([name], size)
    yield ready
    yield held
    yield rss
    yield _one("matiere_utility_waiting", "Merges, images and questions that wait",
               gauge.utility_waiting)  # fmt: skip


def _labelled(name: str, words: str, label: str, values: dict[str, int]) -> Metric:
    family = CounterMetricFamily(name, words, labels=[label])
    for key, value in sorted(values.items()):
        family.add_metric([key], value)
    return family


def _work(m: Measures, gauge: Gauge) -> Iterator[Metric]:
    events, counters = dict(m.events), gauge.counters
    yield _labelled("matiere_jobs_ended", "Jobs that ended, by state", "state",
                    {state: events.get(state, 0) for state in FINAL_STATES})  # fmt: skip
    yield _labelled("matiere_claims_ended_early", "Claims without a result, by class", "class",
                    dict(m.ended))  # fmt: skip
    yield _labelled("matiere_children_ended", "Children that died, by class", "class",
                    dict(m.child_ends))  # fmt: skip
    for name, words, value in (
        ("matiere_jobs_queued", "Jobs submitted, resumed or requeued", events.get("queued", 0)),
        ("matiere_cache_hits", "Submissions that a stored film answers", events.get("cached", 0)),
        ("matiere_claims_done", "Claims rendered and accepted", counters.get("claims_done", 0)),
        ("matiere_reports_superseded", "Reports of attempts that were over",
         counters.get("reports_superseded", 0)),
        ("matiere_children_started", "Children started", counters.get("children_started", 0)),
        ("matiere_pixel_samples", "Samples of pixels rendered and accepted", m.samples),
        ("matiere_render_seconds", "Seconds that children rendered for them", m.render_s),
    ):  # fmt: skip
        yield CounterMetricFamily(name, words, value=value)


def _histograms(m: Measures) -> Iterator[Metric]:
    for name, words, histogram in (
        ("matiere_store_write_seconds", "A write to the store: wait and transaction", m.writes),
        ("matiere_claim_seconds", "Recording a claim", m.claims),
        ("matiere_chunk_seconds", "Rendering one chunk", m.chunks),
        ("matiere_merge_seconds", "Merging chunks into a film", m.merges),
        ("matiere_images_seconds", "Making the images of a job", m.images),
    ):
        yield _family(name, words, histogram)


def _family(name: str, words: str, histogram: measure.Histogram) -> Metric:
    counts, total = histogram.read()
    buckets = [("+Inf" if bound == float("inf") else str(bound), n) for bound, n in counts]
    return HistogramMetricFamily(name, words, buckets=buckets, sum_value=total)
