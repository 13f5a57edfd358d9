"""Bags that were cut, mixed, compressed, or hold more than ROS: read as far as they are clear."""

import math
import shutil

import pytest
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

import mcap_bytes as mcap
from bag_files import STORE, at, drive, edge, mount, read_bag, scan, tf, write_bag
from ogm_core.errors import BadRecording
from ogm_core.ros2.bag_files import BagFile

SAID = [mount(), *drive(12)]


def by_hand(path, said=SAID, more=b"", profile="ros2", compression="zstd", convert=bytes):
    """A lone MCAP with a chunk for every message."""
    numbers = {topic: n for n, topic in enumerate(dict.fromkeys(each.topic for each in said), 1)}
    kinds = {each.topic: each.type for each in said}
    names = b"".join(
        mcap.schema(n, kinds[topic].replace("/msg/", "/") if profile == "ros1" else kinds[topic])
        + mcap.channel(n, n, topic, "ros1" if profile == "ros1" else "cdr")
        for topic, n in numbers.items()
    )
    chunks = [
        mcap.chunk(
            mcap.message(numbers[each.topic], each.time, convert(each.payload, each.type)), compression
        )
        for each in said
    ]
    path.write_bytes(mcap.whole(names + more, *chunks, profile=profile))
    return path


def plain(payload, _):
    return payload


def ros1(payload, kind):
    return bytes(STORE.cdr_to_ros1(payload, kind))


def as_read(path):
    return [(each.robot, each.message) for each in read_bag(path).found]


def seen(bag):
    """What can be compared of messages, whose ranges are arrays."""
    return [(each.message.stamp, getattr(each.message, "pose", None)) for each in bag.found]


def test_a_cut_mcap_is_a_bag_as_far_as_it_goes(tmp_path):
    whole = by_hand(tmp_path / "whole.mcap", convert=plain)
    expected = seen(read_bag(whole))
    data = whole.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    cut = read_bag(tmp_path / "cut.mcap")
    assert 6 < len(cut.found) < len(expected)
    assert seen(cut) == expected[: len(cut.found)]
    assert f"of {len(data) * 2 // 3} bytes" in cut.reader.doubt


def test_half_a_db3_is_a_bag_as_far_as_it_goes(tmp_path):
    """Whatever its indices, which may lie past its end, and in whichever order its messages were written."""
    said = [*SAID[13:], *SAID[:13]]
    whole = write_bag(tmp_path / "whole", [mount(), *drive(400)])
    (data,) = whole.glob("*.db3")
    expected, content = seen(read_bag(whole)), data.read_bytes()
    for share in (0.3, 0.6, 0.9):
        size = int(len(content) * share)
        (tmp_path / "half.db3").write_bytes(content[:size])
        half = read_bag(tmp_path / "half.db3")
        assert len(expected) * (share - 0.25) < len(half.found) < len(expected) * (share + 0.1)
        assert seen(half) == expected[: len(half.found)]
        assert f"messages, {size} of {len(content)} bytes" in half.reader.doubt
    (data,) = write_bag(tmp_path / "mixed", said + [mount()] * 99).glob("*.db3")
    (tmp_path / "mixed.db3").write_bytes(data.read_bytes()[:-4096])
    assert seen(read_bag(tmp_path / "mixed.db3")) == seen(read_bag(tmp_path / "mixed"))


def test_the_last_part_of_a_split_bag_may_be_cut(tmp_path):
    """As of a robot that lost its power while it recorded: no metadata.yaml, no end."""
    folder = tmp_path / "bag"
    folder.mkdir()
    by_hand(folder / "bag_0.mcap", SAID[:13], convert=plain)
    last = by_hand(folder / "bag_1.mcap", SAID[13:], convert=plain)
    last.write_bytes(last.read_bytes()[:-200])
    found = read_bag(folder)
    assert len(found.scans) >= 9
    assert "there is no metadata.yaml: its data files are read alone" in found.reader.doubt
    assert "bag_1.mcap was cut short" in found.reader.doubt


def test_channels_that_are_not_of_ros_are_passed_over_and_named(tmp_path):
    more = mcap.schema(90, "foxglove.LaserScan") + mcap.channel(90, 90, "/scan_json", "json")
    more += mcap.message(90, 5, b"{}") * 3 + mcap.channel(91, 0, "/imu", "protobuf")
    expected = seen(read_bag(by_hand(tmp_path / "ros.mcap", convert=plain)))
    mixed = read_bag(by_hand(tmp_path / "mixed.mcap", more=more, convert=plain))
    assert seen(mixed) == expected
    assert "not read, as they are no messages of ROS: /imu (0, protobuf), /scan_json (3, json)" in (
        mixed.reader.doubt
    )
    with BagFile(tmp_path / "mixed.mcap") as bag:
        assert [topic.name for topic in bag.others] == ["/imu", "/scan_json"]
        assert [topic.name for topic in bag.topics] == ["/scan", "/tf", "/tf_static"]
    only = by_hand(tmp_path / "json.mcap", said=SAID[:2], more=more, convert=plain)
    with pytest.raises(BadRecording, match=r"no LaserScan; .*/scan_json \(foxglove.LaserScan, json\)"):
        read_bag(only)


