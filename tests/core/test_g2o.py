"""g2o pose graphs with laser lines, line by line and as files."""

import gzip
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest

from log_lines import flaser, odom, parsed_twice, robotlaser, same
from ogm_core.errors import BadRecording
from ogm_core.logs.carmen import CarmenLog
from ogm_core.logs.decimals import read_decimals
from ogm_core.logs.g2o import GraphLog
from ogm_core.logs.recordings import RecordingReader
from ogm_core.types import IDENTITY, Pose

DATASETS = os.environ.get("OGM_DATASETS")
AHEAD = {"pose": "1.4 2 0", "robot": "1 2 0"}
"""The poses in a line of a laser 0.4 m ahead of its robot."""


def read(*lines, is_graph=None):
    """(messages, complaints) of the lines of a log."""
    quick = GraphLog(CarmenLog(decimals=read_decimals), is_graph=is_graph)
    careful = GraphLog(CarmenLog(), is_graph=is_graph)
    return parsed_twice(careful.parse_line, quick.parse_line, *lines)


@pytest.mark.parametrize("vertex", ["VERTEX2", "VERTEX_SE2", "  VERTEX2"])
def test_the_vertex_before_a_sweep_is_the_robots_pose(vertex):
    [scan], complaints = read(f"{vertex} 7 -3 4.5 1.25".encode(), robotlaser([1.5, 2, 99], **AHEAD))
    assert complaints == []
    assert (scan.robot, scan.sensor) == ("robot1", "laser")
    assert (scan.message.pose, scan.message.mount) == (Pose(-3, 4.5, 1.25), Pose(pytest.approx(0.4), 0, 0))
    np.testing.assert_array_equal(scan.message.ranges, np.float32([1.5, 2, np.inf]))
    assert scan.message.stamp == 32_906_800_000


def test_the_two_poses_of_a_line_say_where_the_laser_sits_on_the_robot():
    """In which frame they ever are: the laser is 0.3 m ahead, 0.1 m to the left, turned by 2 rad."""
    c, s = math.cos(1.5), math.sin(1.5)
    laser = f"{7 + c * 0.3 - s * 0.1!r} {-8 + s * 0.3 + c * 0.1!r} 3.5"
    [scan], _ = read(b"VERTEX2 0 1 2 0.5", robotlaser([1], pose=laser, robot="7 -8 1.5"))
    assert scan.message.pose == Pose(1, 2, 0.5)
    assert tuple(scan.message.mount) == pytest.approx((0.3, 0.1, 2.0))


def test_every_sweep_has_the_vertex_before_it():
    first, second = b"VERTEX2 0 0 0 0", b"VERTEX2 1 1 0 0"
    edge = b"EDGE2 0 1 1 0 0 1 0 1 1 0 0"
    messages, complaints = read(first, robotlaser([1]), edge, second, b"", b"# x", robotlaser([1], **AHEAD))
    assert complaints == []
    assert [message.message.pose for message in messages] == [Pose(0, 0, 0), Pose(1, 0, 0)]


def test_two_sweeps_at_one_place_have_one_vertex_and_two_at_two_places_have_not():
    vertex = b"VERTEX2 0 0 0 0"
    messages, complaints = read(vertex, robotlaser([1], robot="1 2 3"), robotlaser([2], robot="1.004 2 3"))
    assert (len(messages), complaints) == (2, [])
    for moved in ("1.2 2 3", "1 2 3.1"):
        messages, [(number, said)] = read(
            vertex, robotlaser([1], robot="1 2 3"), robotlaser([2], robot=moved)
        )
        assert (len(messages), number) == (1, 3)
        assert said == "the robot has moved since the vertex before it: it needs one of its own"


@pytest.mark.parametrize(
    ("vertex", "said"),
    [
        (b"VERTEX2 0 1 2", "VERTEX2: 5 fields are needed, got 4"),
        (b"VERTEX_SE2 0 1 2 3 4", "VERTEX_SE2: 5 fields are needed, got 6"),
        (b"VERTEX2 0 1 2 x", "VERTEX2: x, y and theta are needed"),
        (b"VERTEX2 0 nan 2 3", "VERTEX2: finite x, y and theta are needed"),
    ],
)
def test_a_sweep_below_a_malformed_vertex_is_not_placed_by_the_one_before(vertex, said):
    messages, complaints = read(b"VERTEX2 0 1 2 3", robotlaser([1]), vertex, robotlaser([2], **AHEAD))
    assert len(messages) == 1
    assert [number for number, _ in complaints] == [3, 4]
    assert re.match(said, complaints[0][1])
    assert complaints[1][1] == "no vertex before it says where the robot was"


