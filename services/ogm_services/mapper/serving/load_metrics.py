"""Metrics of a mapper's load: what waits and what is held, each with its limit, and whether it is ready."""

from collections.abc import Iterator

from prometheus_client.metrics_core import Metric

from ogm_services.mapper.intake.load import MAX_WORK
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.serving.health import Health
from ogm_services.mapper.serving.metrics import gauge, gauges
from ogm_services.mapper.storage.kept_map import KeptMap
from ogm_services.runtime.memory import MemoryUse


def queue_metrics(queue: ScanQueue) -> Iterator[Metric]:
    """The queue before the worker: work in s of its time, payload, and scans."""
    yield gauge("ogm_queue_work_seconds", "Time that the scans that wait will take, about.", queue.work)
    yield gauge("ogm_queue_work_limit_seconds", "How much of it may wait.", MAX_WORK)
    yield gauge("ogm_queue_bytes", "Payload of the messages that wait.", queue.bytes)
    yield gauge("ogm_queue_limit_bytes", "How much of it may wait.", queue.max_bytes)
    yield gauge("ogm_queue_scans", "Scans that wait in the queue.", queue.scans)
    yield gauge("ogm_queue_limit_scans", "How many of them may wait.", queue.max_scans)


def ready_metric(health: Health) -> Iterator[Metric]:
    """What /readyz says, as a number."""
    yield gauge("ogm_ready", "1 while the mapper should get scans, else 0.", health.not_ready() is None)


def store_metrics(kept_map: KeptMap) -> Iterator[Metric]:
    """How far the map is stored on disk."""
    if kept_map.revision is not None:
        yield gauge("ogm_stored_revision", "Revision of the map that was stored last.", kept_map.revision)
    failing = kept_map.failing is not None
    yield gauge("ogm_store_failing", "1 while the map cannot be stored, else 0.", failing)


def memory_metrics(memory: MemoryUse) -> Iterator[Metric]:
    """Memory by kind; a kind that may take what the others leave has no limit of its own."""
    yield gauges("ogm_memory_bytes", "Memory held for robots and readers.", "kind", memory.held())
    limits = {kind: limit for kind, limit in memory.limits().items() if limit is not None}
    yield gauges("ogm_memory_kind_limit_bytes", "How much of a kind may be held.", "kind", limits)
    yield gauge("ogm_memory_limit_bytes", "How much of all kinds together may be held.", memory.limit)
