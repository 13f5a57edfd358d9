"""What people give as files: any bytes are read, or refused in one line."""

import io
import json
import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from message_rules import check_fields
from mutations import SEEDS, mutated
from ogm_core.errors import BadInput, BadMapFile, BadMessage, BadWorld
from ogm_core.files.map_files import read_npz
from ogm_core.files.ros_map_reader import read_ros_map
from ogm_core.files.strict_yaml import parse_yaml, shown
from ogm_core.logs.carmen import CarmenLog
from ogm_core.logs.g2o import GraphLog
from ogm_core.logs.jsonlines import JsonLog
from ogm_core.logs.recorded import RecordedScan
from ogm_core.simulation.catalogue import world_named
from ogm_core.simulation.worlds import load_world
from ogm_core.types import Pose
from ros_map_files import write_ros_map

SCAN = json.dumps(
    {
        "type": "scan",
        "robot": "r1",
        "sensor": "laser",
        "stamp": 5,
        "seq": 6,
        "run": "a",
        "angle_min": -1.5,
        "angle_increment": 0.5,
        "range_min": 0.1,
        "range_max": 8.0,
        "ranges": [2.5, "inf", 3, "nan", 1e39],
        "mount": [0.1, 0, 0.2],
        "pose": [0.1, 0.2, 0.3],
    }
).encode()
POSE = b'{"type": "pose", "robot": "r1", "stamp": 5, "seq": 0, "x": 1.0, "y": 0.5, "theta": 0.1}'
FLASER = b"FLASER 180 " + b"2.5 " * 180 + b"1.0 2.0 0.1 0.9 2.0 0.1 7.5 host 7.5"
ROBOTLASER = (
    b"ROBOTLASER1 0 -1.57 3.14 0.5 80.0 0.01 0 3 1.0 2.0 81.0 0 1 2 0.1 1 2 0.1 0 0 0.3 0.3 1.0 7.5 h 7.5"
)
ODOM = b"ODOM 1.0 2.0 0.1 0.5 0 0 7.5 host 7.5"
VERTEX = b"VERTEX2 0 0.1 2.0 0.1"
WORLD = "name: hall\nboxes: [[0, 0, 12, 8]]\npath: {waypoints: [[1, 1], [1, 4], [3, 4]], spacing: 0.1}\n"
FLAT = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10)
PLAIN = st.recursive(
    FLAT,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)


def outcome(kind, read, *given):
    """What is read; None if it is refused, in a text that says no more than what was given, and why."""
    try:
        return read(*given)
    except kind as error:
        text = str(error)
    assert 0 < len(text) < 1000 + len(repr(given))
    return None


def parsed(log, line):
    """What comes out of a line keeps the rules of a message."""
    recorded = outcome(BadMessage, log.parse_line, line)
    if recorded is not None:
        check_fields(recorded.message)
        assert recorded.robot
        assert not isinstance(recorded, RecordedScan) or recorded.sensor


@given(st.sampled_from((SCAN, POSE)), SEEDS)
def test_damaged_json_lines(line, rng):
    for log in (JsonLog(), JsonLog(range_max=5.0)):
        parsed(log, mutated(rng, line))


@given(st.binary(max_size=300))
def test_any_bytes_as_lines(line):
    for log in (JsonLog(), CarmenLog(), CarmenLog(mount=Pose(0.0, 0.0, 0.0)), GraphLog(CarmenLog())):
        parsed(log, line)


@given(st.dictionaries(st.sampled_from(sorted(json.loads(SCAN))), PLAIN, max_size=3))
def test_any_values_in_a_json_line(changes):
    parsed(JsonLog(), json.dumps(json.loads(SCAN) | changes).encode())


@given(st.lists(st.sampled_from((FLASER, ROBOTLASER, ODOM, VERTEX)), min_size=1, max_size=4), SEEDS)
def test_damaged_carmen_and_g2o_lines(lines, rng):
    for log in (CarmenLog(), CarmenLog(mount=Pose(0.0, 0.0, 0.0)), GraphLog(CarmenLog())):
        for line in lines:
            parsed(log, mutated(rng, line))


def archive():
    file = io.BytesIO()
    np.savez_compressed(
        file, log_odds=np.ones((3, 4)), resolution=0.05, anchor=np.zeros(2), offset=np.zeros(2, np.int64)
    )
    return file.getvalue()


@given(SEEDS)
def test_damaged_archives(rng):
    npz = outcome(BadInput, read_npz, mutated(rng, archive()))
    assert npz is None or npz.log_odds.shape == (3, 4)


def world(description):
    read = outcome(BadWorld, load_world, description)
    assert read is None or len(read.path.pose(1)) == 3


@given(SEEDS)
def test_damaged_worlds(rng):
    world(mutated(rng, WORLD.encode()).decode(errors="replace"))


@given(st.dictionaries(st.sampled_from(["name", "circles", "boxes", "walls", "path", "image"]), PLAIN))
def test_any_values_in_a_world(fields):
    world({"path": {"circle": [0, 0, 1], "poses": 3}} | fields)


@given(st.text(max_size=200) | SEEDS.map(lambda rng: mutated(rng, WORLD.encode()).decode(errors="replace")))
def test_any_text_as_yaml(text):
    assert shown(outcome(ValueError, parse_yaml, text))


@pytest.mark.parametrize("endless", ["/dev/zero", "long.yaml"])
def test_a_description_without_end_is_not_read_on(tmp_path, endless):
    path = Path(endless) if endless.startswith("/") else write_ros_map(tmp_path).rename(tmp_path / endless)
    if not endless.startswith("/"):
        with path.open("a", encoding="utf-8") as file:
            file.write("# more\n" * 700_000)
    with pytest.raises(
        BadMapFile, match=rf"^{path}: the YAML file of a map is needed: longer than 65536 bytes"
    ):
        read_ros_map(path)
    with pytest.raises(BadWorld, match=r"not a file that can be read \(longer than 4194304 bytes\)"):
        world_named(str(path))


def test_damage_is_neither_all_fatal_nor_all_harmless():
    """Else the tests above would say little."""
    for log, line in ((JsonLog, SCAN), (JsonLog, POSE), (CarmenLog, FLASER), (CarmenLog, ROBOTLASER)):
        rng, refused = random.Random(3), 0
        for _ in range(300):
            try:
                log().parse_line(mutated(rng, line))
            except BadMessage:
                refused += 1
        assert 15 < refused < 285
