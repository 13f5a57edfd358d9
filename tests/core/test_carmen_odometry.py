"""CARMEN logs whose ODOM lines are the poses, and where their laser sits on the robot."""

import math
import os
import re
from dataclasses import replace
from pathlib import Path

import pytest

from log_lines import POSE, SCAN, flaser, line, odom, parsed, robotlaser
from ogm_core.errors import BadRecording, BadSetting
from ogm_core.logs.carmen import CarmenLog
from ogm_core.logs.carmen_mount import mount_of_laser
from ogm_core.logs.recordings import RecordedPose, RecordedScan, RecordingReader
from ogm_core.types import IDENTITY, Pose, PoseStamped

DATASETS = os.environ.get("OGM_DATASETS")
MOUNT = Pose(0.2, -0.1, 0.3)
OFFSET = b"PARAM robot_frontlaser_offset 0.25 1071078718.5 host 1071078718.5"


def text(pose):
    return " ".join(f"{value:.6f}" for value in pose)


def drive(*, mount=MOUNT, corrected=IDENTITY, form=flaser):
    """Lines of a robot that turns once on a circle of 3 m, an ODOM line before each of 20 sweeps.

    `corrected` is what SLAM has added to the laser's pose by each further sweep.
    """
    lines = []
    for k in range(20):
        angle = math.tau * k / 20
        robot = Pose(3.0 * math.cos(angle), 3.0 * math.sin(angle), math.remainder(angle + 2.0, math.tau))
        laser = robot.compose(mount)
        theta = math.remainder(laser.theta + k * corrected.theta, math.tau)
        laser = Pose(laser.x + k * corrected.x, laser.y + k * corrected.y, theta)
        poses = {"pose": text(laser), "odometry" if form is flaser else "robot": text(robot)}
        lines += [odom(text(robot), ipc_time=k), form([1] * 180, ipc_time=k + 0.5, **poses)]
    return lines


def mount(*lines, **options):
    return mount_of_laser(lines, CarmenLog(mount=IDENTITY, **options))


def assert_near(pose, expected):
    assert pose == pytest.approx(expected, abs=1e-5)


@pytest.fixture
def saved(tmp_path):
    """Saves lines under a name."""

    def save(name, *lines):
        path = tmp_path / name
        path.write_bytes(b"\n".join(lines))
        return path

    return save


def test_an_odom_line_is_a_pose_of_the_robot():
    messages, complaints = parsed(CarmenLog(mount=IDENTITY).parse_line, odom("1.5 -2 0.25", ipc_time=7.25))
    assert complaints == []
    assert messages == [RecordedPose("robot1", PoseStamped(7_250_000_000, Pose(1.5, -2.0, 0.25)))]


@pytest.mark.parametrize("form", [flaser, robotlaser])
def test_then_a_sweep_carries_its_mount_and_no_pose(form):
    plain, log = CarmenLog(), CarmenLog(mount=MOUNT)
    [expected], _ = parsed(plain.parse_line, odom(), form([1] * 180))
    [_, scan], _ = parsed(log.parse_line, odom(), form([1] * 180))
    assert (scan.message.pose, scan.message.mount) == (None, MOUNT)
    assert expected.message.pose == Pose(1.5, -2.5, 0.25)
    ranges = expected.message.ranges
    assert repr(replace(scan.message, ranges=ranges)) == repr(
        replace(expected.message, pose=None, mount=MOUNT)
    )
    assert (plain.unread, log.unread) == ({"ODOM": 1}, {})


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (b"ODOM", "10 fields are needed, got 1"),
        (odom() + b" 1", "10 fields are needed, got 11"),
        (odom(speed="0 0"), "10 fields are needed, got 9"),
        (odom("1 2 x"), "theta: a number is needed, got b'x'"),
        (odom("nan 2 3"), "x: a finite number is needed, got nan"),
        (odom("1 inf 3"), "y: a finite number"),
        (odom(speed="0 0 fast"), "acceleration: a number"),
        (odom(ipc_time="-1"), "stamp: 0 to"),
        (odom(ipc_time="nan"), "ipc_time: a finite number"),
    ],
)
def test_a_malformed_odom_line_names_its_field_where_it_is_read(bad, reason):
    messages, [(number, said)] = parsed(CarmenLog(mount=IDENTITY).parse_line, odom(), bad, odom())
    assert (len(messages), number) == (2, 2)
    assert re.match(f"ODOM: {reason}", said), said
    assert parsed(CarmenLog().parse_line, bad) == ([], [])


