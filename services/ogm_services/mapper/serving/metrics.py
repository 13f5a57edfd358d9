"""The mapper's status as Prometheus text (exposition format 0.0.4)."""

from collections.abc import Mapping

from ogm_core.status import PoseCounts, RobotStatus, ScanCounts, Status


def prometheus_text(status: Status) -> str:
    """Render a mapper's status; every sample carries the map's name."""
    text, info = _Text(status.map), status.map_info
    _scans(text, status.scans)
    _poses(text, status.poses)
    text.single("ogm_messages_ignored_total", "counter", "Neither poses nor scans.", status.other.ignored)
    text.single("ogm_map_revision", "gauge", "Scans integrated since the map was made.", status.revision)
    text.single("ogm_map_known_cells", "gauge", "Cells that were ever updated.", info.known_cells)
    text.single("ogm_map_bytes", "gauge", "Memory that the map has allocated.", info.bytes)
    text.single("ogm_robots", "gauge", "Robots heard of.", len(status.robots))
    _robots(text, status.robots)
    text.single("ogm_uptime_seconds", "gauge", "Time since the mapper started.", status.uptime_s)
    return "\n".join(text.lines) + "\n"


class _Text:
    """Lines of samples, by family; labels begin with a comma."""

    def __init__(self, map_name: str) -> None:
        self._map_name = map_name
        self.lines: list[str] = []

    def family(self, metric: str, kind: str, text: str, samples: Mapping[str, float]) -> None:
        self.lines.extend((f"# HELP {metric} {text}", f"# TYPE {metric} {kind}"))
        for labels, value in samples.items():
            self.lines.append(f'{metric}{{map="{self._map_name}"{labels}}} {value}')

    def single(self, metric: str, kind: str, text: str, value: float) -> None:
        self.family(metric, kind, text, {"": value})


def _scans(text: _Text, scans: ScanCounts) -> None:
    text.single("ogm_scans_received_total", "counter", "Scans that arrived.", scans.received)
    text.single("ogm_scans_integrated_total", "counter", "Scans that are in the map.", scans.integrated)
    text.single("ogm_scans_pending", "gauge", "Scans that wait.", scans.pending)
    dropped = {f',reason="{reason}"': count for reason, count in scans.dropped.items()}
    text.family("ogm_scans_dropped_total", "counter", "Scans that will never be in the map.", dropped)


def _poses(text: _Text, poses: PoseCounts) -> None:
    text.single("ogm_poses_received_total", "counter", "Poses that arrived.", poses.received)
    reasons = ("malformed", "late", "outlier", "superseded", "refused")
    refused = {f',reason="{reason}"': getattr(poses, reason) for reason in reasons}
    text.family("ogm_poses_refused_total", "counter", "Poses that were not used.", refused)
    text.single("ogm_poses_restarted_total", "counter", "Poses whose clock had gone back.", poses.restarted)
    text.single("ogm_poses_ambiguous_total", "counter", "Poses with the stamp of another.", poses.ambiguous)


def _robots(text: _Text, robots: Mapping[str, RobotStatus]) -> None:
    alive: dict[str, float] = {}
    ages: dict[str, float] = {}
    dropped: dict[str, float] = {}
    hints: dict[str, float] = {}
    for name, robot in robots.items():
        label = f',robot="{name}"'
        alive[label] = int(robot.alive)
        if robot.age_s is not None:
            ages[label] = robot.age_s
        for sensor, source in robot.sources.items():
            of = f'{label},sensor="{sensor}"'
            dropped |= {f'{of},reason="{reason}"': count for reason, count in source.dropped.items()}
            hints |= {f'{of},hint="{hint}"': 1 for hint in source.hints}
    text.family("ogm_robot_alive", "gauge", "Whether the robot says that it is alive.", alive)
    text.family("ogm_robot_age_seconds", "gauge", "Time since the robot's last message.", ages)
    text.family("ogm_source_scans_dropped_total", "counter", "Dropped scans of each sensor.", dropped)
    text.family("ogm_source_hint", "gauge", "1 for what looks wrong with a sensor's data.", hints)
