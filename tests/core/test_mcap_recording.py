"""MCAP recordings: every value comes back to the last bit, in file order; others read them; cut ones, too."""

import io
import math
import struct

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import naive_cdr
from ogm_core.errors import BadCdr, BadMessage, BadRecording
from ogm_core.ros2 import cdr
from ogm_core.ros2 import recording_messages as own
from ogm_core.ros2.mcap_reading import McapRecords, is_recording, is_whole, robot_and_sensor
from ogm_core.ros2.mcap_recording import McapWriter
from ogm_core.ros2.topics import TYPE_HASHES
from ogm_core.types import Pose, PoseStamped, Scan

RNG = np.random.default_rng(15)
ODD = (0.1, -math.pi, 1e-300, 5e-324, 1.7976931348623157e308)
"""Numbers that float32 does not hold."""


def ranges(beams):
    values = RNG.uniform(0.0, 9.0, beams).astype(np.float32)
    values[1::7], values[2::7], values[3::7] = np.inf, np.nan, -0.0
    return values


def scan(stamp=2**63 - 1, beams=8, seq=7, run="run-1", **fields):
    numbers = {"angle_min": -0.1, "angle_increment": -1e-3, "range_min": 0.1, "range_max": 8.1}
    return Scan(stamp=stamp, ranges=ranges(beams), seq=seq, run=run, **{**numbers, **fields})


def assert_same(one, other):
    for name in Scan.__slots__:
        if name != "ranges":
            assert getattr(one, name) == getattr(other, name), name
    assert one.ranges.tobytes() == other.ranges.tobytes()


@pytest.mark.parametrize("run", ["", "a", "runs-of.any_length"])
def test_a_pose_is_written_number_by_number_as_ros2_does(run):
    message = PoseStamped(2**63 - 1, Pose(0.1, -1e-300, 5e-324), 2**62, run)
    assert own.encode_pose(message) == naive_cdr.ogm_pose(
        message.stamp, message.seq, run, message.pose
    ).replace(b"\xee", b"\0")
    assert own.decode_pose(naive_cdr.ogm_pose(message.stamp, message.seq, run, message.pose)) == message


@pytest.mark.parametrize("pose", [None, Pose(1.5, -0.1, 1e300)])
@pytest.mark.parametrize("beams", [1, 2, 1081])
def test_a_scan_is_written_number_by_number_as_ros2_does(pose, beams):
    said = scan(beams=beams, pose=pose, mount=Pose(0.3, 0.1, -2.9), time_increment=1e-5)
    numbers = (said.angle_min, said.angle_increment, said.time_increment, said.range_min, said.range_max)
    naive = naive_cdr.ogm_scan(
        said.stamp, said.seq, said.run, numbers, said.mount, pose or (), said.ranges.tolist()
    )
    read = own.decode_scan(naive)
    assert_same(read, said)
    assert not read.ranges.flags.writeable
    assert_same(own.decode_scan(own.encode_scan(said)), said)
    assert len(own.encode_scan(said)) == len(naive)


def test_what_is_no_message_of_ours_is_refused():
    whole = own.encode_scan(scan())
    for damaged in (b"", whole[:4], whole[:-1], whole + bytes(8)):
        with pytest.raises(BadCdr):
            own.decode_scan(damaged)
    with pytest.raises(BadMessage, match="stamp"):
        own.decode_pose(naive_cdr.ogm_pose(-1, 0, "", (0.0, 0.0, 0.0)))
    with pytest.raises(BadMessage, match="x: a finite"):
        own.decode_pose(naive_cdr.ogm_pose(1, 0, "", (math.inf, 0.0, 0.0)))
    with pytest.raises(BadMessage, match="pose"):
        own.decode_scan(naive_cdr.ogm_scan(0, 0, "", (0.0, 1.0, 0.0, 0.0, 1.0), (0, 0, 0), (1.0,), [1.0]))
    with pytest.raises(BadMessage, match="ranges: 1 to 3 beams"):
        own.decode_scan(whole, max_beams=3)