def test_speeds_may_be_any_float():
    messages, complaints = parsed(CarmenLog(mount=IDENTITY).parse_line, odom(speed="nan inf -1"))
    assert (len(messages), complaints) == (1, [])


@pytest.mark.parametrize("form", [flaser, robotlaser])
def test_the_mount_is_what_all_sweeps_say(form):
    assert_near(mount(*drive(form=form)), MOUNT)
    assert_near(mount(OFFSET, *drive(form=form)), MOUNT)
    assert mount(OFFSET, *drive(mount=IDENTITY, form=form)) == IDENTITY


def test_the_mounts_heading_is_the_shorter_arc():
    lines = [flaser([1] * 180, pose="0 0 -3.1", odometry="0 0 3.1"), odom()]
    assert_near(mount(*lines), (0.0, 0.0, math.tau - 6.2))


@pytest.mark.parametrize("drift", [Pose(0.001, 0.0, 0.0), Pose(0.0, -0.001, 0.0), Pose(0.0, 0.0, 0.001)])
def test_poses_of_two_frames_say_nothing_and_the_parameter_does(drift):
    lines = drive(corrected=drift)
    assert mount(OFFSET, *lines) == Pose(0.25, 0.0, 0.0)
    side = b"PARAM robot_frontlaser_side_offset -0.1 0 h 0"
    angle = b"PARAM robot_frontlaser_angular_offset 0.5 0 h 0"
    later = b"PARAM robot_frontlaser_offset 9 0 h 0"
    assert mount(*lines[:9], angle, side, OFFSET, later, *lines[9:]) == Pose(0.25, -0.1, 0.5)
    with pytest.raises(BadSetting, match=r"where the laser sits .* no PARAM robot_frontlaser_offset$"):
        mount(side, *lines)


@pytest.mark.parametrize("value", [b"", b" front", b" nan"])
def test_a_parameter_without_a_number_is_none(value):
    with pytest.raises(BadSetting, match="no PARAM robot_frontlaser_offset"):
        mount(b"PARAM robot_frontlaser_offset" + value, *drive(corrected=Pose(0.1, 0.0, 0.0)))


def test_six_digits_far_from_the_origin_are_one_frame():
    far = Pose(99_990.0, 100.0, 0.0)
    lines = []
    for k in range(50):
        robot = far.compose(Pose(k * 0.1, k * 0.2, k * 0.1))
        written = [" ".join(f"{v:.7g}" for v in pose) for pose in (robot.compose(MOUNT), robot)]
        lines += [odom(), flaser([1] * 180, pose=written[0], odometry=written[1])]
    assert mount(*lines)[:2] == pytest.approx(MOUNT[:2], abs=0.01)


@pytest.mark.parametrize("robot", ["nan 0 0", "0 0 inf", "1e308 0 1e308"])
def test_a_robot_pose_that_is_not_finite_is_of_no_frame(robot):
    strange = flaser([1] * 180, odometry=robot)
    for lines in ([strange, *drive()], [*drive(), strange]):
        assert mount(OFFSET, *lines) == Pose(0.25, 0.0, 0.0)


def test_one_sweep_of_another_frame_is_enough():
    lines = drive()
    lines[9] = drive(mount=Pose(0.2, -0.12, 0.3))[9]
    assert mount(OFFSET, *lines) == Pose(0.25, 0.0, 0.0)


