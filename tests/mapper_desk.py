"""A scan placer whose calls to its sink are recorded, and whose receipts are checked at every message."""

import logging
import math

import numpy as np

from ogm_core.placing.other_robots import OtherRobots
from ogm_core.placing.receipts import DROP_REASONS, Receipts
from ogm_core.placing.robot_rules import RobotRule, RobotRules
from ogm_core.placing.rules import PlacingRules
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.placing.waiting import NO_LIMITS
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_services.runtime.limited_log import LimitedLog

T0 = 1_700_000_000_000_000_000
MS = 1_000_000


def stamp_of(ms):
    """Stamp of a time in ms since T0."""
    return T0 + round(ms * MS)


class Sink:
    """Records what it is handed; refuses the scans whose seq is in `refusals`, by that error."""

    def __init__(self, refusals=None):
        self.placed = []
        self.scans = []
        self.sweeps = {}
        self.refusals = refusals or {}

    def integrate(self, scan, pose, sweep=None):
        if scan.seq in self.refusals:
            raise self.refusals[scan.seq]
        if sweep is not None:
            self.sweeps[scan.seq] = sweep
        self.placed.append((scan.seq, pose))
        self.scans.append(scan)
        return 0


class Desk:
    """A scan placer with a recording sink, its receipts checked at every message. Stamps count ms from T0."""

    def __init__(
        self,
        sink=None,
        limits=NO_LIMITS,
        stopping=lambda: False,
        robots_limit=math.inf,
        radii=(),
        mark_hits=None,
        **rules,
    ):
        """`radii` of robots, by globs on their names: what is seen of them is skipped, by `mark_hits`."""
        self.sink = sink or Sink()
        self.receipts = Receipts()
        self.log = LimitedLog(logging.getLogger(__name__))
        self.complaints = []
        """(source, kind, text), as they were made."""
        self.arrivals = []
        """When the scans came that were integrated, s."""
        self.placer = ScanPlacer(
            *(self.sink, self.receipts, self.complain, PlacingRules(**rules)),
            integrated=self.arrivals.append,
            limits=limits,
            stopping=stopping,
            robots_limit=robots_limit,
            other_robots=OtherRobots(
                RobotRules(RobotRule(*entry) for entry in dict(radii).items()), mark_hits, self._replaced
            ),
        )
        self._tags = {}
        self.now = 0.0
        """When messages arrive, s."""
        self.received = 0

    def complain(self, source, kind, text):
        self.complaints.append((source, kind, text))
        self.log.of_kind(source, kind, text)

    def pose(self, ms, pose=None, *, run="", seq=0, robot="r"):
        pose = Pose(ms / 1000, 0.0, 0.0) if pose is None else pose
        if self.receipts.pose_received(robot, self.now):
            self.placer.add_pose(robot, PoseStamped(stamp_of(ms), pose, seq, run), self.now)
        self.check()
        return self

    def scan(self, ms, *, seq=None, robot="r", sensor="s", beams=1, tag=None, **fields):
        """A scan; by default its seq is the number of scans before it."""
        seq = self.received if seq is None else seq
        fields = {"angle_increment": 0.1, "ranges": np.ones(beams, np.float32), **fields}
        scan = Scan(stamp_of(ms), 0.0, range_min=0.0, range_max=8.0, seq=seq, **fields)
        self.received += 1
        self._tags[scan] = tag
        if self.receipts.scan_received(robot, sensor, self.now):
            self.placer.add_scan(robot, sensor, scan, self.now)
        self.check()
        return self

    def check(self):
        """received = integrated + pending + dropped, and pending is what waits."""
        scans = self.receipts.status(since_start=True).scans
        assert scans.received == self.received
        assert scans.integrated == len(self.sink.placed)
        assert scans.pending == self.received - len(self.sink.placed) - sum(scans.dropped.values()) >= 0
        assert scans.pending == sum(len(robot.waiting) for robot in self.placer._robots.values())

    def _replaced(self, scan, without_robots):
        self._tags[without_robots] = self._tags.pop(scan)

    @property
    def order(self):
        """Seqs of the integrated scans."""
        return [seq for seq, _ in self.sink.placed]

    @property
    def tags(self):
        """What the integrated scans were tagged with."""
        return [self._tags[scan] for scan in self.sink.scans]

    @property
    def xs(self):
        """Where the scans were placed."""
        return [pose.x for _, pose in self.sink.placed]

    @property
    def dropped(self):
        """The reasons that any scan was dropped for, with counts."""
        counts = self.receipts.status().scans.dropped
        assert tuple(counts) == DROP_REASONS
        return {reason: count for reason, count in counts.items() if count}

    @property
    def pending(self):
        return self.receipts.status().scans.pending
