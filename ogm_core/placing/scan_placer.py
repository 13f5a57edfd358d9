"""Pose lookup and order of scans, as tf's message filter does: from messages to the map."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from ogm_core.placing import reasons
from ogm_core.placing.decided import Decided
from ogm_core.placing.hints import Hints
from ogm_core.placing.other_robots import OtherRobots
from ogm_core.placing.outcomes import Outcomes
from ogm_core.placing.placement import Placement, ScanSink, is_ready
from ogm_core.placing.receipts import Receipts, Whose
from ogm_core.placing.robot import Robot
from ogm_core.placing.robot_poses import Verdict
from ogm_core.placing.robots import Complain, Robots
from ogm_core.placing.rules import DEFAULT_RULES, PlacingRules
from ogm_core.placing.source import Source
from ogm_core.placing.state import PlacingState
from ogm_core.placing.waiting import NO_LIMITS, Waiting, WaitingLimits
from ogm_core.placing.waiting_room import WaitingRoom
from ogm_core.types import PlacedScan, Pose, PoseStamped, Scan

ROBOTS = "robots"
"""Source of complaints about robots of which nothing is kept, be they ever so many."""

_NOTHING: Mapping[str, int] = MappingProxyType({})
RECENT_NS = 10_000_000_000
"""A robot whose newest stamp is older than another's by no more than that has been heard of lately."""


