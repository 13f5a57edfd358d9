"""A recording of several robots with everything in it that a mapper has to cope with (docs/protocol.md).

The robots drive round the lab for 6 s. Poses come every 20 ms, scans every 50 ms at other times, so that
nearly every scan's pose is interpolated, and each scan comes before the pose that makes it ready.
"""

from collections import Counter
from dataclasses import replace

import numpy as np

from ogm_core.logs.recordings import RecordedPose, RecordedScan, write_jsonl
from ogm_core.simulation.catalogue import world_named
from ogm_core.simulation.lidar import Lidar, measure
from ogm_core.simulation.trajectories import CirclePath
from ogm_core.types import IDENTITY, Pose, PoseStamped, Scan

MS = 1_000_000
LAB = world_named("lab")
PATH = CirclePath(0.0, 0.0, 6.0, 11_000)  # a pose for every ms of a lap
LIDAR = Lidar(beams=90, fov=2 * np.pi, range_max=8.0, noise=0.02)
SCANS = range(13, 6000, 50)
POSES = range(0, 6000, 20)
DUPLICATES, LATE, STALE, WITHOUT_POSES = 7, 5, 30, 70


class Drive:
    """One robot's messages as (time of sending in ms, message)."""

    def __init__(self, robot, *, start=0, run="first", mount=IDENTITY):
        self._robot, self._run, self._mount = robot, run, mount
        self._start = start
        self._noise = np.random.default_rng([start, len(run)])
        self.sent = []

    def pose_at(self, ms):
        """Where the robot's base is."""
        return PATH.pose(self._start + ms)

    def poses(self, times, **changes):
        """Poses, sent when they are taken."""
        for seq, ms in enumerate(times):
            message = PoseStamped(ms * MS, self.pose_at(ms), seq, self._run)
            self.sent.append((ms, RecordedPose(self._robot, replace(message, **changes))))
        return self

    def scans(self, times, *, own_pose=False, sensor="laser", delay=0):
        """Scans, sent `delay` ms after they are taken; with `own_pose` they carry it."""
        for seq, ms in enumerate(times):
            base = self.pose_at(ms)
            scan = Scan(
                stamp=ms * MS,
                angle_min=LIDAR.angle_min,
                angle_increment=LIDAR.angle_increment,
                range_min=LIDAR.range_min,
                range_max=LIDAR.range_max,
                ranges=measure(LAB, base.compose(self._mount), LIDAR, self._noise),
                mount=self._mount,
                pose=base if own_pose else None,
                seq=seq,
                run=self._run,
            )
            self.sent.append((ms + delay, RecordedScan(self._robot, sensor, scan)))
        return self


def write_rough_log(path):
    """Write it; return (scans, what of them is dropped and why, late poses)."""
    drives = [
        Drive("plain").poses(POSES).scans(SCANS),
        Drive("mounted", start=2200, mount=Pose(0.3, -0.2, 2.0)).poses(POSES).scans(SCANS),
        # Poses 0.5 s apart say what lies between them, and not if they are farther apart.
        Drive("gaps", start=4400)
        .poses([ms for ms in POSES if not (2000 < ms < 2800 or 4000 < ms < 4520 or 5000 < ms < 5500)])
        .scans(SCANS),
        # Three scans wait for its first pose, which is of a later time; those of a second sensor come late.
        Drive("latecomer", start=6600)
        .poses(POSES[75:])
        .scans(SCANS[27:])
        .scans(SCANS[:STALE], sensor="rear", delay=3000),
        Drive("self-placed", start=8800, run="").scans(SCANS, own_pose=True),
        Drive("lost", start=100).scans(range(0, WITHOUT_POSES * 50, 50)),
    ]
    messages = [item for drive in drives for item in drive.sent]
    plain = drives[0].sent
    duplicates = [(ms + 1, scan) for ms, scan in plain if isinstance(scan, RecordedScan)][
        :: len(SCANS) // DUPLICATES
    ]
    late = [
        (ms + 400, replace(pose, message=replace(pose.message, pose=IDENTITY)))
        for ms, pose in plain[20 : 20 + LATE]
    ]
    messages += duplicates[:DUPLICATES] + late
    messages.sort(key=lambda item: item[0])
    # The first robot starts again, its clock at 0, while its last scan of before still waits for a pose.
    again = Drive("plain", start=5000, run="second").poses(POSES[:50]).scans(SCANS[:20])
    messages += sorted(again.sent, key=lambda item: item[0])
    write_jsonl(path, [message for _, message in messages])
    dropped = Counter(
        duplicate=DUPLICATES,
        stale=STALE + sum(ms < POSES[75] for ms in SCANS[27:]),
        no_pose=WITHOUT_POSES
        + sum(2000 < ms < 2800 or 4000 < ms < 4520 for ms in SCANS)
        + sum(ms > POSES[-1] for ms in SCANS) * 4  # plain, mounted, gaps, latecomer
        + sum(ms > POSES[49] for ms in SCANS[:20]),
    )
    return sum(isinstance(message, RecordedScan) for _, message in messages), dropped, LATE


def write_three_logs(folder):
    """Write logs in which robots have the same names, seqs, runs and clocks; return their paths."""
    paths = [folder / name for name in ("monday.jsonl", "tuesday.jsonl", "wednesday.jsonl")]
    write_rough_log(paths[0])
    for path, start, count in ((paths[1], 5000, 40), (paths[2], 9000, 25)):
        drive = Drive("plain", start=start, run="").poses(POSES).scans(SCANS[:count])
        write_jsonl(path, [message for _, message in sorted(drive.sent, key=lambda item: item[0])])
    return paths
