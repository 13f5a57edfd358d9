"""RecordingWriter: what it writes, by what reads recordings; what it refuses; what failures leave behind."""

import inspect
import threading

import numpy as np
import pytest

from full_disk import room_for
from ogm_client import OgmError, RecordingWriter, RobotPublisher
from ogm_core.errors import BadMessage, BadRecording, BadSetting, DiskFull
from ogm_core.logs.recordings import RecordingReader
from ogm_core.types import Pose

LIDAR = {"angle_min": -1.0, "angle_increment": 0.5, "range_min": 0.1, "range_max": 8.0}
FINE = LIDAR | {"angle_increment": 0.01}


def read(path):
    """Messages of a recording, of which none is malformed."""
    with RecordingReader(path) as reader:
        messages = list(reader)
    assert reader.malformed == 0
    return messages


@pytest.mark.parametrize("name", ["log.jsonl", "log.jsonl.gz", "log.JSONL"])
def test_what_is_written_is_read_back(tmp_path, name):
    path = tmp_path / name
    with RecordingWriter(path, "r7", run="a") as recording:
        recording.write_pose(1.0, 2, np.float32(0.5), stamp=np.int64(7))
        recording.write_scan([1, np.inf, np.nan], **LIDAR, stamp=8, sensor="front")
        own = {"pose": (1, 2, 3), "mount": np.array([0.1, 0.2, 0.3]), "time_increment": 1e-4}
        recording.write_scan(np.array([0.1, 9.5]), **LIDAR, stamp=9, **own)
    pose, front, laser = read(path)
    assert (pose.robot, pose.message.pose) == ("r7", Pose(1.0, 2.0, 0.5))
    assert (pose.message.stamp, pose.message.seq, pose.message.run) == (7, 0, "a")
    assert (front.robot, front.sensor, laser.sensor) == ("r7", "front", "laser")
    np.testing.assert_array_equal(front.message.ranges, np.float32([1, np.inf, np.nan]))
    np.testing.assert_array_equal(laser.message.ranges, np.float32([0.1, 9.5]))
    assert {name: getattr(front.message, name) for name in LIDAR} == LIDAR
    assert (front.message.pose, laser.message.pose) == (None, Pose(1, 2, 3))
    assert (laser.message.mount, laser.message.time_increment) == (Pose(0.1, 0.2, 0.3), 1e-4)
    assert [message.message.run for message in (front, laser)] == ["a", "a"]


def test_its_arguments_are_those_of_the_publisher():
    for written, published in (("write_pose", "publish_pose"), ("write_scan", "publish_scan")):
        mine = dict(inspect.signature(getattr(RecordingWriter, written)).parameters)
        assert mine.pop("robot").default is None
        assert mine == dict(inspect.signature(getattr(RobotPublisher, published)).parameters)


def test_messages_are_counted_by_robot_and_sensor(tmp_path):
    path = tmp_path / "log.jsonl"
    with RecordingWriter(path) as recording:
        for robot in (None, "r2", None):
            recording.write_pose(0, 0, 0, robot=robot)
            recording.write_scan([1], **LIDAR, robot=robot)
        recording.write_scan([1], **LIDAR, sensor="rear")
    messages = read(path)
    assert [message.robot for message in messages] == ["robot1"] * 2 + ["r2"] * 2 + ["robot1"] * 3
    assert [message.message.seq for message in messages] == [0, 0, 0, 0, 1, 1, 0]
    assert len({message.message.run for message in messages}) == 1
    assert messages[0].message.run == recording.run


def test_a_stamp_that_is_left_out_is_now_and_each_recording_has_a_run_of_its_own(tmp_path):
    runs = set()
    for name in ("one.jsonl", "two.jsonl"):
        with RecordingWriter(tmp_path / name) as recording:
            recording.write_scan([1], **LIDAR)
            recording.write_scan([1], **LIDAR)
        first, second = (message.message for message in read(tmp_path / name))
        assert 1.7e18 < first.stamp <= second.stamp
        runs.add(first.run)
    assert len(runs) == 2


@pytest.mark.parametrize("name", ["log.jsonl", "log.jsonl.gz"])
def test_equal_messages_give_equal_files(tmp_path, name):
    contents = []
    for _ in range(2):
        with RecordingWriter(str(tmp_path / name), run="a") as recording:
            recording.write_scan([1, 2, 3], **LIDAR, stamp=5)
        contents.append((tmp_path / name).read_bytes())
    assert contents[0] == contents[1]


