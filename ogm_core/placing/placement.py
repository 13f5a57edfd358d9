"""Placement of a scan whose poses have come: its pose is found, other robots are skipped, the map gets it."""

from collections.abc import Callable
from typing import Protocol, cast

from ogm_core.errors import ScanRefused, Stale
from ogm_core.placing import reasons
from ogm_core.placing.hints import Hint, Hints
from ogm_core.placing.other_robots import OtherRobots
from ogm_core.placing.outcomes import Outcomes
from ogm_core.placing.reasons import Reason
from ogm_core.placing.receipts import DropReason, Whose
from ogm_core.placing.robot import Robot
from ogm_core.placing.robots import Robots
from ogm_core.types import PlacedScan, Pose, Scan, Sweep

_NO_HINTS: tuple[Hint, ...] = ()


class ScanSink(Protocol):
    """Where placed scans go: an `OccupancyGrid`, or something that stands in for one."""

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Take a scan at its sensor's pose in the map frame; raise ScanRefused to refuse it.

        `sweep`: the sensor's pose at every beam, where beams were taken one after the other.
        """
        ...


class Placement:
    """Hands scans to the sink, each at the pose that its robot's history tells."""

    def __init__(
        self,
        sink_of: Callable[[str], ScanSink],
        robots: Robots,
        outcomes: Outcomes,
        hints: Hints,
        integrated: Callable[[float], None],
        other_robots: OtherRobots | None,
        placed: Callable[[str, str, Scan, Pose], None] = lambda *_: None,
        whose: Callable[[PlacedScan], Whose] | None = None,
    ) -> None:
        """`sink_of` a robot: where its scans go.

        `integrated` is told, of each scan that the sink has taken, when it was handed to the placer, s.

        `placed`: its robot, its sensor, the scan as it was taken, and the sensor's pose at its stamp. Where
        the map is cut into shares, `whose` says if a scan is this one's to count.
        """
        self._sink_of = sink_of
        self._robots = robots
        self._outcomes = outcomes
        self._hints = hints
        self._integrated = integrated
        self._other_robots = other_robots
        self._placed = placed
        self._whose = whose

    def place(self, name: str, robot: Robot, sensor: str, scan: Scan, handed: float) -> None:
        """Integrate a scan that is ready, whatever comes of it: never does it stay pending."""
        whose: Whose = "home"
        try:
            base, sweep = _pose_of(robot, scan)
            placed = PlacedScan(scan, base.compose(scan.mount), sweep)
            if self._whose is not None:
                whose = self._whose(placed)
            skipped, told = 0, _NO_HINTS
            if self._other_robots is not None:
                scan, skipped, told = self._other_robots.without(name, robot, self._robots.get, placed)
            self._sink_of(name).integrate(scan, placed.pose, sweep)
        except ScanRefused as refusal:
            self._refused(name, sensor, refusal, whose)
        except Exception:
            self._failed(name, sensor, whose)
            raise
        else:
            self._integrated(handed)
            if whose != "home":
                self._outcomes.of_others(name, sensor, whose)
                return
            self._outcomes.integrated(name, sensor, skipped)
            self._placed(name, sensor, scan, placed.pose)
            for hint in told:
                self._outcomes.hint(name, sensor, hint)
            for hint in self._hints.placed(robot.sources[sensor].name, scan, placed.pose):
                self._outcomes.hint(name, sensor, hint)

    def _refused(self, name: str, sensor: str, refusal: ScanRefused, whose: Whose) -> None:
        """Count a scan that the map does not take; it is told of where it is counted, or missing."""
        why = Reason(refusal.kind, str(refusal))
        if whose == "home":
            self._outcomes.drop(name, sensor, cast(DropReason, refusal.slug), why)
        elif refusal.by_memory:
            self._outcomes.drop_of_others(name, sensor, why)
        else:
            self._outcomes.of_others(name, sensor, whose)

    def _failed(self, name: str, sensor: str, whose: Whose) -> None:
        """Count a scan that a bug keeps out of the map."""
        if whose == "home":
            self._outcomes.failed(name, sensor)
        else:
            self._outcomes.of_others(name, sensor, "border_dropped")


def is_ready(robot: Robot, scan: Scan) -> bool:
    """Whether it can be told where a scan was taken, or that it never can be: it is of before all poses."""
    history = robot.poses.history
    newest, oldest = history.newest, history.oldest
    if newest is None or oldest is None:
        return False
    return max(scan.stamp, scan.end_stamp) <= newest or scan.stamp < oldest


def _pose_of(robot: Robot, scan: Scan) -> tuple[Pose, Sweep | None]:
    """Base pose of a scan whose poses have all arrived; sensor poses of its beams if they differ in time.

    Raises:
        NoPose: the poses do not tell.
        Stale: they begin later.
    """
    if scan.pose is not None:
        return scan.pose, None
    history = robot.poses.history
    if scan.stamp < cast(int, history.oldest):
        raise Stale(reasons.stale(cast(int, history.oldest) - scan.stamp).text)
    sweep = None if scan.time_increment == 0.0 else history.along(scan)
    return history.at(scan.stamp), sweep