def test_an_mcap_of_ros_1(tmp_path):
    """As `mcap convert` makes it of a .bag; and any other profile whose messages are those of ROS 2."""
    expected = seen(read_bag(by_hand(tmp_path / "two.mcap", convert=plain)))
    assert seen(read_bag(by_hand(tmp_path / "one.mcap", profile="ros1", convert=ros1))) == expected
    assert seen(read_bag(by_hand(tmp_path / "none.mcap", profile="", convert=plain))) == expected


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_bags(tmp_path, plugin, mode):
    """Files as a whole, or message by message: as metadata.yaml says."""
    expected = seen(read_bag(write_bag(tmp_path / "plain", SAID, plugin)))
    packed = tmp_path / "packed"
    writer = Writer(packed, version=8, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    write_bag(packed, SAID, writer=writer)
    assert seen(read_bag(packed)) == expected
    if mode is CompressionMode.FILE:
        (packed / "metadata.yaml").unlink()
        with pytest.raises(BadRecording, match="its data files are compressed, and no metadata"):
            read_bag(packed)


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_of_a_folder_the_files_are_read_that_its_metadata_names(tmp_path, plugin):
    folder = write_bag(tmp_path / "bag", SAID, plugin)
    expected = seen(read_bag(folder))
    (other,) = (f for f in write_bag(tmp_path / "other", SAID[:5], plugin).iterdir() if f.suffix != ".yaml")
    shutil.copy(other, folder)
    found = read_bag(folder)
    assert seen(found) == expected
    assert f"not read, as metadata.yaml does not name them: {other.name}" in found.reader.doubt
    metadata = folder / "metadata.yaml"
    told = yaml.safe_load(metadata.read_text())
    told["rosbag2_bagfile_information"]["relative_file_paths"].append("gone_1.db3")
    metadata.write_text(yaml.safe_dump(told))
    assert "missing, though metadata.yaml names them: gone_1.db3" in read_bag(folder).reader.doubt
    metadata.unlink()
    with pytest.raises(BadRecording, match=r"data files of several bags \(bag\..*, other\..*\): give one"):
        read_bag(folder)


@pytest.mark.parametrize("name", ["scan", "/s[a]", "/" + "s" * 500, "/sc\nan"])
def test_names_of_topics_are_what_they_are(tmp_path, name):
    """In MCAP, without / at the begin or with what a glob would take for something else."""
    said = [each._replace(topic=name) if each.topic == "/scan" else each for each in SAID]
    expected = seen(read_bag(by_hand(tmp_path / "plain.mcap", convert=plain)))
    assert seen(read_bag(by_hand(tmp_path / "odd.mcap", said, convert=plain))) == expected


@pytest.mark.parametrize("name", ["a?mode=rw.db3", "a#1.db3", "a%41.db3"])
def test_names_of_files_are_no_uris(tmp_path, name):
    """Of SQLite, to whom a%41 would be another file."""
    folder = write_bag(tmp_path / "bag", SAID)
    expected = seen(read_bag(folder))
    (data,) = folder.glob("*.db3")
    shutil.copy(data, tmp_path / name)
    assert seen(read_bag(tmp_path / name)) == expected
    (other,) = write_bag(tmp_path / "other", SAID[:5]).glob("*.db3")
    shutil.copy(other, tmp_path / "aA.db3")
    assert seen(read_bag(tmp_path / name)) == expected
    (tmp_path / name).write_bytes(data.read_bytes()[:-4096])
    assert len(read_bag(tmp_path / name).found) > 10


@pytest.mark.parametrize("log", ["wal", "journal"])
def test_what_sqlite_has_not_taken_over_is_told_of(tmp_path, log):
    folder = write_bag(tmp_path / "bag", SAID)
    (folder / f"bag.db3-{log}").write_bytes(b"")
    assert "not read" not in read_bag(folder).reader.doubt
    (folder / f"bag.db3-{log}").write_bytes(b"messages")
    assert f"bag.db3-{log}: not read, and it may hold messages" in read_bag(folder).reader.doubt


@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_a_data_file_that_cannot_be_read_is_told_in_a_line(tmp_path, kind):
    """As of a disk that fails; nothing else that reads as a file fails for everybody."""
    (tmp_path / f"bag_0.{kind}").symlink_to("/proc/self/mem")
    with pytest.raises(BadRecording, match=rf"bag_0.{kind}: cannot be read \(Input/output error\)$"):
        read_bag(tmp_path)


def test_an_unfinished_bag_of_ros_1_is_refused_with_what_mends_it(datasets, tmp_path):
    whole = (datasets / "bags" / "ros1" / "laser_frame_missing.bag").read_bytes()
    (tmp_path / "cut.bag").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(BadRecording, match=r"cut.bag: a bag that is damaged, .* index by `rosbag reindex`"):
        read_bag(tmp_path / "cut.bag")


def test_transforms_that_cannot_be_are_told_where_no_scan_can_be_placed(tmp_path):
    nowhere = [tf(at(n), edge(at(n), "odom", "base_link", math.nan, 0.0, 0.0)) for n in range(1, 4)]
    folder = write_bag(tmp_path / "bag", [mount(), *nowhere, scan(at(2))])
    with pytest.raises(BadRecording, match=r"none of its 1 scans .*; bad_transform: odom -> base_link: "):
        read_bag(folder)


def test_counts_of_a_metadata_that_is_wrong_mislead_nobody(tmp_path):
    folder = write_bag(tmp_path / "bag", SAID)
    expected = seen(read_bag(folder))
    metadata = folder / "metadata.yaml"
    told = yaml.safe_load(metadata.read_text())
    for topic in told["rosbag2_bagfile_information"]["topics_with_message_count"]:
        topic["message_count"] = 0
    metadata.write_text(yaml.safe_dump(told))
    assert seen(read_bag(folder)) == expected