@pytest.mark.parametrize("ending", [KeyboardInterrupt, ValueError])
def test_whatever_ends_a_program_what_it_has_recorded_stays(tmp_path, ending):
    path = tmp_path / "log.jsonl.gz"

    def program():
        with RecordingWriter(path) as recording:
            recording.write_scan([1], **LIDAR)
            raise ending

    with pytest.raises(ending):
        program()
    assert len(read(path)) == 1
    assert list(tmp_path.iterdir()) == [path]


def test_the_file_takes_its_name_at_the_end(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_bytes(b"before")
    recording = RecordingWriter(path)
    recording.write_scan([1], **LIDAR)
    assert path.read_bytes() == b"before"
    recording.close()
    recording.close()
    assert len(read(path)) == 1
    with pytest.raises(BadRecording, match=r"log\.jsonl: the recording is closed"):
        recording.write_pose(0, 0, 0)


def test_what_a_mapper_would_refuse_is_not_written_and_not_counted(tmp_path):
    path = tmp_path / "log.jsonl"
    with RecordingWriter(path) as recording:
        refused = [
            (BadMessage, "x: a finite", lambda: recording.write_pose(np.nan, 0, 0)),
            (BadMessage, "pose.1.: a number", lambda: recording.write_pose(0, "1", 0)),
            (BadMessage, "stamp: 0 to", lambda: recording.write_pose(0, 0, 0, stamp=-1)),
            (BadMessage, "stamp: a whole", lambda: recording.write_pose(0, 0, 0, stamp=1.5)),
            (BadMessage, "ranges: 1 to", lambda: recording.write_scan([], **LIDAR)),
            (BadMessage, "range_min", lambda: recording.write_scan([1], **{**LIDAR, "range_max": 0.0})),
            (BadMessage, "mount: ", lambda: recording.write_scan([1], **LIDAR, mount=(1, 2))),
            (BadSetting, "sensor", lambda: recording.write_scan([1], **LIDAR, sensor="a/b")),
            (BadSetting, "robot", lambda: recording.write_scan([1], **LIDAR, robot="a/b")),
        ]
        for kind, said, write in refused:
            with pytest.raises(kind, match=said):
                write()
        recording.write_pose(0, 0, 0)
        recording.write_scan([1], **LIDAR)
    assert [message.message.seq for message in read(path)] == [0, 0]


@pytest.mark.parametrize(
    ("name", "changes", "said"),
    [
        ("log.json", {}, r"log\.json: recordings are written as \.jsonl or \.jsonl\.gz"),
        ("none/log.jsonl", {}, r"log\.jsonl: cannot be written \(No such file"),
        ("log.jsonl", {"robot": "a/b"}, "robot"),
        ("log.jsonl", {"run": "a/b"}, "run"),
    ],
)
def test_a_recording_that_cannot_be_is_refused_at_once(tmp_path, name, changes, said):
    with pytest.raises(OgmError, match=said):
        RecordingWriter(tmp_path / name, **changes)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["log.jsonl", "log.jsonl.gz"])
def test_a_full_disk_leaves_what_was_there_before(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"before")
    rng = np.random.default_rng(1)

    def record(scans):
        with RecordingWriter(path) as recording:
            for _ in range(scans):
                recording.write_scan(rng.random(400), **FINE)

    for scans in (2, 200):  # the room ends when the file is closed, or while it is written
        with room_for(1000), pytest.raises(DiskFull, match=f"{name}: cannot be written .File too large"):
            record(scans)
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_what_was_cut_off_by_a_full_disk_is_no_recording_when_there_is_room_again(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_bytes(b"before")
    recording = RecordingWriter(path)

    def fill_the_disk():
        for _ in range(200):
            recording.write_scan([1.5] * 400, **FINE)

    with room_for(1000), pytest.raises(DiskFull):
        fill_the_disk()
    with pytest.raises(BadRecording, match="the recording is closed"):
        recording.write_scan([1.5], **LIDAR)
    recording.close()
    assert path.read_bytes() == b"before"


def test_threads_may_write_at_once(tmp_path):
    path = tmp_path / "log.jsonl"
    with RecordingWriter(path) as recording:

        def write():
            for _ in range(100):
                recording.write_scan([1] * 50, **FINE)

        threads = [threading.Thread(target=write) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(60.0)
    assert [message.message.seq for message in read(path)] == list(range(400))
