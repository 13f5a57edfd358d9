"""What waits and what is held, as Prometheus is told."""

from functools import partial

from ogm_core.wire.keys import Source
from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.serving.health import Health
from ogm_services.mapper.serving.load_metrics import memory_metrics, queue_metrics, ready_metric
from ogm_services.mapper.serving.metrics import Metrics
from ogm_services.runtime.memory import MemoryUse
from status_json import STATUS


def told(*sources):
    """Lines of these families, without what is of the mapper alone."""
    lines = Metrics(*sources).text(STATUS).decode().splitlines()
    return [line for line in lines if line.startswith(("ogm_queue", "ogm_memory", "ogm_ready"))]


def test_what_waits_is_told_with_its_limits():
    queue = ScanQueue(10, max_bytes=4096)
    queue.put(Message(Source("r", "s"), bytes(1000), 0.0))
    queue.put(Message(Source("r", None), bytes(24), 0.0))
    work, *rest = told(partial(queue_metrics, queue))
    assert work.startswith('ogm_queue_work_seconds{map="hall"} ')
    assert float(work.split()[1]) == queue.work
    assert rest == [
        'ogm_queue_work_limit_seconds{map="hall"} 5.0',
        'ogm_queue_bytes{map="hall"} 1024.0',
        'ogm_queue_limit_bytes{map="hall"} 4096.0',
        'ogm_queue_scans{map="hall"} 1.0',
        'ogm_queue_limit_scans{map="hall"} 10.0',
    ]


def test_what_is_held_is_told_by_kind_with_the_limits_that_there_are():
    memory = MemoryUse(1000)
    memory.add("map", lambda: 500)
    memory.add("waiting", lambda: 60, 62)
    assert told(partial(memory_metrics, memory)) == [
        'ogm_memory_bytes{kind="map",map="hall"} 500.0',
        'ogm_memory_bytes{kind="waiting",map="hall"} 60.0',
        'ogm_memory_kind_limit_bytes{kind="waiting",map="hall"} 62.0',
        'ogm_memory_limit_bytes{map="hall"} 1000.0',
    ]


def test_whether_the_mapper_is_ready_is_what_readyz_says():
    why = [None, "the mapper is stopping"]
    health = Health(lambda: True, [lambda: why[0]])
    assert told(partial(ready_metric, health)) == ['ogm_ready{map="hall"} 1.0']
    why.reverse()
    assert health.not_ready() == "the mapper is stopping"
    assert told(partial(ready_metric, health)) == ['ogm_ready{map="hall"} 0.0']