def test_a_robot_that_is_nowhere_says_no_mount():
    messages, [(_, said)] = read(b"VERTEX2 0 1 2 3", robotlaser([1], robot="nan 0 0"))
    assert messages == []
    assert said.startswith("the robot's pose is not finite")


def test_vertices_after_a_first_sweep_are_other_lines_unless_it_is_known_to_be_a_graph():
    lines = robotlaser([1]), b"VERTEX2 0 7 7 7", robotlaser([1])
    messages, complaints = read(*lines)
    assert [message.message.pose for message in messages] == [Pose(1.5, -2.5, 0.25)] * 2
    assert complaints == []
    messages, complaints = read(*lines, is_graph=True)
    assert [message.message.pose for message in messages] == [Pose(7, 7, 7)]
    assert complaints == [(1, "no vertex before it says where the robot was")]


def test_a_carmen_log_is_read_as_ever():
    lines = b"PARAM a b", odom(), flaser([1] * 180), robotlaser([1]), b"what"
    messages, complaints = read(*lines)
    expected, said = parsed_twice(CarmenLog().parse_line, CarmenLog().parse_line, *lines)
    assert all(map(same, messages, expected))
    assert (len(messages), complaints) == (1, said)


@pytest.mark.parametrize("name", ["graph.g2o", "graph.g2o.gz", "graph.G2O", "graph.log", "graph.clf"])
def test_graphs_are_read_by_their_suffix_or_their_first_line(tmp_path, name):
    content = b"VERTEX2 0 1 2 3\n" + robotlaser([1, 2, 12], **AHEAD) + b"\n"
    path = tmp_path / name
    path.write_bytes(gzip.compress(content) if name.endswith("gz") else content)
    with RecordingReader(path, range_max=12.0, robot="r7") as reader:
        [scan] = reader
    assert (scan.robot, scan.message.pose, scan.message.range_max) == ("r7", Pose(1, 2, 3), 12.0)
    np.testing.assert_array_equal(scan.message.ranges, np.float32([1, 2, np.inf]))


def test_a_graph_has_no_odometry(tmp_path):
    path = tmp_path / "graph.g2o"
    path.write_bytes(b"VERTEX2 0 1 2 3\n" + robotlaser([1]))
    with pytest.raises(BadRecording, match="--odometry is for CARMEN logs"):
        RecordingReader(path, odometry=True).__enter__()


@pytest.mark.skipif(DATASETS is None, reason="OGM_DATASETS does not name the folder of recorded logs")
def test_a_recorded_graph_is_read_whole():
    with RecordingReader(Path(DATASETS) / "fr079-g2o.log.gz") as reader:
        messages = [message.message for message in reader]
    assert (reader.scans, reader.poses, reader.malformed) == (600, 0, 0)
    assert (messages[0].pose, messages[1].pose) == (IDENTITY, Pose(0.344407, 0.000547, -0.051053))
    mounts = np.array([message.mount for message in messages])
    np.testing.assert_allclose(mounts, [[-0.04, 0.0, 0.0]] * 600, atol=5e-6)


def test_a_second_sweep_below_a_vertex_needs_a_robots_pose_that_tells_whether_it_moved():
    zero = {"pose": "0.4 0 0", "robot": "0 0 0"}
    lines = [b"VERTEX2 0 0 0 0", robotlaser([1.5], **zero, ipc_time=5), robotlaser([1.5], **zero, ipc_time=6)]
    messages, [(number, said)] = read(*lines)
    assert (len(messages), number) == (1, 3)
    assert "whether the robot has moved" in said
    messages, complaints = read(*lines[:2], b"VERTEX2 1 1 0 0", lines[2])
    assert (len(messages), complaints) == (2, [])
