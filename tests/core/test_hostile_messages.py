"""Whatever bytes come in: a message that keeps every rule comes out of them, or a BadMessage in one line."""

import random

import msgpack
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from message_rules import check_fields
from mutations import SEEDS, mutated
from ogm_core.errors import BadMessage
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_core.wire.messages import decode_pose, decode_scan, encode_pose, encode_scan

MAX_BEAMS = 1000
POSE = encode_pose(PoseStamped(5, Pose(1.25, -2.5, 0.1), 6, "run-1"))
SCANS = tuple(
    encode_scan(
        Scan(
            stamp=7,
            angle_min=-1.5,
            angle_increment=0.01,
            range_min=0.1,
            range_max=30.0,
            ranges=np.linspace(0.0, 31.0, beams, dtype=np.float32),
            time_increment=1e-5,
            mount=Pose(0.1, 0.0, 3.1),
            pose=pose,
            seq=8,
            run="run-1",
        )
    )
    for beams, pose in ((1, None), (16, Pose(1.0, 2.0, 3.0)), (MAX_BEAMS, None))
)
POSE_FIELDS = ("stamp", "seq", "run", "x", "y", "theta")
SCAN_FIELDS = (
    *("stamp", "seq", "run", "angle_min", "angle_increment", "time_increment", "range_min", "range_max"),
    *("ranges", "mount", "pose", "pose_end", "more"),
)

NUMBERS = (
    st.integers(-(2**63), 2**64 - 1)
    | st.sampled_from([0, 1, -1, 2**63 - 1, 2**63, 1000, 1e-320, 1000.0, 1e308])
    | st.floats()
)
LEAVES = st.none() | st.booleans() | NUMBERS | st.text(max_size=70) | st.binary(max_size=40)
VALUES = st.recursive(
    LEAVES
    | st.lists(st.floats(-4, 4), min_size=3, max_size=3)
    | st.integers(0, 50).map(lambda n: bytes(4 * n)),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
    max_leaves=10,
)


def check_pose(data):
    try:
        message = decode_pose(data)
    except BadMessage as error:
        return check_refusal(error)
    check_fields(message)
    assert decode_pose(encode_pose(message)) == message
    return "read"


def check_scan(data):
    try:
        scan = decode_scan(data, max_beams=MAX_BEAMS)
    except BadMessage as error:
        return check_refusal(error)
    check_fields(scan)
    assert scan.ranges.size <= MAX_BEAMS
    assert scan.ranges.tobytes() in data
    return "read"


def check_refusal(error):
    text = str(error)
    assert text
    assert len(text) < 1000
    return "refused"


@given(st.binary(max_size=400))
def test_any_bytes(data):
    check_pose(data)
    check_scan(data)


@given(VALUES)
def test_any_structure(value):
    data = msgpack.packb(value)
    check_pose(data)
    check_scan(data)


def a_few_changed(names):
    """Any values under some of the names; None of them: the field is left out."""
    return st.dictionaries(st.sampled_from(names), st.just(...) | VALUES, max_size=3)


def changed(data, changes):
    fields = {**msgpack.unpackb(data), **changes}
    return msgpack.packb({name: value for name, value in fields.items() if value is not ...})


@given(a_few_changed(POSE_FIELDS))
def test_any_values_in_a_pose(changes):
    check_pose(changed(POSE, changes))


@given(st.sampled_from(SCANS), a_few_changed(SCAN_FIELDS))
def test_any_values_in_a_scan(scan, changes):
    check_scan(changed(scan, changes))


@given(SEEDS)
def test_damaged_poses(rng):
    check_pose(mutated(rng, POSE))


@given(st.sampled_from(SCANS), SEEDS)
def test_damaged_scans(scan, rng):
    check_scan(mutated(rng, scan))


def test_damage_is_neither_all_fatal_nor_all_harmless():
    """Else the two tests above would say little."""
    rng = random.Random(12)
    for check, data in ((check_pose, POSE), (check_scan, SCANS[1]), (check_scan, SCANS[2])):
        outcomes = [check(mutated(rng, data)) for _ in range(400)]
        assert 0.02 < outcomes.count("read") / 400 < 0.95