def test_the_hashes_of_our_types_are_those_that_rosbags_computes():
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in own.DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
        assert store.hash_rihs01(name) == own.TYPE_HASHES[name]


def test_viewers_see_a_scan_where_it_was_taken():
    said = scan(10**18 + 5, time_increment=1e-4, angle_min=1e300)
    read = cdr.decode_laser_scan(own.encode_laser_scan(said, "r/laser"))
    assert (read.stamp, read.frame) == (10**18 + 5, "r/laser")
    assert read.angle_min == math.inf  # no float32 is nearer
    assert read.angle_increment == np.float32(-1e-3)
    assert (read.range_min, read.range_max) == (np.float32(0.1), np.float32(8.1))
    assert read.time_increment == np.float32(1e-4)
    assert read.ranges.tobytes() == said.ranges.tobytes()
    (edge,) = cdr.decode_tf_message(own.encode_transforms(7, (("map", "r/base_link", Pose(1.0, 2.0, 3.0)),)))
    assert (edge.stamp, edge.parent, edge.child) == (7, "map", "r/base_link")
    assert edge.transform[:3] == (1.0, 2.0, 0.0)
    assert edge.transform.planar() == pytest.approx((1.0, 2.0, 3.0))


def written(file, count=12, flush_every=1):
    """Messages of two robots, one of them with a name that is none in ROS 2; what was written, in order."""
    writer, said = McapWriter(file), []
    for n in range(count):
        pose = PoseStamped(n, Pose(n * 0.1, 1.0, n * 0.3), n, "a")
        swept = scan(n, beams=20, seq=n, mount=Pose(0.2, 0.0, 0.5), pose=Pose(*ODD[:3]) if n % 2 else None)
        writer.pose("1st.robot", pose, 1000 - n)
        writer.scan("b", "la-ser", swept, 1000 - n)
        said += [("1st.robot", None, pose), ("b", "la-ser", swept)]
        if n % flush_every == 0:
            writer.flush()
    return writer, said


def read(file):
    records = McapRecords(file)
    decoders = {own.POSE: own.decode_pose, own.SCAN: own.decode_scan}
    return records, [
        (*robot_and_sensor(each), decoders[each.type](each.payload))
        for each in records
        if each.type in decoders
    ]


def assert_all_same(found, said):
    assert [each[:2] for each in found] == [each[:2] for each in said]
    for (_, sensor, one), (_, _, other) in zip(found, said, strict=True):
        if sensor is None:
            assert one == other
        else:
            assert_same(one, other)


def test_a_recording_is_read_back_in_file_order():
    file = io.BytesIO()
    writer, said = written(file)
    grid = cdr.OccupancyGrid(5, "map", 0.05, (1.0, 2.0), np.array([[0, 100, -1]], np.int8))
    writer.map(grid, 5)
    writer.finish()
    assert is_recording(file)
    assert is_whole(file)
    records, found = read(file)
    assert records.whole
    assert_all_same(found, said)


