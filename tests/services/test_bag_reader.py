"""Bags as logs: whose poses and scans are in them, and what is said of those that make no map."""

import logging
import shutil
from dataclasses import fields, replace
from types import SimpleNamespace

import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin

import turtlebot4
from bag_files import Said, at, drive, edge, mount, scan, tf, write_bag
from bag_files import read_bag as read
from gateway_desk import MS, Listed
from ogm_core.errors import BadRecording
from ogm_core.logs.recorded import RecordedPose, RecordedScan
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.ros2.topics import Topic
from ogm_core.types import Pose
from ogm_services.ros2.account import Account
from ogm_services.ros2.bag_reader import BagOptions
from ogm_services.ros2.gateway import Gateway, NamedSource
from ogm_services.ros2.options import Ros2Options
from ogm_services.ros2.robots import Robots
from ogm_services.runtime.limited_log import LimitedLog
from whole_bags import ros1


def as_told(found):
    """Messages without the names of robots and runs, which differ between a bag and a network."""
    told = []
    for each in found:
        message = each.message
        if isinstance(each, RecordedScan):
            named = {field.name: getattr(message, field.name) for field in fields(message)}
            told.append((each.sensor, named | {"run": "", "ranges": message.ranges.tobytes()}))
        else:
            told.append(("pose", replace(message, run="")))
    return told


@pytest.mark.parametrize("kind", ["rosbag2_sqlite3", "rosbag2_mcap"])
def test_a_real_robots_bag_says_what_the_robot_says(datasets, kind, monkeypatch):
    """The same scans and poses, byte for byte, as `ogm ros2` makes of the messages."""
    monkeypatch.setattr("ogm_services.ros2.tf_poses.MAP_WAIT", 0.0)
    options = Ros2Options(scan_delay=turtlebot4.DELAY)
    live = []

    def publisher(name):
        return SimpleNamespace(
            robot=name,
            run="live",
            put_pose=lambda message: live.append(RecordedPose(name, message)),
            put_scan=lambda sensor, message: live.append(RecordedScan(name, sensor, message)),
        )

    types = {"/scan": "sensor_msgs/msg/LaserScan"}
    topics = [Topic("dds", name, types.get(name, "tf2_msgs/msg/TFMessage")) for name in turtlebot4.TOPICS]
    source = Listed(*topics)
    account = Account(LimitedLog(logging.getLogger("test")))
    robots = Robots(publisher, (), "map", account)
    work = Gateway([NamedSource(source, "robot1")], robots, account, options, SensorRules(), 0.5)
    work.look()
    work.look()
    takes = dict(zip(source.names, source.taking, strict=True))
    for message in turtlebot4.messages(datasets):
        takes[message.topic](message.payload)
        work.step(0.0)

    bag = read(turtlebot4.folder(datasets) / kind, BagOptions(options))
    assert len(bag.scans) == turtlebot4.SCANS
    assert bag.reader.scans == turtlebot4.SCANS
    assert as_told(bag.found) == as_told(live)
    assert "there is no map frame: its poses are odometry" in bag.reader.doubt


def test_a_scan_waits_for_its_pose_and_its_mount_is_that_of_tf(tmp_path):
    bag = read(write_bag(tmp_path / "bag", [mount(), *drive()]))
    assert [pose.stamp for pose in bag.poses] == [at(n) for n in range(1, 7)]
    assert [pose.pose.x for pose in bag.poses] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    assert [each.message.stamp for each in bag.scans] == [at(n) - 50 * MS for n in range(2, 7)]
    assert bag.scans[0].message.mount == pytest.approx(Pose(0.2, 0.0, 0.5))
    assert {each.robot for each in bag.found} == {"robot1"}
    assert bag.scans[0].sensor == "scan"
    assert (bag.reader.malformed, bag.reader.not_read) == (0, "")


