"""MCAP recordings are opened by programs of others, whole and repaired; our types have their true hashes."""

import os

import numpy as np
import pytest

from ogm_core.ros2 import cdr
from ogm_core.ros2.mcap_recording import McapWriter
from ogm_core.ros2.recording_messages import DEFINITIONS, POSE, SCAN, TYPE_HASHES
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_services.recorder.repair import repair_recording
from witness import Answering

RNG = np.random.default_rng(15)
COUNT = 40
HUGE = 2**62 + 1
"""A seq that no float64 holds."""


@pytest.fixture(params=["mcap_file.py", "foxglove_mcap.cjs"])
def program(request):
    environment = "npm" if request.param.endswith(".cjs") else "zenoh"
    with Answering(environment, request.param) as program:
        yield program


def messages():
    for n in range(COUNT):
        ranges = RNG.uniform(0.1, 9.0, 90).astype(np.float32)
        ranges[3:5] = np.inf, np.nan
        pose = PoseStamped(10**18 + n, Pose(0.1 * n, -1e-300, 0.3), HUGE + n, "run.a")
        own = Pose(1 / 3, n / 7, 0.2) if n % 2 else None
        yield (
            pose,
            Scan(10**18 + n, -0.1, 1e-3, 0.1, 8.1, ranges, 1e-5, Pose(0.2, 0.1, -0.7), own, n, "run.a"),
        )


@pytest.fixture(params=["whole", "repaired"])
def recording(request, tmp_path):
    """A file, and what was written into it."""
    path, said = tmp_path / "a.mcap", list(messages())
    grid = cdr.OccupancyGrid(10**18, "map", 0.05, (-1.5, 2.0), np.array([[0, 100, -1]], np.int8))
    with path.open("wb") as file:
        writer = McapWriter(file)
        for pose, scan in said:
            writer.pose("r-1", pose, pose.stamp)
            writer.scan("r-1", "laser", scan, scan.stamp)
            writer.flush()
        writer.map(grid, 10**18 + COUNT)
        writer.flush()
        size = file.tell()
        writer.finish()
    if request.param == "repaired":
        os.truncate(path, size + 10)
        assert "is whole again" in repair_recording(path)
    return path, said


def number(value):
    """One that JSON had to write as text: whole numbers stay whole."""
    if not isinstance(value, str):
        return value
    return int(value) if value.lstrip("-").isdigit() else float(value)


def of(told, topic):
    return [values for name, _, values in told["messages"] if name == topic]


def test_others_open_a_recording(program, recording):
    path, said = recording
    told = program.ask(file=str(path))
    assert told["profile"] == "ros2"
    assert {(topic, kind) for topic, kind, _ in told["messages"]} == {
        ("/ogm/robots/r_1/pose", POSE),
        ("/ogm/robots/r_1/scan/laser", SCAN),
        ("/r_1/laser", cdr.LASER_SCAN),
        ("/tf", cdr.TF_MESSAGE),
        ("/map", cdr.OCCUPANCY_GRID),
    }
    poses = [
        {name: number(value) if name != "run" else value for name, value in each.items()}
        for each in of(told, "/ogm/robots/r_1/pose")
    ]
    assert poses == [
        {"stamp": pose.stamp, "seq": pose.seq, "run": pose.run, **pose.pose._asdict()} for pose, _ in said
    ]
    for values, (_, scan) in zip(of(told, "/ogm/robots/r_1/scan/laser"), said, strict=True):
        for name in (
            "stamp",
            "seq",
            "angle_min",
            "angle_increment",
            "time_increment",
            "range_min",
            "range_max",
        ):
            assert number(values[name]) == getattr(scan, name), name
        assert values["run"] == scan.run
        assert values["mount"] == [*scan.mount]
        assert values["pose"] == [*(scan.pose or ())]
        np.testing.assert_array_equal(np.array([*map(number, values["ranges"])], np.float32), scan.ranges)
    for values, (_, scan) in zip(of(told, "/r_1/laser"), said, strict=True):
        assert values["header"]["frame_id"] == "r-1/laser"
        np.testing.assert_array_equal(np.array([*map(number, values["ranges"])], np.float32), scan.ranges)
    assert [values["data"] for values in of(told, "/map")] == [[0, 100, -1]]
    edges = {
        (each["header"]["frame_id"], each["child_frame_id"])
        for tf in of(told, "/tf")
        for each in tf["transforms"]
    }
    assert edges == {("map", "r-1/base_link"), ("r-1/base_link", "r-1/laser")}


@pytest.mark.parametrize("kind", sorted(DEFINITIONS))
def test_our_types_have_the_hashes_that_ros2_generates(distribution, kind):
    with Answering(f"{distribution}", "generated_hash.py") as generator:
        assert generator.ask(type=kind, definition=DEFINITIONS[kind])["hash"] == TYPE_HASHES[kind]
