"""`ogm status`: what a running mapper is doing, as tables."""

from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from typing import NamedTuple

from rich import box
from rich.table import Table

from ogm_core.status import PoseCounts, RobotStatus, ShareInfo, Status, StoreInfo
from ogm_services.replies.what_helps import HINT_HELPS, LOST_HELPS, ON_ROBOTS_MEANS, WHAT_HELPS


class Rates(NamedTuple):
    """Scans a second, between two looks at one mapper; those received of each `<robot>/<sensor>`, too."""

    received: float
    integrated: float
    dropped: float
    sources: Mapping[str, float]

    def in_words(self) -> str:
        """As a row of the table."""
        return f"{self.received:.1f} received, {self.integrated:.1f} integrated, {self.dropped:.1f} dropped"


def status_tables(status: Status, rates: Rates | None = None) -> list[Table]:
    """The mapper's status for the eye: the map, a row for every robot and sensor, and what went wrong.

    `rates`: what happens a second, if that is known.
    """
    shown = {name: robot for name, robot in sorted(status.robots.items()) if not robot.gone}
    parts = _shares(status), _robots(shown), _sources(shown, rates), _wrong(shown)
    return [_whole(status, rates), *(table for table in parts if table.rows)]


def _whole(status: Status, rates: Rates | None) -> Table:
    """The map as a whole, a row for each thing that is known."""
    scans, info = status.scans, status.map_info
    whole = Table(box=box.SIMPLE, show_header=False, title=f"map {status.map}", title_justify="left")
    whole.add_column(style="bold")
    whole.add_column()
    rows = {
        "epoch": status.epoch,
        "run": status.run,
        "share": "" if status.share is None else _share(status.share),
        "revision": status.revision,
        "stamp": local_time(status.stamp),
        "scans": f"{scans.received} received, {scans.integrated} integrated, {scans.pending} pending",
        "of others": "" if scans.of_others is None else _nonzero(asdict(scans.of_others)),
        "a second": rates.in_words() if rates else "",
        "dropped": _nonzero(scans.dropped),
        "complete": "" if status.complete is None else _complete(status),
        "poses": _poses(status.poses),
        "lost": _scans_and_poses(scans.lost, status.poses.lost),
        "replayed": _scans_and_poses(scans.replayed, status.poses.replayed),
        "on robots": f"{scans.beams_on_robots} beams" if scans.beams_on_robots else "",
        "ignored": status.other.ignored,
        "size": f"{info.width} x {info.height} cells of {info.resolution:g} m",
        "known": f"{info.known_cells} cells",
        "robots in it": "" if info.robots is None else ", ".join(info.robots) or "none",
        "threads": status.threads if status.threads > 1 else "",
        "memory": f"{info.bytes / 1e6:.1f} MB",
        "stored": "" if status.store is None else _stored(status.store, status.restored),
        "up": f"{status.uptime_s:.0f} s",
    }
    for label, value in rows.items():
        if value != "":
            whole.add_row(label, str(value))
    return whole


def _share(share: ShareInfo) -> str:
    """Which share of the map it is, and from where to where it reaches."""
    edges = ["open" if edge is None else f"{edge:g}" for edge in share.bounds]
    return f"{share.index} of {share.shares}: x {edges[0]} to {edges[2]}, y {edges[1]} to {edges[3]} m"


def _complete(status: Status) -> str:
    """Whether the shares of a gateway's map have all scans, or what is known of why not."""
    if status.complete:
        return "yes"
    shares, scans = status.shares or [], status.scans
    missing = ", ".join(str(share.share) for share in shares if share.state == "missing")
    overload = sum(share.overload or 0 for share in shares)
    apart = scans.received - scans.integrated - scans.pending - sum(scans.dropped.values())
    reasons = (
        f"share {missing} is missing" if missing else "",
        f"{overload} dropped by shares that had no time for them" if overload else "",
        f"{apart} received, and not counted by the share that they are of" if apart > 0 else "",
        f"{-apart} counted by the share that they are of, and not received by share 0" if apart < 0 else "",
    )
    return f"no: {'; '.join(filter(None, reasons)) or 'a share does not say how it is'}"


