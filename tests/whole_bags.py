"""Whole bags of every kind as bytes, for those who damage them."""

import tempfile
from pathlib import Path

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from bag_files import STORE, drive, mount, write_bag

SAID = [mount(), *drive(12)]


def ros1(path, said, compression=None):
    """A .bag of ROS 1, in which tf is called as it was once."""
    connections, writer = {}, Writer1(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        for message in said:
            old = message.type.replace("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
            if message.topic not in connections:
                text, digest = STORE.generate_msgdef(message.type, ros_version=1)
                connections[message.topic] = writer.add_connection(
                    message.topic, old, msgdef=text, md5sum=digest
                )
            raw = STORE.cdr_to_ros1(message.payload, message.type)
            writer.write(connections[message.topic], message.time, raw)
    return path


def whole_bags():
    """By what a user calls them: the names of their files, and what these hold; the first is the bag."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sqlite = write_bag(folder / "a", SAID)
        mcap = write_bag(folder / "b", SAID, StoragePlugin.MCAP)
        packed = Writer(folder / "c", version=8, storage_plugin=StoragePlugin.MCAP)
        packed.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        write_bag(folder / "c", SAID, writer=packed)
        return {
            "bag, sqlite3": {"a.db3": (sqlite / "a.db3").read_bytes()},
            "bag, MCAP": {"b.mcap": (mcap / "b.mcap").read_bytes()},
            "bag, packed MCAP": {"c.mcap": (folder / "c" / "c.mcap").read_bytes()},
            "bag, ROS 1": {"d.bag": ros1(folder / "d.bag", SAID).read_bytes()},
            "bag, packed ROS 1": {
                "e.bag": ros1(folder / "e.bag", SAID, Writer1.CompressionFormat.LZ4).read_bytes()
            },
        }
