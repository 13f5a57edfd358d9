"""Measurements of a mapper as things happen: how long scans and requests take, and how many there are."""

import time
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from itertools import accumulate

from prometheus_client import Counter, Gauge, Histogram
from prometheus_client.metrics_core import GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.utils import floatToGoString

from ogm_services.mapper.serving.http_limits import CLOSED_FOR
from ogm_services.mapper.serving.live_clients import ENDED_FOR

AGE_BUCKETS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
INTEGRATION_BUCKETS = (0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.1, 0.25, 1.0, 5.0)
REQUEST_BUCKETS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)


class Durations:
    """Histogram of what happens at every scan: one thread notes it, without a lock; any thread reads it.

    prometheus_client's own takes four times as long to note a value.
    """

    def __init__(self, name: str, text: str, buckets: Sequence[float]) -> None:
        """`buckets`: upper bounds, s, rising."""
        self._name, self._text, self._buckets = name, text, buckets
        self._counts = [0] * (len(buckets) + 1)
        self._sum = 0.0

    def observe(self, seconds: float) -> None:
        """Note how long it took."""
        self._counts[bisect_left(self._buckets, seconds)] += 1
        self._sum += seconds

    def collect(self) -> Iterator[Metric]:
        """The histogram as it is now."""
        bounds = (*map(floatToGoString, self._buckets), "+Inf")
        counts = zip(bounds, accumulate(self._counts), strict=True)
        yield HistogramMetricFamily(self._name, self._text, buckets=list(counts), sum_value=self._sum)


class Measurements:
    """Counts and histograms of one mapper; any thread. No registry: nothing is shared between mappers."""

    def __init__(self) -> None:
        self._last_integrated: float | None = None
        self._age = Durations(
            "ogm_scan_age_seconds", "Time from a scan's arrival until it was in the map.", AGE_BUCKETS
        )
        self.integration = Durations(
            "ogm_scan_integration_seconds",
            "Time that the map took for a scan that it has integrated.",
            INTEGRATION_BUCKETS,
        )
        self._requests = Counter(
            "ogm_http_requests_total", "HTTP requests.", ["route", "method", "status"], registry=None
        )
        self._durations = Histogram(
            "ogm_http_request_duration_seconds",
            "Time until an HTTP request was answered to its end.",
            ["route"],
            buckets=REQUEST_BUCKETS,
            registry=None,
        )
        self._closed = Counter(
            "ogm_http_connections_closed_total",
            "HTTP connections that the mapper closed, with a request that no route has seen, or without one.",
            ["reason"],
            registry=None,
        )
        for reason in CLOSED_FOR:
            self._closed.labels(reason)
        self._live = Gauge("ogm_live_clients", "WebSocket clients that watch the map live.", registry=None)
        self._live_ended = Counter(
            "ogm_live_clients_ended_total",
            "WebSocket clients that are served no longer, or that were not let in.",
            ["reason"],
            registry=None,
        )
        for reason in ENDED_FOR:
            self._live_ended.labels(reason)
        self._of_requests: dict[tuple[str, str, str], tuple[Counter, Histogram]] = {}
        """Series that were looked up before: `labels` takes longer than all the rest."""

    def scan_integrated(self, arrival: float) -> None:
        """Note that a scan is in the map that arrived at `arrival`, s of the monotonic clock."""
        self._last_integrated = time.time()
        self._age.observe(time.monotonic() - arrival)

    def http_answered(self, route: str, method: str, status: str, seconds: float) -> None:
        """Note a request, by names of which there are few."""
        key = route, method, status
        series = self._of_requests.get(key)
        if series is None:
            series = self._requests.labels(*key), self._durations.labels(route)
            self._of_requests[key] = series
        count, duration = series
        count.inc()
        duration.observe(seconds)

    def http_closed(self, reason: str) -> None:
        """Note a connection that was closed for one of `CLOSED_FOR`."""
        self._closed.labels(reason).inc()

    def live_clients(self, count: int) -> None:
        """Note how many WebSocket clients there are."""
        self._live.set(count)

    def live_ended(self, reason: str) -> None:
        """Note that one is served no longer, for one of `ENDED_FOR`."""
        self._live_ended.labels(reason).inc()

    def collect(self) -> Iterator[Metric]:
        """Everything that has been measured."""
        if self._last_integrated is not None:
            text = "When a scan was last integrated, Unix time."
            yield GaugeMetricFamily("ogm_last_integrated_timestamp_seconds", text, self._last_integrated)
        for instrument in (self._age, self.integration, self._requests, self._durations, self._closed):
            yield from instrument.collect()
        yield from self._live.collect()
        yield from self._live_ended.collect()