def _shares(status: Status) -> Table:
    """A row for every share of a gateway's map: whether it answers, how far it is, and what is wrong."""
    table = plain_table(
        "share", "state", "since", "restored", "what is wrong", right=("revision", "overload")
    )
    for share in status.shares or ():
        numbers = ("" if number is None else str(number) for number in (share.revision, share.overload))
        since = "" if share.since is None else local_time(share.since)
        restored = "" if share.restored is None else "yes" if share.restored else "no"
        table.add_row(str(share.share), share.state, since, restored, share.detail or "", *numbers)
    return table


def _robots(robots: Mapping[str, RobotStatus]) -> Table:
    """A row for every robot: whether it is alive, when it was heard, and where it was last said to be."""
    table = plain_table("robot", "alive", right=("last message", "x", "y", "theta"))
    for name, robot in robots.items():
        age = "" if robot.age_s is None else f"{robot.age_s:.1f} s ago"
        pose = [f"{value:.2f}" for value in robot.pose or ()]
        table.add_row(name, "yes" if robot.alive else "no", age, *pose)
    return table


def _sources(robots: Mapping[str, RobotStatus], rates: Rates | None) -> Table:
    """A row for every sensor: what became of its scans, and how many a second it sends, if that is known."""
    received = ("received",) if rates is None else ("received", "a second")
    table = plain_table("source", right=(*received, "integrated", "pending", "dropped", "last seq"))
    for name, robot in robots.items():
        for sensor, source in sorted(robot.sources.items()):
            dropped = sum(source.dropped.values())
            numbers = source.integrated, source.pending, dropped
            last_seq = "" if source.last_seq is None else str(source.last_seq)
            row = [f"{name}/{sensor}", str(source.received)]
            if rates is not None:
                rate = rates.sources.get(row[0])
                row.append("" if rate is None else f"{rate:.1f}")
            table.add_row(*row, *map(str, numbers), last_seq)
    return table


def _wrong(robots: Mapping[str, RobotStatus]) -> Table:
    """A row for every reason that scans of a sensor, or beams, are not in the map for, and for every hint."""
    table = plain_table("source", "not in the map", "what helps")
    for name, robot in robots.items():
        for sensor, source in sorted(robot.sources.items()):
            for reason, count in source.dropped.items():
                table.add_row(f"{name}/{sensor}", f"{count} {reason}", WHAT_HELPS.get(reason, ""))
            if source.lost:
                table.add_row(f"{name}/{sensor}", f"{source.lost} lost", LOST_HELPS)
            if source.beams_on_robots:
                table.add_row(
                    f"{name}/{sensor}", f"{source.beams_on_robots} beams on robots", ON_ROBOTS_MEANS
                )
            for hint in source.hints:
                table.add_row(f"{name}/{sensor}", f"hint: {hint}", HINT_HELPS)
    return table


def plain_table(*left: str, right: tuple[str, ...] = ()) -> Table:
    """A table with columns of text on the left, and of numbers on the right."""
    table = Table(box=box.SIMPLE, pad_edge=False)
    for column in left:
        table.add_column(column)
    for column in right:
        table.add_column(column, justify="right")
    return table


def _poses(poses: PoseCounts) -> str:
    """Those received, and of the odd ones those that there are."""
    return ", ".join([f"{poses.received} received", *(f"{n} {what}" for what, n in poses.odd.items())])


def _stored(store: StoreInfo, restored: bool | None) -> str:
    """How far the map is on disk, or why not, and what was there at the start."""
    stored = "nothing yet" if store.revision is None else f"revision {store.revision}"
    told = f"{stored}, {store.bytes / 1e6:.1f} MB" if store.failing is None else f"{stored}; {store.failing}"
    return told if restored is None else f"{told}; {'restored' if restored else 'none there'} at the start"


def _scans_and_poses(scans: int, poses: int) -> str:
    """How many of each, "" if there are none."""
    return ", ".join(f"{count} {what}" for count, what in ((scans, "scans"), (poses, "poses")) if count)


def _nonzero(dropped: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in dropped.items() if count) or "none"


def local_time(stamp: int | None) -> str:
    """A time in ns since the Unix epoch as this machine's clocks show it, "none" if there is none."""
    if stamp is None:
        return "none"
    return (
        datetime.fromtimestamp(stamp / 1e9, tz=UTC).astimezone().isoformat(sep=" ", timespec="milliseconds")
    )