def test_rosbags_and_mcap_read_a_recording(tmp_path):
    """Times never go back, so that who sorts by them keeps the order."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer, said = written(file)
        writer.map(cdr.OccupancyGrid(5, "map", 0.5, (1.0, 2.0), np.array([[0, 100, -1]], np.int8)), 5)
        writer.finish()
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in own.DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    with Reader(path) as reader:
        kinds = {each.topic: each.msgtype for each in reader.connections}
        messages = [
            (each.topic, store.deserialize_cdr(raw, each.msgtype)) for each, _, raw in reader.messages()
        ]
    assert kinds == {
        "/ogm/robots/_1st_robot/pose": own.POSE,
        "/ogm/robots/b/scan/la_ser": own.SCAN,
        "/b/la_ser": cdr.LASER_SCAN,
        "/tf": cdr.TF_MESSAGE,
        "/map": cdr.OCCUPANCY_GRID,
    }
    scans = [each for topic, each in messages if topic == "/ogm/robots/b/scan/la_ser"]
    assert [each.seq for each in scans] == list(range(12))
    assert [each.ranges.tobytes() for each in scans] == [each.ranges.tobytes() for _, s, each in said if s]
    assert [tuple(each.pose) for each in scans] == [(), ODD[:3]] * 6
    assert messages[-1][1].data.tolist() == [0, 100, -1]
    (laser,) = {each.header.frame_id for topic, each in messages if topic == "/b/la_ser"}
    edges = [each for topic, tf in messages if topic == "/tf" for each in tf.transforms]
    assert {(each.header.frame_id, each.child_frame_id) for each in edges} == {
        ("map", "1st.robot/base_link"),
        ("map", "b/base_link"),
        ("b/base_link", laser),
    }
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary.statistics.message_count == len(messages)
    assert {each.metadata["topic_type_hash"] for each in summary.channels.values()} == {
        *own.TYPE_HASHES.values(),
        *(TYPE_HASHES[kind] for kind in (cdr.LASER_SCAN, cdr.TF_MESSAGE, cdr.OCCUPANCY_GRID)),
    }
    assert {each.metadata["offered_qos_profiles"] for each in summary.channels.values()} == {""}


def test_names_that_ros2_does_not_tell_apart_have_topics_of_their_own():
    file = io.BytesIO()
    writer = McapWriter(file)
    for robot in ("a.b", "a-b", "a_b"):
        writer.scan(robot, "base_link", scan(1), 1)
    writer.finish()
    records = list(McapRecords(file))
    ours = [each for each in records if each.type == own.SCAN]
    assert [robot_and_sensor(each)[0] for each in ours] == ["a.b", "a-b", "a_b"]
    assert len({each.topic for each in ours}) == 3
    assert len({each.topic for each in records if each.type == cdr.LASER_SCAN}) == 3
    frames = [cdr.decode_tf_message(each.payload) for each in records if each.type == cdr.TF_MESSAGE]
    assert all(edge.parent != edge.child for edges in frames for edge in edges)
    # Whoever copies a recording may leave out what we say of a channel.
    assert [robot_and_sensor(each._replace(metadata={})) for each in ours] == [
        (robot, "base_link") for robot in ("a_b", "a_b_2", "a_b_3")
    ]


def test_a_recording_that_is_cut_anywhere_is_read_up_to_the_chunk_before():
    file = io.BytesIO()
    writer, said = written(file, flush_every=3)
    writer.flush()
    before = len(file.getvalue())
    writer.finish()
    whole = file.getvalue()
    counts = []
    for size in [*range(8, len(whole), 97), before, len(whole) - 1]:
        part = io.BytesIO(whole[:size])
        records, found = read(part)
        assert not records.whole
        assert records.read <= size
        assert_all_same(found, said[: len(found)])
        assert is_recording(part) == bool(found)
        counts.append(len(found))
    assert set(counts) == {0, 2, 8, 14, 20, 24}
    assert counts[-1] == 24
    records, found = read(io.BytesIO(whole[:before] + bytes(4096)))  # as file systems leave it without power
    assert (records.whole, records.read, len(found)) == (False, before, 24)


def test_of_a_chunk_that_is_cut_what_it_holds_is_read():
    """It takes more than a block of zstd, 128 KiB."""
    file = io.BytesIO()
    writer = McapWriter(file)
    said = [("b", "s", scan(n, beams=1000, seq=n)) for n in range(200)]
    for robot, sensor, each in said:
        writer.scan(robot, sensor, each, each.stamp)
    writer.flush()
    part = io.BytesIO(file.getvalue()[: len(file.getvalue()) // 2])
    records, found = read(part)
    assert not records.whole
    assert 50 < len(found) < 150
    assert_all_same(found, said[: len(found)])
    assert is_recording(part)


def test_a_flipped_byte_is_told():
    file = io.BytesIO()
    writer, _ = written(file)
    writer.finish()
    content = bytearray(file.getvalue())
    content[len(content) // 3] ^= 0x10
    with pytest.raises(BadRecording, match="is damaged"):
        list(McapRecords(io.BytesIO(bytes(content))))


def test_bags_of_others_are_no_recordings():
    for content in (b"", b"#ROSBAG V2.0", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + struct.pack("<BQ", 1, 10**9)):
        assert not is_recording(io.BytesIO(content))
