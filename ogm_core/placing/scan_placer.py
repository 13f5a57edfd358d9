"""Pose lookup and order of scans, as tf's message filter does: from messages to the map."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, cast

from ogm_core.errors import ScanRefused
from ogm_core.placing.pose_history import PoseHistory
from ogm_core.placing.receipts import DropReason, Receipts
from ogm_core.types import Pose, PoseStamped, Scan, Sweep

MAX_WAITING = 64
"""A scan waits for its pose until this many later ones of its sensor wait too."""
_WHY: dict[DropReason, str] = {
    "duplicate": "its seq is not above the last one of its run",
    "no_pose": "the robot's poses do not cover its stamp",
    "stale": "its stamp lies before the robot's oldest kept pose",
}

Complain = Callable[[str, str], None]
"""Told of a source, `<robot>/<sensor>`, and what was wrong with its message."""


class ScanSink(Protocol):
    """Where placed scans go: an `OccupancyGrid`, or something that stands in for one."""

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Take a scan at its sensor's pose in the map frame; raise ScanRefused to refuse it.

        `sweep`: the sensor's pose at every beam, where beams were taken one after the other.
        """
        ...


@dataclass(slots=True)
class _Robot:
    poses: PoseHistory = field(default_factory=PoseHistory)
    runs: set[str] = field(default_factory=set)
    """Every run that a pose has named."""
    waiting: list[tuple[str, Scan]] = field(default_factory=list)
    """(sensor, scan) in order of arrival, until a pose at or after its last beam arrives."""
    last_seq: dict[tuple[str, str], int] = field(default_factory=dict)
    """By (sensor, run)."""
    heard: float = 0.0


class ScanPlacer:
    """Places scans by their robots' poses and hands them on in the order in which they become ready.

    One thread calls it. No decision reads a clock: `expire` is told the time. The same messages in the same
    order give the same calls to the sink.

    An error that the sink does not mean, a bug, is counted as its scan's `failed` and raised to the caller,
    once every other scan that was ready is placed.
    """

    def __init__(self, sink: ScanSink, receipts: Receipts, complain: Complain) -> None:
        self._sink = sink
        self._receipts = receipts
        self._complain = complain
        self._robots: dict[str, _Robot] = {}

    def add_pose(self, name: str, message: PoseStamped) -> None:
        """Take a robot's pose, and place every scan that it makes ready."""
        robot = self._robot(name)
        if message.run not in robot.runs:
            robot.runs.add(message.run)
            self._give_up(name, robot)
            robot.poses = PoseHistory()
        if not robot.poses.append(message.stamp, message.pose):
            self._receipts.pose_noted("late")
            return
        self._receipts.located(name, message.stamp, message.pose)
        waiting, robot.waiting = robot.waiting, []
        bugs = []
        for sensor, scan in waiting:
            if _ready_at(scan) <= message.stamp:
                try:
                    self._place(name, robot, sensor, scan)
                except Exception as bug:  # noqa: BLE001 (raised below)
                    bugs.append(bug)
            else:
                robot.waiting.append((sensor, scan))
        if bugs:
            raise ExceptionGroup(f"scans of {name} that waited for this pose", bugs)

    def add_scan(self, name: str, sensor: str, scan: Scan) -> None:
        """Take a robot's scan: place it if its pose is known, else let it wait."""
        robot = self._robot(name)
        self._receipts.scan_taken(name, sensor, scan.run, scan.seq)
        if self._is_duplicate(robot, sensor, scan):
            self._drop(name, sensor, "duplicate")
        elif scan.pose is not None:
            self._receipts.located(name, scan.stamp, scan.pose)
            self._place(name, robot, sensor, scan)
        elif robot.poses.newest is not None and _ready_at(scan) <= robot.poses.newest:
            self._place(name, robot, sensor, scan)
        elif robot.poses.oldest is not None and scan.stamp < robot.poses.oldest:
            self._drop(name, sensor, "stale")
        else:
            robot.waiting.append((sensor, scan))
            self._limit_waiting(name, robot, sensor)

    def heard(self, name: str, now: float) -> None:
        """Note that any message of a robot has arrived, at `now`, s."""
        self._robot(name).heard = now

    def expire(self, now: float, pose_wait: float) -> None:
        """Drop the waiting scans of every robot that was not heard for `pose_wait` seconds."""
        for name, robot in self._robots.items():
            if robot.waiting and now - robot.heard > pose_wait:
                self._give_up(name, robot)

    def finish(self) -> None:
        """Drop every waiting scan: no pose will come any more."""
        for name, robot in self._robots.items():
            self._give_up(name, robot)

    def _robot(self, name: str) -> _Robot:
        robot = self._robots.get(name)
        if robot is None:
            robot = self._robots[name] = _Robot()
        return robot

    @staticmethod
    def _is_duplicate(robot: _Robot, sensor: str, scan: Scan) -> bool:
        if scan.run == "":
            return False
        last = robot.last_seq.get((sensor, scan.run), -1)
        if scan.seq <= last:
            return True
        robot.last_seq[sensor, scan.run] = scan.seq
        return False

    def _limit_waiting(self, name: str, robot: _Robot, sensor: str) -> None:
        mine = [index for index, item in enumerate(robot.waiting) if item[0] == sensor]
        if len(mine) > MAX_WAITING:
            del robot.waiting[mine[0]]
            self._drop(name, sensor, "no_pose")

    def _give_up(self, name: str, robot: _Robot) -> None:
        waiting, robot.waiting = robot.waiting, []
        for sensor, _ in waiting:
            self._drop(name, sensor, "no_pose")

    def _place(self, name: str, robot: _Robot, sensor: str, scan: Scan) -> None:
        """Integrate a scan that is ready, whatever comes of it: never does it stay pending."""
        try:
            if scan.pose is None:
                self._place_by_poses(name, robot, sensor, scan)
            else:
                self._integrate(name, sensor, scan, scan.pose)
        except Exception:
            self._receipts.scan_dropped(name, sensor, "failed")
            raise

    def _place_by_poses(self, name: str, robot: _Robot, sensor: str, scan: Scan) -> None:
        """Integrate a scan whose poses have all arrived, at the base pose of its stamp."""
        if robot.poses.oldest is not None and scan.stamp < robot.poses.oldest:
            self._drop(name, sensor, "stale")
            return
        pose = robot.poses.at(scan.stamp)
        sweep = None if scan.time_increment == 0.0 else robot.poses.along(scan)
        if pose is None or (sweep is None and scan.time_increment != 0.0):
            self._drop(name, sensor, "no_pose")
        else:
            self._integrate(name, sensor, scan, pose, sweep)

    def _integrate(self, name: str, sensor: str, scan: Scan, base: Pose, sweep: Sweep | None = None) -> None:
        try:
            self._sink.integrate(scan, base.compose(scan.mount), sweep)
        except ScanRefused as refusal:
            self._drop(name, sensor, cast(DropReason, refusal.slug), str(refusal))
        else:
            self._receipts.scan_integrated(name, sensor)

    def _drop(self, name: str, sensor: str, reason: DropReason, why: str = "") -> None:
        self._receipts.scan_dropped(name, sensor, reason)
        self._complain(f"{name}/{sensor}", f"a scan is dropped: {why or _WHY[reason]}")


def _ready_at(scan: Scan) -> int:
    """Stamp that a pose must have reached before the scan can be placed, ns."""
    return max(scan.stamp, scan.end_stamp)