def test_the_last_static_transform_holds_from_the_begin_on(tmp_path):
    """Even if it comes after all else, and was written hours before or after."""
    said = [mount(), *drive(), mount(time=at(900), x=0.7)]
    assert {each.message.mount.x for each in read(write_bag(tmp_path / "bag", said)).scans} == {0.7}


def test_stamps_of_transforms_that_step_back(tmp_path):
    """By 0.3 ms, as two threads of a driver make them: such a pose is passed over, and no scan is lost."""
    said = [mount()]
    for n in range(1, 7):
        stamp = at(n)
        said.append(tf(stamp, edge(stamp, "odom", "base_link", stamp / 1e9, 0.0, 0.0)))
        back = stamp - 300_000
        said.append(tf(stamp + 1, edge(back, "odom", "base_link", back / 1e9, 0.0, 0.0)))
        said.append(scan(stamp - 50 * MS, time=stamp + 2))
    bag = read(write_bag(tmp_path / "bag", said))
    stamps = [pose.stamp for pose in bag.poses]
    assert stamps == sorted(stamps)
    assert {at(n) for n in range(1, 7)} <= set(stamps)
    assert [pose.pose.x for pose in bag.poses] == pytest.approx([stamp / 1e9 for stamp in stamps])
    assert len(bag.scans) == 6


def test_a_map_frame_that_comes_late_is_waited_for(tmp_path):
    """Poses are in the map from its first transform on; scans before it are told of."""
    late = tf(at(4), edge(at(4), "map", "odom", 10.0, 0.0, 0.0))
    later = tf(at(7), edge(at(7), "map", "odom", 10.0, 0.0, 0.0))
    said = sorted([mount(), *drive(), late, later], key=lambda message: message.time)
    bag = read(write_bag(tmp_path / "bag", said))
    assert [pose.pose.x for pose in bag.poses] == pytest.approx([10.4, 10.5, 10.6])


def test_the_fixed_frame_is_chosen(tmp_path):
    corrected = tf(at(0), edge(at(0), "map", "odom", 10.0, 0.0, 0.0))
    again = tf(at(7), edge(at(7), "map", "odom", 10.0, 0.0, 0.0))
    bag = write_bag(tmp_path / "bag", [corrected, mount(), *drive(), again])
    odometry = read(bag, BagOptions(fixed_frame="odom"))
    assert odometry.poses[0].pose.x == pytest.approx(0.1)
    with pytest.raises(BadRecording, match=r"--fixed-frame hall: .*there are base_link, laser, map, odom"):
        read(bag, BagOptions(fixed_frame="hall"))


def test_of_several_scans_the_wanted_ones_are_asked_for(tmp_path):
    said = [mount(), *drive(), scan(at(5), topic="/rear", time=at(6))]
    bag = write_bag(tmp_path / "bag", said)
    with pytest.raises(BadRecording, match=r"say which to map by --scan-topic: /rear \(1\), /scan \(5\)"):
        read(bag)
    assert {each.sensor for each in read(bag, BagOptions(scan_topics=("/rear",))).scans} == {"rear"}
    assert {each.sensor for each in read(bag, BagOptions(scan_topics=("*",))).scans} == {"rear", "scan"}
    with pytest.raises(BadRecording, match=r"--scan-topic /front: .*there are /rear \(1\), /scan \(5\)"):
        read(bag, BagOptions(scan_topics=("/front",)))


def test_a_laser_that_tf_does_not_know_is_mounted_by_hand(tmp_path):
    bag = write_bag(tmp_path / "bag", list(drive(frame="lidar")))
    with pytest.raises(BadRecording, match="no tf says where lidar is; there are base_link, odom; --mount"):
        read(bag)
    mounted = read(bag, BagOptions(Ros2Options(mount=Pose(0.3, 0.1, -1.0))))
    assert {each.message.mount for each in mounted.scans} == {Pose(0.3, 0.1, -1.0)}
    assert len(mounted.scans) == 5


