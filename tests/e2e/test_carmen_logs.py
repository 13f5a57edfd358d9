"""CARMEN logs on the command line: both forms of a laser's lines, ODOM lines as poses, what is not read."""

import math

import numpy as np
import pytest

from log_lines import robotlaser
from ogm_core.logs.recordings import RecordedScan, RecordingReader
from ogm_core.types import Pose

MOUNT = Pose(0.4, -0.3, 0.8)


def digits(pose):
    return " ".join(map(repr, pose))


def behind(laser):
    """Where the robot is whose laser, at MOUNT, is here."""
    theta = laser.theta - MOUNT.theta
    c, s = math.cos(theta), math.sin(theta)
    return Pose(laser.x - c * MOUNT.x + s * MOUNT.y, laser.y - s * MOUNT.x - c * MOUNT.y, theta)


@pytest.fixture(scope="module")
def carmen_log(module_ogm, lab_recording):
    """The lab's lap as CARMEN would have logged it, with the laser at the robot's front right corner."""
    with RecordingReader(lab_recording) as messages:
        lap = list(messages)
    poses = {message.message.stamp: message.message.pose for message in lap if not is_scan(message)}
    lines = [b"# CARMEN Logfile", b"PARAM robot_frontlaser_offset 7 0 host 0"]
    for scan in (message.message for message in lap if is_scan(message)):
        laser = poses[scan.stamp]
        robot, time = digits(behind(laser)), repr(scan.stamp / 1e9)
        lines += [f"ODOM {robot} 0 0 0 {time} host 0".encode(), b"RLASER 1 2 3"]
        setup = f"0 {scan.angle_min!r} 6.28 {scan.angle_increment!r} {scan.range_max} 0.02 0"
        sweep = {"setup": setup, "pose": digits(laser), "robot": robot, "ipc_time": time}
        lines.append(robotlaser(scan.ranges.tolist(), **sweep))
    path = module_ogm.folder / "lap.log"
    path.write_bytes(b"\n".join(lines))
    return path


def is_scan(message):
    return isinstance(message, RecordedScan)


@pytest.fixture(scope="module")
def maps(module_ogm, carmen_log, lab_recording):
    """Maps by name: of the recording, and of the CARMEN log by its laser's poses and by its ODOM lines."""
    builds = {
        "recorded": module_ogm.call("build", lab_recording, "--out", "recorded"),
        "laser": module_ogm.call("build", carmen_log, "--out", "laser"),
        "odometry": module_ogm.call("build", carmen_log, "--odometry", "--out", "odometry"),
    }
    for name, ended in builds.items():
        assert (ended.code, ended.err) == (0, "")
        assert f"{name}: 220 scans read, 220 integrated" in ended.out
        assert ended.out.endswith("\n" if name == "recorded" else ", not read: 220 RLASER\n")
    return {name: module_ogm.map(f"{name}/map.npz") for name in builds}


def test_a_robotlaser_log_gives_the_map_of_the_recording(maps, assert_equal_maps):
    assert_equal_maps(maps["recorded"], maps["laser"])


def test_odometry_and_mount_put_the_laser_where_it_was(maps):
    """Up to rounding, which moves a few end points over a cell's edge."""
    laser, odometry = maps["laser"], maps["odometry"]
    np.testing.assert_array_equal(laser["offset"], odometry["offset"])
    same = np.isclose(laser["log_odds"], odometry["log_odds"], equal_nan=True)
    assert np.mean(same) > 0.999


def test_a_replay_by_odometry_gives_the_map_of_the_build(module_ogm, carmen_log, maps, assert_equal_maps):
    mapper = module_ogm.ready(module_ogm.mapper())
    flags = ("--odometry", "--robot", "r7", "--speed", "max", "--connect", mapper.endpoint)
    ended = module_ogm.call("replay", carmen_log, *flags)
    assert (ended.code, ended.err) == (0, "")
    assert ended.out.endswith("220 scans sent, 220 integrated, not read: 220 RLASER\n")
    assert_equal_maps(mapper.map(), maps["odometry"])
    poses = mapper.status()["poses"]
    assert {kind: count for kind, count in poses.items() if count} == {"received": 220}


def test_what_gives_no_map_is_said_and_nothing_is_written(ogm, carmen_log, lab_recording):
    kinds = {"sweeps.log": b"ODOM", "poses.log": b"ROBOTLASER1"}
    for name, left_out in kinds.items():
        lines = [line for line in carmen_log.read_bytes().splitlines() if not line.startswith(left_out)]
        (ogm.folder / name).write_bytes(b"\n".join(lines))
    out = ("--out", "built")
    commands = {
        "sweeps.log: --odometry: no ODOM line to take": ogm.call("build", "sweeps.log", "--odometry", *out),
        f"{lab_recording}: --odometry is for CARMEN": ogm.call("replay", lab_recording, "--odometry"),
        "poses.log: holds no scan; found are 220 ODOM, 220 RLASER": ogm.call("build", "poses.log", *out),
    }
    for complaint, ended in commands.items():
        assert ended.complaint(2).startswith(f"ogm: {complaint}")
    assert not (ogm.folder / "built").exists()
