"""The mapper's status as Prometheus text (exposition format 0.0.4)."""

from collections.abc import Mapping

from ogm_core.status import Status


def prometheus_text(status: Status) -> str:
    """Render a mapper's status; every sample carries the map's name."""
    name, scans, poses, info = status.map, status.scans, status.poses, status.map_info
    lines: list[str] = []

    def family(metric: str, kind: str, text: str, samples: Mapping[str, float]) -> None:
        lines.extend((f"# HELP {metric} {text}", f"# TYPE {metric} {kind}"))
        for label, value in samples.items():
            lines.append(f'{metric}{{map="{name}"{label}}} {value}')

    def single(metric: str, kind: str, text: str, value: float) -> None:
        family(metric, kind, text, {"": value})

    single("ogm_scans_received_total", "counter", "Scans that arrived.", scans.received)
    single("ogm_scans_integrated_total", "counter", "Scans that are in the map.", scans.integrated)
    single("ogm_scans_pending", "gauge", "Scans that wait.", scans.pending)
    dropped = {f',reason="{reason}"': count for reason, count in scans.dropped.items()}
    family("ogm_scans_dropped_total", "counter", "Scans that will never be in the map.", dropped)
    single("ogm_poses_received_total", "counter", "Poses that arrived.", poses.received)
    refused = {',reason="malformed"': poses.malformed, ',reason="late"': poses.late}
    family("ogm_poses_refused_total", "counter", "Poses that were not used.", refused)
    single("ogm_messages_ignored_total", "counter", "Neither poses nor scans.", status.other.ignored)
    single("ogm_map_revision", "gauge", "Scans integrated since the map was made.", status.revision)
    single("ogm_map_known_cells", "gauge", "Cells that were ever updated.", info.known_cells)
    single("ogm_map_bytes", "gauge", "Memory that the map has allocated.", info.bytes)
    single("ogm_robots", "gauge", "Robots heard of.", len(status.robots))
    single("ogm_uptime_seconds", "gauge", "Time since the mapper started.", status.uptime_s)
    return "\n".join(lines) + "\n"
