"""The recorder on real sessions: what robots publish is in its file, in order and to the last bit."""

import io
import os
import re
from contextlib import contextmanager

import numpy as np
import pytest
import zenoh

from gateway_desk import Driver, all_heard
from ogm_client import RobotPublisher
from ogm_core.errors import BadInput, BadRecording, DiskFull
from ogm_core.logs.recorded import RecordedPose, RecordedScan
from ogm_core.placing.receipts import Receipts
from ogm_core.ros2 import mcap_recording
from ogm_core.ros2.mcap_reading import McapRecords
from ogm_core.ros2.mcap_recording import McapWriter
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_core.wire.keys import MapKeys
from ogm_services.commands import record as command
from ogm_services.recorder.message_sink import FLUSH_PERIOD, MessageSink
from ogm_services.recorder.new_file import check_new, new_file
from ogm_services.recorder.recorder import Recorder
from ogm_services.recorder.repair import repair_recording
from ogm_services.ros2.mcap_reader import McapReader
from ogm_services.settings.settings import Settings
from ros2_robots import RmwZenohRobot

KEYS = MapKeys("hall")
ZSTD = b"\x28\xb5\x2f\xfd"
"""What the content of a chunk begins with."""
SETTINGS = Settings.model_validate({"network": {"map_name": "hall"}})


def scan(stamp, seq, run="a", **fields):
    ranges = np.random.default_rng(stamp).uniform(0.5, 7.0, 40).astype(np.float32)
    return Scan(stamp, -1.0, 0.05, 0.1, 8.0, ranges, seq=seq, run=run, **fields)


def pose(stamp, seq, run="a"):
    return PoseStamped(stamp, Pose(0.1 * seq, -0.2, 0.01 * seq), seq, run)