class ScanPlacer:
    """Places scans by their robots' poses and hands them on in the order in which they become ready.

    One thread calls it. No decision reads a clock: times of arrival, `now`, are told, and matter to `expire`
    alone. The same messages in the same order give the same calls to the sink. What becomes of a robot's scan
    depends on that robot's messages alone, unless `other_robots` are skipped.

    An error that the sink does not mean, a bug, is counted as its scan's `failed` and raised to the caller,
    once every other scan that was ready is placed.
    """

    def __init__(
        self,
        sink: ScanSink,
        receipts: Receipts,
        complain: Complain,
        rules: PlacingRules = DEFAULT_RULES,
        hints: Hints | None = None,
        integrated: Callable[[float], None] = lambda _: None,
        limits: WaitingLimits = NO_LIMITS,
        stopping: Callable[[], bool] = lambda: False,
        robots_limit: float = math.inf,
        other_robots: OtherRobots | None = None,
        placed: Callable[[str, str, Scan, Pose], None] = lambda *_: None,
        whose: Callable[[PlacedScan], Whose] | None = None,
        sink_of: Callable[[str], ScanSink] | None = None,
    ) -> None:
        """`integrated` is told, of every scan that the sink has taken, when it was handed to the placer.

        `sink_of` a robot takes its scans in place of `sink`, which takes those of all.
        `placed`: its robot, its sensor, the scan as it was taken, and the sensor's pose in the map.
        `limits` of the scans that wait for poses. Once `stopping`, those that are ready stay waiting.
        `robots_limit`: bytes that poses, seqs and runs of all robots may hold. `other_robots` skips the beams
        that end at other robots. `whose` a scan is to count, where the map is cut into shares.
        """
        self._receipts = receipts
        self._complain = complain
        self._rules = rules
        self._hints = hints or Hints()
        self._robots = Robots(receipts, complain, rules, robots_limit)
        self.decided = Decided(self._robots)
        self._messages = 0
        self._limits = limits
        self._other_robots = other_robots if other_robots is not None and other_robots.rules else None
        self._outcomes = Outcomes(receipts, self._robots, complain)
        self._placement = Placement(
            *(sink_of or (lambda _: sink), self._robots, self._outcomes, self._hints, integrated),
            *(self._other_robots, placed, whose),
        )
        self._waiting = WaitingRoom(
            self._robots, self._outcomes, self._placement, rules.pose_wait, limits, stopping
        )

    @property
    def waiting_bytes(self) -> int:
        """What scans hold that wait for poses. Any thread."""
        return self._robots.waiting.nbytes

    @property
    def robots_bytes(self) -> int:
        """What the poses of all robots, and the seqs and runs of their scans, hold. Any thread."""
        return self._robots.held.nbytes

    def recent_robots(self) -> list[str]:
        """The robots whose newest stamps are within RECENT_NS of the newest of all."""
        newest = {name: stamp for name, robot in self._robots.items() if (stamp := robot.poses.newest)}
        last = max(newest.values(), default=0)
        return [name for name, stamp in newest.items() if last - stamp <= RECENT_NS]

    def add_pose(self, name: str, message: PoseStamped, now: float = 0.0) -> None:
        """Take a robot's pose, and place every scan that it makes ready."""
        self._messages += 1
        if self.decided.skipped:
            self._take_skipped(now)
        robot = self._robots.touched(name, now, self._messages)
        if robot is None:
            self._receipts.pose_noted("refused")
            self._complain(ROBOTS, *reasons.too_many_robots(name))
            return
        robot.seqs.note(message.run, message.seq)
        poses = robot.poses
        stepped = next((source.name for source in robot.sources.values() if source.step_at is not None), "")
        verdict = poses.add(message, stepped=stepped, released=poses.owner in robot.gone)
        self._robots.keep_within_limit()
        if verdict.note is not None:
            self._receipts.pose_noted(verdict.note)
        if verdict.reason is not None:
            self._complain(f"{name}/pose", *verdict.reason)
        if not verdict.taken:
            return
        if self._other_robots is not None:
            self._other_robots.moved(name)
        robot.pose_heard = now
        if verdict.began is not None:
            self._begin(name, robot, verdict)
        if poses.history.newest == message.stamp:
            self._receipts.located(name, message.stamp, message.pose)
        for source in robot.sources.values():
            source.holds = False
        if robot.waiting:
            self._waiting.look_again(name, robot)

    def add_scan(self, name: str, sensor: str, scan: Scan, now: float = 0.0) -> None:
        """Take a robot's scan: place it if its pose is known, else let it wait."""
        self._messages += 1
        if self.decided.skipped:
            self._take_skipped(now)
        robot = self._robots.touched(name, now, self._messages)
        if robot is None:
            self._outcomes.refuse(name, sensor, ROBOTS, reasons.too_many_robots(name))
            return
        source = robot.source(sensor)
        if source is None:
            self._outcomes.refuse(name, sensor, name, reasons.too_many_sensors(sensor))
            return
        self._receipts.scan_taken(name, sensor, scan.run, scan.seq)
        source.last = scan.run, scan.seq
        for hint in self._hints.look(source.name, scan):
            self._outcomes.hint(name, sensor, hint)
        expected = robot.take_expected(sensor, scan) if robot.expected else None
        if expected is not None:
            item = Waiting(sensor, scan, expected.number, now, self._limits.cells_of(scan))
            self._waiting.add(name, robot, source, item)
            return
        if source.seen(scan):
            self._outcomes.drop(
                name, sensor, "duplicate", reasons.RENUMBERED if source.repeats(scan) else reasons.SEEN
            )
            return
        if scan.pose is not None:
            self._number(source, scan)
            self._receipts.located(name, scan.stamp, scan.pose)
            self._placement.place(name, robot, sensor, scan, now)
            return
        self._add_without_pose(name, robot, source, sensor, scan, now)

    def _add_without_pose(
        self, name: str, robot: Robot, source: Source, sensor: str, scan: Scan, now: float
    ) -> None:
        """Take a new scan that does not say where it was taken: its robot's poses have to."""
        owner = self._replaced_by(robot, source, scan.run)
        if owner is not None:
            self._number(source, scan)
            self._outcomes.drop(name, sensor, "superseded", reasons.superseded_scan(scan.run, owner))
            return
        back = source.take(scan, self._messages, robot.poses.histories)
        self._number(source, scan)
        if back:
            self._complain(f"{name}/{sensor}", *reasons.sensor_clock_went_back(back))
            self._waiting.give_up(name, robot, reasons.STEPPED, lambda item: item.sensor == sensor)
            robot.forget_expected(lambda item: item.sensor == sensor)
        if not source.holds and is_ready(robot, scan):
            self._placement.place(name, robot, sensor, scan, now)
            return
        item = Waiting(sensor, scan, self._messages, now, self._limits.cells_of(scan))
        self._waiting.add(name, robot, source, item)

    def robot_here(self, name: str, run: str, now: float = 0.0) -> None:
        """Note that the liveliness token of a robot's run is there."""
        robot = self._robots.touched(name, now, self._messages)
        if robot is None:
            self._complain(ROBOTS, *reasons.too_many_robots(name))
            return
        robot.gone.pop(run, None)
        self._receipts.robot_alive(name, run, True, now)

    def robot_gone(self, name: str, run: str, now: float = 0.0) -> None:
        """Note that the token of a robot's run is no more: a run that it has replaced may own again."""
        robot = self._robots.get(name)
        if robot is not None:
            robot.told = None
            robot.note_gone(run)
        self._receipts.robot_alive(name, run, False, now)

    def expire(self, now: float) -> None:
        """Drop every scan that has waited for longer than a scan may, as has its robot for a pose.

        Robots that are gone for long are forgotten.
        """
        self._take_skipped(now)
        wait = self._rules.pose_wait
        for name, robot in self._robots.items():
            waited = max(robot.pose_heard, self.decided.waits_until(name))
            if robot.waiting and now - max(waited, robot.waiting.first.handed) > wait:
                why = self._waiting.why_none(name, robot, reasons.waited(wait))
                self._waiting.give_up(name, robot, why, lambda item: now - item.handed > wait)
        for name in self._receipts.gone(now):
            self._forget(name, now)

    def state(self) -> PlacingState:
        """All that decides where later messages go, but for scans that wait; see `ogm_core.placing.state`.

        Nothing of it changes any more. Of robots that have not changed it is the same as before.
        """
        self._take_skipped()
        return self._robots.state(self._messages)

    @property
    def outcomes_of_gone(self) -> Mapping[str, int]:
        """What became of scans of robots that were forgotten; goes with a state."""
        return self._robots.outcomes_of_gone

    def restore(
        self, state: PlacingState, now: float = 0.0, *, outcomes_of_gone: Mapping[str, int] = _NOTHING
    ) -> None:
        """Go on from a state, in a placer that has had no message: scans that waited are expected again.

        Robots that are too many are left out.
        """
        self._messages = self._robots.restore(state, outcomes_of_gone, now)
        if self._other_robots is not None:
            for name in state:
                self._other_robots.moved(name)

    def _take_skipped(self, now: float | None = None) -> None:
        """Take the messages for decided that will never come."""
        for skipped in self.decided.taken():
            robot = self._robots.touched(skipped.robot, now, self._messages)
            if robot is not None:
                robot.skip(skipped)

    def _forget(self, name: str, now: float) -> None:
        """Forget a robot that is gone: should it come back, all begins anew for it."""
        robot = self._robots.get(name)
        if robot is not None and robot.waiting:
            self._waiting.give_up(name, robot, self._waiting.why_none(name, robot, reasons.FORGOTTEN))
        if self._receipts.forget(name, now) and robot is not None:
            self._robots.forget(name)
            if self._other_robots is not None:
                self._other_robots.forget(name)
            for source in robot.sources.values():
                self._hints.forget(source.name)

    def finish(self) -> None:
        """Drop every waiting scan: no pose will come any more."""
        for name, robot in self._robots.items():
            self._waiting.give_up(name, robot, self._waiting.why_none(name, robot, reasons.LOG_ENDED))

    def _number(self, source: Source, scan: Scan) -> None:
        """Note the seq of a scan, which may make its robot hold more."""
        source.number(scan)
        self._robots.keep_within_limit()

    @staticmethod
    def _replaced_by(robot: Robot, source: Source, run: str) -> str | None:
        """The run that has replaced a scan's run as its robot's or its source's; None if none has."""
        if run in robot.poses.replaced:
            return robot.poses.owner
        if run in source.replaced and source.run not in robot.gone:
            return source.run
        return None

    def _begin(self, name: str, robot: Robot, verdict: Verdict) -> None:
        """Drop what waits for poses of the history that has ended."""
        owner, sources = robot.poses.owner, robot.sources

        def is_of_before(run: str, sensor: str, number: int) -> bool:
            if verdict.new_owner:
                return run != owner
            step_at = sources[sensor].step_at
            return step_at is None or number < step_at

        self._waiting.give_up(
            *(name, robot, reasons.began_anew(verdict.began or "")),
            lambda item: is_of_before(item.scan.run, item.sensor, item.number),
        )
        robot.forget_expected(lambda item: is_of_before(item.run, item.sensor, item.number))
        for source in sources.values():
            source.step_at = None