def test_malformed_sweeps_say_nothing_of_the_mount():
    cut = flaser([1] * 180, pose="9 9 9", odometry="0 0 0").replace(b" 32.9068 ", b" ")
    assert_near(mount(cut, *drive(), b"garbage"), MOUNT)
    silent = [robotlaser([1] * 180, setup="0 0 0 1 0 0 0", pose="0 1 0", robot="0 0 0"), odom()]
    assert_near(mount(*silent, range_max=8.0), (0.0, 1.0, 0.0))


def test_a_log_without_odom_lines_is_refused():
    sweeps = [text for text in drive() if not text.startswith(b"ODOM")]
    with pytest.raises(BadSetting, match=r"^--odometry: no ODOM line to take poses from; leave it out"):
        mount(*sweeps)
    with pytest.raises(BadSetting, match=r"its ODOM lines are malformed \(ODOM: 10 fields are needed, got 2"):
        mount(b"ODOM 1", b"ODOM", *sweeps)


def test_a_reader_takes_poses_from_odom_lines_if_asked(saved):
    path = saved("log.log", b"SYNC a", *drive(), b"RLASER 1", b"ODOM 5")
    with RecordingReader(path, odometry=True, robot="r2", range_max=20.0) as reader:
        assert reader.position == 0
        messages = list(reader)
    assert (reader.scans, reader.poses, reader.malformed, reader.not_read) == (20, 20, 1, "1 RLASER")
    assert [type(message) for message in messages] == [RecordedPose, RecordedScan] * 20
    assert {message.robot for message in messages} == {"r2"}
    pose, scan = messages[2].message, messages[3].message
    assert_near(
        pose.pose, (3.0 * math.cos(0.1 * math.pi), 3.0 * math.sin(0.1 * math.pi), 2.0 + 0.1 * math.pi)
    )
    assert (pose.stamp, scan.stamp, scan.pose, scan.range_max) == (10**9, 1_500_000_000, None, 20.0)
    assert_near(scan.mount, MOUNT)
    with RecordingReader(path) as reader:
        own = [message.message.pose for message in reader]
    assert (reader.scans, reader.poses, reader.malformed) == (20, 0, 0)
    assert_near(pose.pose.compose(scan.mount), own[1])


def test_a_reader_refuses_what_has_no_odometry_before_the_first_message(saved):
    sweeps = [text for text in drive() if not text.startswith(b"ODOM")]
    refused = {
        saved("sweeps.log", *sweeps): "--odometry: no ODOM line",
        saved("corrected.clf", *drive(corrected=Pose(0.1, 0.0, 0.0))): "--odometry: where the laser sits",
        saved("log.jsonl", line(POSE), line(SCAN)): "--odometry is for CARMEN logs",
    }
    for path, complaint in refused.items():
        reader = RecordingReader(path, odometry=True)
        with pytest.raises(BadRecording, match=rf"{path.name}: {complaint}"):
            reader.__enter__()
        with pytest.raises(ValueError, match="inside its `with`"):
            next(iter(reader))


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([odom(), odom()], "holds no scan, only 2 poses$"),
        ([b"RLASER 1"], "holds no scan; found are 1 RLASER"),
    ],
)
def test_a_log_without_a_sweep_holds_no_scan(saved, lines, said):
    with (
        RecordingReader(saved("poses.log", *lines), odometry=True) as reader,
        pytest.raises(BadRecording, match=said),
    ):
        list(reader)


@pytest.mark.skipif(DATASETS is None, reason="OGM_DATASETS does not name the folder of recorded logs")
@pytest.mark.parametrize(
    ("name", "scans", "poses", "malformed"),
    [
        ("intel/intel-corrected.log.gz", 910, 14541, 0),
        ("freiburg-079/freiburg-079-corrected.log.gz", 4791, 9724, 1),
    ],
)
def test_recorded_buildings_give_their_odometry(name, scans, poses, malformed):
    """In both every sweep's two poses are one; Freiburg's parameter of -0.04 m is not what was corrected."""
    with RecordingReader(Path(DATASETS) / name, odometry=True) as reader:
        mounts = {message.message.mount for message in reader if isinstance(message, RecordedScan)}
    assert mounts == {IDENTITY}
    assert (reader.scans, reader.poses, reader.malformed) == (scans, poses, malformed)