def drive(count, begin=0):
    """Messages of a robot: poses and scans of two sensors, by turns."""
    for n in range(begin, begin + count):
        yield None, pose(1000 * n, n)
        yield "front", scan(1000 * n + 1, n, mount=Pose(0.3, 0.0, 0.1))
        if n % 3 == 0:
            yield "top", scan(1000 * n + 2, n // 3, pose=Pose(1.0, 0.1, n * 1e-9))


def put(robot, messages):
    for sensor, message in messages:
        if sensor is None:
            robot.put_pose(message)
        else:
            robot.put_scan(sensor, message)


def as_told(each):
    """A message by its values, ranges as bytes."""
    message = each.message
    if isinstance(each, RecordedPose):
        return each.robot, None, message
    fields = {name: getattr(message, name) for name in Scan.__slots__ if name != "ranges"}
    return each.robot, each.sensor, fields, message.ranges.tobytes()


def told(robot, messages):
    return [
        as_told(RecordedPose(robot, message) if sensor is None else RecordedScan(robot, sensor, message))
        for sensor, message in messages
    ]


def read(path):
    with McapReader(path) as reader:
        try:
            return [as_told(each) for each in reader]
        except BadRecording:  # as long as there is no scan
            return []


@contextmanager
def recording(session, path):
    """A recorder of a session; in the end its file is finished."""
    with new_file(path) as file:
        writer = McapWriter(file)
        with Recorder(session, SETTINGS, writer) as recorder:
            yield recorder
        writer.finish()


@pytest.fixture
def robot(network, eventually):
    """`robot(name, ...)`: a publisher on a session of its own that knows of who listens."""
    made = []

    def publisher(name="r", run="a", listened=True, **options):
        made.append(
            RobotPublisher(name, session=network(), map_name="hall", run=run, reliable=True, **options)
        )
        if listened:
            made[-1].wait_for_mapper(30.0)
        return made[-1]

    yield publisher
    for each in made:
        each.close()


def test_what_robots_publish_is_in_the_file_in_order(tmp_path, listener, robot, eventually):
    path, messages = tmp_path / "a.mcap", list(drive(30))
    with recording(listener, path) as recorder:
        one, other = robot(), robot("q.1", cache_samples=0)
        put(one, messages)
        put(other, messages)
        eventually(lambda: recorder.sink.scans == 80)
        assert recorder.counted() == "80 scans and 60 poses of q.1, r"
    found = read(path)
    assert len(found) == 2 * len(messages)
    for name in ("r", "q.1"):
        assert [each for each in found if each[0] == name] == told(name, messages)


def test_what_robots_published_before_comes_first(tmp_path, listener, robot, eventually):
    """As into a mapper that comes late: their caches have it."""
    path, messages = tmp_path / "a.mcap", list(drive(30))
    one = robot(listened=False)
    put(one, messages[:40])
    with recording(listener, path) as recorder:
        one.wait_for_mapper(30.0)
        put(one, messages[40:])
        eventually(lambda: recorder.sink.scans == 40)
    found, wanted = read(path), told("r", messages)
    assert len(found) == len(wanted)
    for sensor in (None, "front", "top"):
        assert [each for each in found if each[1] == sensor] == [each for each in wanted if each[1] == sensor]
    # A cache that is heard of late is not waited for, but no scan goes before the pose that it needs.
    for (sensor, _), pose, scan in zip(messages, wanted, wanted[1:], strict=False):
        assert sensor is not None or found.index(pose) < found.index(scan)


def test_a_robot_of_ros2_is_recorded_like_any_other(tmp_path, listener, gateway, network, eventually):
    """As `ogm ros2` sends it on."""
    path, driver = tmp_path / "a.mcap", Driver(RmwZenohRobot(network()))
    with recording(listener, path) as recorder:
        found = gateway()
        found.until(all_heard(driver))
        for n in range(10):
            driver.drive(n)
        found.until(lambda: recorder.sink.scans == 9)
        found.until(lambda: recorder.sink.poses == len(found.sent.poses["domain0"]))
    poses = [(None, message) for message in found.sent.poses["domain0"]]
    scans = [("scan", message) for message in found.sent.scans["domain0/scan"]]
    recorded = read(path)
    assert [each for each in recorded if each[1] is None] == told("domain0", poses)
    assert [each for each in recorded if each[1] == "scan"] == told("domain0", scans)


def test_messages_that_are_none_are_counted_and_left_out(tmp_path, listener, network, robot, eventually):
    path = tmp_path / "a.mcap"
    with recording(listener, path) as recorder:
        one, session = robot(), network()
        put(one, drive(2))
        eventually(lambda: recorder.sink.scans == 3)
        block = zenoh.CongestionControl.BLOCK
        session.put(KEYS.scan("bad", "s"), b"no scan", congestion_control=block)
        session.put(KEYS.pose("bad"), b"no pose", congestion_control=block)
        eventually(lambda: recorder.receipts.status().poses.malformed == 1)
        counts = "3 scans and 2 poses of r, 1 scans dropped: malformed, 1 poses malformed"
        assert recorder.counted() == counts
    assert read(path) == told("r", drive(2))


def test_what_came_can_be_read_half_a_second_later(tmp_path):
    file = (tmp_path / "a.mcap").open("xb")
    sink = MessageSink(McapWriter(file), Receipts(), lambda: 7)
    sink.flush(100.0)
    sink.add_scan("r", "s", scan(1, 0))
    sink.flush(100.0 + FLUSH_PERIOD - 0.01)
    assert read(tmp_path / "a.mcap") == []
    sink.flush(100.0 + FLUSH_PERIOD)
    assert read(tmp_path / "a.mcap") == told("r", [("s", scan(1, 0))])
    assert FLUSH_PERIOD == 0.5
    file.close()


def test_a_recorder_flushes_by_itself(tmp_path, listener, robot, eventually):
    path, messages = tmp_path / "a.mcap", list(drive(3))
    with recording(listener, path):
        put(robot(), messages)
        eventually(lambda: read(path) == told("r", messages))


def test_a_full_disk_ends_it_and_what_came_before_is_read():
    class Disk(io.BytesIO):
        room = 20_000

        def write(self, data):
            if self.tell() + len(data) > self.room:
                raise OSError(28, os.strerror(28))
            return super().write(data)

    disk = Disk()
    sink = MessageSink(McapWriter(disk), Receipts())
    count = 0
    while sink.failure is None and count < 1000:
        sink.add_scan("r", "s", scan(count, count))
        sink.flush()
        count += 1
    assert 20 < count < 1000
    sink.add_pose("r", pose(1, 1))
    sink.flush()
    assert (sink.scans, sink.poses, sink.failure.errno) == (count, 0, 28)
    assert sink.safe == (count - 1, 0)
    kept = [each for each in McapRecords(disk) if each.type == "ogm_msgs/msg/Scan"]
    assert len(kept) == count - 1
    failed = command._ended("a.mcap", "9 scans", sink.failure)
    assert isinstance(failed, DiskFull)
    assert "a.mcap: cannot be written any more: No space left on device; at least 9 scans can be r" in str(
        failed
    )


def test_a_disk_that_is_full_from_the_start_leaves_no_file_in_the_way(tmp_path):
    class Disk(io.BytesIO):
        def write(self, data):
            raise OSError(28, os.strerror(28))

    path = tmp_path / "a.mcap"
    path.touch()
    with pytest.raises(DiskFull, match=r"^-o .*a\.mcap: cannot be written: No space left on device$"):
        command._begun(path, Disk())
    assert not path.exists()


def test_a_recording_is_a_new_file(tmp_path):
    path = tmp_path / "a.mcap"
    check_new(path)
    assert not path.exists()
    path.write_bytes(b"before")
    for refused in (check_new, lambda path: new_file(path).__enter__()):
        with pytest.raises(BadInput, match=r"-o .*a\.mcap: is there already: give another name"):
            refused(path)
    assert path.read_bytes() == b"before"
    with pytest.raises(BadInput, match=r"end it in \.mcap"):
        check_new(tmp_path / "a.jsonl")
    with pytest.raises(BadInput, match="cannot be written: No such file"):
        check_new(tmp_path / "none" / "a.mcap")


def test_one_that_is_being_recorded_is_not_repaired(tmp_path):
    path = tmp_path / "a.mcap"
    with new_file(path) as file:
        McapWriter(file).flush()
        with pytest.raises(BadInput, match="is being recorded"):
            repair_recording(path)
    with pytest.raises(BadRecording, match="no message in it can be read; it stays"):
        repair_recording(path)


def cut_recording(path, count=20):
    with path.open("xb") as file:
        writer = McapWriter(file)
        for n in range(count):
            writer.pose("r", pose(10**9 * n, n), 10**9 * n)
            writer.scan("r", "s-1", scan(10**9 * n, n), 10**9 * n)
            writer.flush()
    return path


def test_a_cut_recording_is_made_whole_in_its_place(tmp_path):
    path = cut_recording(tmp_path / "a.mcap")
    os.truncate(path, path.stat().st_size - 400)
    path.chmod(0o640)
    before = read(path)
    assert len(before) == 38
    said = repair_recording(path)
    assert said.startswith(
        f"{path}: is whole again, with 95 messages (19 scans and 19 poses), the last of 1970-01-01 00:00:18"
    )
    assert re.search(r"; of its last \d+ bytes is kept what can be read$", said)
    assert path.stat().st_mode & 0o777 == 0o640
    assert read(path) == before
    with McapReader(path) as reader:
        assert len(list(reader)) == 38
        assert reader.doubt == ""
    content = path.read_bytes()
    assert (
        repair_recording(path)
        == f"{path}: is whole, with 95 messages (19 scans and 19 poses); it stays as it is"
    )
    assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


def test_damaged_chunks_are_left_out_and_counted(tmp_path):
    path = cut_recording(tmp_path / "a.mcap")
    before, content = read(path), bytearray(path.read_bytes())
    chunk = [each.start() for each in re.finditer(re.escape(ZSTD), content)][7]
    content[chunk + 100] ^= 1
    path.write_bytes(content)
    with pytest.raises(BadRecording, match="is damaged"), McapReader(path) as reader:
        list(reader)
    assert "; 1 damaged chunks are left out" in repair_recording(path)
    after = read(path)
    assert len(after) == 38
    assert [each for each in before if each in after] == after


def test_robots_that_have_no_channel_left_are_refused_and_the_others_go_on(tmp_path, monkeypatch, caplog):
    """MCAP numbers channels with 16 bits."""
    monkeypatch.setattr(mcap_recording, "MOST_CHANNELS", 5)  # a pose, tf, a scan and its twin, a pose
    receipts = Receipts()
    with (tmp_path / "a.mcap").open("xb") as file:
        writer = McapWriter(file)
        sink = MessageSink(writer, receipts, lambda: 7)
        for n in range(2):
            sink.add_pose("one", pose(n, n))
            sink.add_scan("one", "s", scan(n, n))
            sink.add_pose("two", pose(n, n))
            sink.add_scan("two", "s", scan(n, n))
            sink.add_pose("three", pose(n, n))
        writer.finish()
    assert (sink.scans, sink.poses, sink.robots, sink.failure) == (2, 4, {"one", "two"}, None)
    counts = receipts.status()
    assert (counts.scans.dropped["refused"], counts.poses.refused) == (2, 2)
    assert [each[0] for each in read(tmp_path / "a.mcap")] == ["one", "one", "two"] * 2
    assert "two/s has no place in the recording, which has 5 channels" in caplog.text


@pytest.mark.parametrize("finished", [False, True])
def test_messages_whose_description_is_damaged_are_counted_unless_the_summary_has_it(tmp_path, finished):
    """Types and channels are described in the chunk of their first message, and in the summary."""
    path = tmp_path / "a.mcap"
    with path.open("xb") as file:
        writer = McapWriter(file)
        for n in range(6):
            writer.pose("r", pose(10**9 * n, n), 10**9 * n)
            writer.flush()
        for n in range(6, 12):
            writer.scan("r", "s-1", scan(10**9 * n, n), 10**9 * n)
            writer.flush()
        if finished:
            writer.finish()
    before, content = read(path), bytearray(path.read_bytes())
    content[content.index(ZSTD) + 100] ^= 1
    path.write_bytes(content)
    said = repair_recording(path)
    assert "; 1 damaged chunks are left out" in said
    # Without a summary five poses, and of the transforms, whose first is damaged, five and six.
    assert ("; 16 messages whose description is damaged are left out" in said) != finished
    assert ("description" in said) != finished
    assert read(path) == before[1 if finished else 6 :]


def test_what_cannot_be_repaired_stays(tmp_path):
    path = tmp_path / "a.mcap"
    for content in (b"", b"{}", b"\x89MCAP0\r\n\0"):
        path.write_bytes(content)
        with pytest.raises(BadRecording):
            repair_recording(path)
        assert path.read_bytes() == content
    with pytest.raises(BadInput, match="cannot be repaired"):
        repair_recording(tmp_path / "none.mcap")
