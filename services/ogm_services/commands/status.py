"""`ogm status`: what a running mapper is doing, as tables."""

from collections.abc import Mapping
from datetime import UTC, datetime

from rich import box
from rich.table import Table

from ogm_core.status import RobotStatus, Status


def status_tables(status: Status) -> list[Table]:
    """The mapper's status for the eye: the map as a whole, then a row for every robot and sensor."""
    scans, poses, info = status.scans, status.poses, status.map_info
    whole = Table(box=box.SIMPLE, show_header=False, title=f"map {status.map}", title_justify="left")
    whole.add_column(style="bold")
    whole.add_column()
    rows = {
        "epoch": status.epoch,
        "revision": status.revision,
        "stamp": _time(status.stamp),
        "scans": f"{scans.received} received, {scans.integrated} integrated, {scans.pending} pending",
        "dropped": _nonzero(scans.dropped),
        "poses": f"{poses.received} received, {poses.malformed} malformed, {poses.late} late",
        "ignored": status.other.ignored,
        "size": f"{info.width} x {info.height} cells of {info.resolution:g} m",
        "known": f"{info.known_cells} cells",
        "memory": f"{info.bytes / 1e6:.1f} MB",
        "up": f"{status.uptime_s:.0f} s",
    }
    for label, value in rows.items():
        whole.add_row(label, str(value))
    return [whole, _sources(status.robots)]


def _sources(robots: Mapping[str, RobotStatus]) -> Table:
    table = Table(box=box.SIMPLE, collapse_padding=True, pad_edge=False)
    for column in ("robot", "x", "y", "theta", "sensor", "received", "integrated", "pending", "last seq"):
        table.add_column(column, justify="left" if column in ("robot", "sensor") else "right")
    for name, robot in sorted(robots.items()):
        pose = [f"{value:.2f}" for value in robot.pose or ()] or [""] * 3
        if not robot.sources:
            table.add_row(name, *pose)
        for sensor, source in sorted(robot.sources.items()):
            last_seq = "" if source.last_seq is None else str(source.last_seq)
            counts = (source.received, source.integrated, source.pending)
            table.add_row(name, *pose, sensor, *map(str, counts), last_seq)
            name, pose = "", [""] * 3  # once per robot
    return table


def _nonzero(dropped: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in dropped.items() if count) or "none"


def _time(stamp: int | None) -> str:
    if stamp is None:
        return "none"
    return (
        datetime.fromtimestamp(stamp / 1e9, tz=UTC).astimezone().isoformat(sep=" ", timespec="milliseconds")
    )
