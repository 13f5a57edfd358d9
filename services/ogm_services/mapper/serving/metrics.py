"""Metrics of a mapper as Prometheus text (exposition format 0.0.4).

No label takes a value of which there may be any number: sensors and runs are counted in the status alone.
"""

import platform
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from importlib.metadata import version

from prometheus_client import ProcessCollector, generate_latest
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric

from ogm_core.status import PoseCounts, RobotStatus, ScanCounts, Status
from ogm_services.mapper.serving.measurements import Measurements

MEDIA_TYPE = "text/plain; version=0.0.4"
_NOT_USED = ("malformed", "late", "outlier", "superseded", "refused")
"""What keeps a pose from being used."""

Source = Callable[[], Iterable[Metric]]


class Metrics:
    """What Prometheus is told of one mapper: its status, measurements, other sources, and its process."""

    def __init__(self, *sources: Source) -> None:
        self.measurements = Measurements()
        self._sources = (*sources, self.measurements.collect, _build_info)
        self._process = ProcessCollector(registry=None)

    def text(self, status: Status) -> bytes:
        """Everything, now; all that is the mapper's own has the label `map`."""
        return generate_latest(_Collected(self._collect(status)))

    def _collect(self, status: Status) -> Iterator[Metric]:
        for source in (lambda: _status_families(status), *self._sources):
            for family in source():
                family.samples = [
                    sample._replace(labels={"map": status.map, **sample.labels})
                    for sample in family.samples
                    if not sample.name.endswith("_created")  # each one a series more, which nobody reads
                ]
                yield family
        yield from self._process.collect()


class _Collected:
    """What `generate_latest` takes."""

    def __init__(self, families: Iterator[Metric]) -> None:
        self._families = families

    def collect(self) -> Iterator[Metric]:
        return self._families


def gauge(name: str, text: str, value: float) -> Metric:
    """A family of one sample."""
    return GaugeMetricFamily(name, text, value)


def gauges(name: str, text: str, label: str, values: Mapping[str, float]) -> Metric:
    """A family of a sample for each value of a label."""
    family = GaugeMetricFamily(name, text, labels=[label])
    for of, value in values.items():
        family.add_metric([of], value)
    return family


def _counters(name: str, text: str, label: str, values: Mapping[str, float]) -> Metric:
    family = CounterMetricFamily(name, text, labels=[label])
    for of, value in values.items():
        family.add_metric([of], value)
    return family


def _build_info() -> Iterator[Metric]:
    labels = {
        "version": version("zenoh-ogm"),
        "python": platform.python_version(),
        "zenoh": version("eclipse-zenoh"),
    }
    family = GaugeMetricFamily("ogm_build_info", "1, with the versions that run.", labels=list(labels))
    family.add_metric(list(labels.values()), 1)
    yield family


def _status_families(status: Status) -> Iterator[Metric]:
    info = status.map_info
    yield from _scans(status.scans)
    yield from _poses(status.poses)
    yield CounterMetricFamily("ogm_messages_ignored_total", "Neither poses nor scans.", status.other.ignored)
    yield gauge(
        "ogm_map_revision", "Scans integrated, and erasures, since the map was made.", status.revision
    )
    yield gauge("ogm_map_known_cells", "Cells that were ever updated.", info.known_cells)
    yield gauge("ogm_map_bytes", "Memory that the map has allocated.", info.bytes)
    yield gauge("ogm_robots", "Robots heard of.", len(status.robots))
    yield from _robots(status.robots)
    yield gauge("ogm_uptime_seconds", "Time since the mapper started.", status.uptime_s)


def _scans(scans: ScanCounts) -> Iterator[Metric]:
    yield CounterMetricFamily("ogm_scans_received_total", "Scans that arrived.", scans.received)
    yield CounterMetricFamily("ogm_scans_integrated_total", "Scans that are in the map.", scans.integrated)
    yield gauge("ogm_scans_pending", "Scans that wait.", scans.pending)
    dropped = "Scans that will never be in the map."
    yield _counters("ogm_scans_dropped_total", dropped, "reason", scans.dropped)
    yield CounterMetricFamily("ogm_scans_lost_total", "Scans that never arrived.", scans.lost)
    yield CounterMetricFamily("ogm_scans_replayed_total", "Scans that came again.", scans.replayed)
    if scans.of_others is not None:
        others = "Scans that another share of the map counts."
        yield _counters("ogm_scans_of_others_total", others, "kind", asdict(scans.of_others))
    on_robots = "Beams that were skipped because they ended at another robot."
    yield CounterMetricFamily("ogm_beams_on_robots_total", on_robots, scans.beams_on_robots)


def _poses(poses: PoseCounts) -> Iterator[Metric]:
    yield CounterMetricFamily("ogm_poses_received_total", "Poses that arrived.", poses.received)
    refused = {reason: getattr(poses, reason) for reason in _NOT_USED}
    yield _counters("ogm_poses_refused_total", "Poses that were not used.", "reason", refused)
    anew = "Poses whose clock had gone back."
    yield CounterMetricFamily("ogm_poses_restarted_total", anew, poses.restarted)
    yield CounterMetricFamily(
        "ogm_poses_ambiguous_total", "Poses with the stamp of another.", poses.ambiguous
    )
    yield CounterMetricFamily("ogm_poses_lost_total", "Poses that never arrived.", poses.lost)
    yield CounterMetricFamily("ogm_poses_replayed_total", "Poses that came again.", poses.replayed)


def _robots(robots: Mapping[str, RobotStatus]) -> Iterator[Metric]:
    """Five samples a robot at most: reasons, and sensors, of which each has several, are in the status."""
    alive = {name: int(robot.alive) for name, robot in robots.items()}
    yield gauges("ogm_robot_alive", "Whether the robot says that it is alive.", "robot", alive)
    ages = {name: robot.age_s for name, robot in robots.items() if robot.age_s is not None}
    yield gauges("ogm_robot_age_seconds", "Time since the robot's last message.", "robot", ages)
    received = {
        name: sum(source.received for source in robot.sources.values()) for name, robot in robots.items()
    }
    yield _counters("ogm_robot_scans_received_total", "Scans of the robot that arrived.", "robot", received)
    dropped = {
        name: sum(sum(source.dropped.values()) for source in robot.sources.values())
        for name, robot in robots.items()
    }
    yield _counters("ogm_robot_scans_dropped_total", "Dropped scans of the robot.", "robot", dropped)
    hints = {
        name: sum(len(source.hints) for source in robot.sources.values()) for name, robot in robots.items()
    }
    yield gauges("ogm_robot_hints", "How much looks wrong with the robot's data.", "robot", hints)