def test_stamps_are_those_of_headers(tmp_path):
    """When a message was written orders messages, and tells nothing else."""
    said = [message._replace(time=number * 7) for number, message in enumerate([mount(), *drive()])]
    bag = read(write_bag(tmp_path / "bag", said))
    assert [each.message.stamp for each in bag.scans] == [at(n) - 50 * MS for n in range(2, 7)]


def test_damaged_messages_are_counted(tmp_path):
    said = [mount(), *drive(), Said("/scan", at(9), b"\0\1\0\0no scan")]
    bag = read(write_bag(tmp_path / "bag", said))
    assert (bag.reader.malformed, bag.reader.scans, len(bag.scans)) == (1, 6, 5)
    (complaint,) = bag.reader.complaints
    assert complaint.startswith("/scan: payload: 11 bytes are not a sensor_msgs/msg/LaserScan: ")
    assert "bad_cdr" not in bag.reader.not_read + bag.reader.doubt


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_data_files_are_read_alone(tmp_path, plugin):
    whole = write_bag(tmp_path / "drive.bag", [mount(), *drive()], plugin)
    expected = as_told(read(whole).found)
    (data,) = [each for each in whole.iterdir() if each.name != "metadata.yaml"]
    assert as_told(read(data).found) == expected
    (whole / "metadata.yaml").unlink()
    without = read(whole)
    assert as_told(without.found) == expected
    assert "there is no metadata.yaml: its data files are read alone" in without.reader.doubt
    (whole / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 4")
    again = read(whole)
    assert as_told(again.found) == expected
    assert "metadata.yaml is of no use, its data files are read alone (ParserError: " in again.reader.doubt


def test_parts_of_a_split_bag_are_joined_in_their_order(tmp_path):
    said = [mount(), *drive(12)]
    expected = as_told(read(write_bag(tmp_path / "whole", said)).found)
    (tmp_path / "parts").mkdir()
    for number, part in {10: said[12:], 9: said[:12]}.items():
        write_bag(tmp_path / f"{number}", part)
        (data,) = (tmp_path / f"{number}").glob("*.db3")
        shutil.move(data, tmp_path / "parts" / f"part_{number}.db3")
    assert as_told(read(tmp_path / "parts").found) == expected


def test_ros_1(tmp_path):
    """Its headers are longer, and tf was called tf/tfMessage once."""
    said = [mount(), *drive()]
    expected = as_told(read(write_bag(tmp_path / "two", said)).found)
    assert as_told(read(ros1(tmp_path / "drive.bag", said)).found) == expected
    for packing in Writer1.CompressionFormat:
        assert as_told(read(ros1(tmp_path / f"{packing.name}.bag", said, packing)).found) == expected


def test_what_is_no_bag_is_told_in_a_line(tmp_path):
    whole = write_bag(tmp_path / "bag", [mount(), *drive()])
    (data,) = whole.glob("*.db3")
    content = data.read_bytes()
    cases = {
        "head.db3": (content[:8192], "a database that was cut short before its first message"),
        "pieces.db3": (content[:4096] + b"\xff" * (len(content) - 4096), "damaged"),
        "text.bag": (b"no bag at all", "no bag, in spite of its name: it begins with b'no bag a'"),
        "empty.mcap": (b"", "empty, holds no scan"),
        "old.bag": (b"#ROSBAG V1.2\n" + bytes(100), "of a kind that is not read"),
        "cut.bag": (b"#ROSBAG V2.0\n" + bytes(10), "of a kind that is not read"),
        "drive.bag": (content, "by its content, but not by its name: rename it to drive.db3"),
    }
    for name, (held, why) in cases.items():
        (tmp_path / name).write_bytes(held)
        with pytest.raises(BadRecording, match=why) as refused:
            read(tmp_path / name)
        assert "\n" not in str(refused.value)
    (tmp_path / "folder.bag").mkdir()
    with pytest.raises(BadRecording, match="a folder, and no bag: give a log or a bag that is in it"):
        read(tmp_path / "folder.bag")
