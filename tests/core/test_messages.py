"""Messages on the wire: what is accepted, and that everything else is refused by name."""

import math
import tracemalloc

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ogm_core.errors import BadMessage
from ogm_core.types import IDENTITY, Pose, PoseStamped, Scan
from ogm_core.wire import messages
from ogm_core.wire.messages import decode_pose, decode_scan, encode_pose, encode_scan

NAN, INF = math.nan, math.inf
MISSING = object()
RANGES = np.array([1.5, 0.1, np.inf, -np.inf, np.nan, -0.0, 1e-45], np.float32)
POSE_FIELDS = {"stamp": 5, "seq": 6, "run": "run-1", "x": 1.25, "y": -2.5, "theta": 0.1}
SCAN_FIELDS = {
    "stamp": 1_700_000_000_123_456_789,
    "seq": 7,
    "run": "run-1",
    "angle_min": -math.pi,
    "angle_increment": 0.1,
    "time_increment": 1e-5,
    "range_min": 0.05,
    "range_max": 30.0,
    "ranges": RANGES.tobytes(),
    "mount": [0.1, 0.2, 0.3],
    "pose": [1.1, 2.2, 3.3],
}
NUMBERS = st.floats() | st.integers(-(2**63), 2**64 - 1)
VALUES = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.integers(0, 9), inner),
    max_leaves=8,
)


def payload(fields, **changes):
    changed = {**fields, **changes}
    return msgpack.packb({name: value for name, value in changed.items() if value is not MISSING})


def scan_with(**changes):
    return decode_scan(payload(SCAN_FIELDS, **changes))


def test_a_pose_comes_back_bit_for_bit():
    message = PoseStamped(2**63 - 1, Pose(0.1, -0.0, 1e-300), 2**40, "lauf-1")
    back = decode_pose(encode_pose(message))
    assert back == message
    assert math.copysign(1.0, back.pose.y) == -1.0


def test_a_scan_comes_back_bit_for_bit():
    scan = Scan(
        stamp=3,
        angle_min=0.1,
        angle_increment=-0.1,
        range_min=0.0,
        range_max=1000.0,
        ranges=RANGES,
        time_increment=1e-7,
        mount=Pose(0.1, 0.2, 0.3),
        pose=Pose(1.1, -2.2, 1e-3),
        seq=9,
        run="r",
    )
    back = decode_scan(encode_scan(scan))
    for name in Scan.__slots__:
        if name != "ranges":
            assert getattr(back, name) == getattr(scan, name), name
    assert back.ranges.dtype == np.float32
    assert back.ranges.tobytes() == RANGES.tobytes()
    assert not back.ranges.flags.writeable


def test_the_wire_form_is_that_of_the_contract():
    assert msgpack.unpackb(encode_pose(decode_pose(payload(POSE_FIELDS)))) == POSE_FIELDS
    assert msgpack.unpackb(encode_scan(scan_with())) == SCAN_FIELDS
    assert "pose" not in msgpack.unpackb(encode_scan(scan_with(pose=MISSING)))


def test_what_is_optional_has_a_default():
    scan = scan_with(run=MISSING, time_increment=MISSING, mount=MISSING, pose=MISSING)
    assert (scan.run, scan.time_increment, scan.mount, scan.pose) == ("", 0.0, IDENTITY, None)
    assert decode_pose(payload(POSE_FIELDS, run=MISSING)).run == ""


def test_unknown_fields_are_ignored():
    extra = {"pose_end": "reserved", "intensities": b"\x00", "nested": {"a": [None, True]}}
    assert decode_pose(payload(POSE_FIELDS, **extra)) == decode_pose(payload(POSE_FIELDS))
    assert encode_scan(scan_with(**extra)) == encode_scan(scan_with())


def test_whole_numbers_are_numbers():
    assert decode_pose(payload(POSE_FIELDS, x=1, y=-2, theta=0)).pose == Pose(1.0, -2.0, 0.0)
    scan = scan_with(
        angle_min=0, angle_increment=1, time_increment=0, range_min=0, range_max=30, mount=[1, 2, 3]
    )
    assert (scan.angle_increment, scan.range_max, scan.mount) == (1.0, 30.0, Pose(1.0, 2.0, 3.0))
    assert all(type(value) is float for value in (scan.angle_min, scan.range_max, *scan.mount))


@pytest.mark.parametrize("bad", [MISSING, True, "1", None, NAN, INF, -INF, [1.0]])
@pytest.mark.parametrize("name", ["x", "y", "theta"])
def test_a_pose_needs_finite_coordinates(name, bad):
    with pytest.raises(BadMessage, match=f"^{name}: "):
        decode_pose(payload(POSE_FIELDS, **{name: bad}))


@pytest.mark.parametrize("bad", [MISSING, True, "1", None, NAN, INF, b"1"])
@pytest.mark.parametrize("name", ["angle_min", "angle_increment", "range_min", "range_max"])
def test_a_scan_needs_finite_geometry(name, bad):
    with pytest.raises(BadMessage, match=f"^{name}: "):
        scan_with(**{name: bad})


@pytest.mark.parametrize("bad", [MISSING, True, 1.0, "1", None, -1, 2**63])
@pytest.mark.parametrize("name", ["stamp", "seq"])
def test_stamps_and_seqs_are_counts(name, bad):
    with pytest.raises(BadMessage, match=f"^{name}: "):
        decode_pose(payload(POSE_FIELDS, **{name: bad}))
    with pytest.raises(BadMessage, match=f"^{name}: "):
        scan_with(**{name: bad})


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("run", 1),
        ("run", None),
        ("run", b"run"),
        ("time_increment", NAN),
        ("time_increment", False),
        ("time_increment", None),
        ("time_increment", 1e300),
        ("angle_increment", 0.0),
        ("angle_increment", -0.0),
        ("angle_increment", 1e308),
        ("range_min", -0.01),
        ("range_min", 30.0),
        ("range_min", 30.1),
        ("range_max", 1000.1),
        ("ranges", MISSING),
        ("ranges", None),
        ("ranges", [1.0, 2.0]),
        ("ranges", "abcd"),
        ("ranges", b""),
        ("ranges", b"12345"),
        ("mount", None),
        ("mount", 1.0),
        ("mount", [0.0, 0.0]),
        ("mount", [0.0, 0.0, 0.0, 0.0]),
        ("mount", {"x": 0, "y": 0, "theta": 0}),
        ("pose", None),
        ("pose", "abc"),
        ("pose", []),
    ],
)
def test_each_bad_field_is_named(name, bad):
    with pytest.raises(BadMessage, match=f"^{name}: "):
        scan_with(**{name: bad})


@pytest.mark.parametrize("name", ["mount", "pose"])
@pytest.mark.parametrize("bad", [True, None, "0", NAN, INF])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_each_bad_part_of_a_pose_is_named(name, bad, place):
    value = [0.0, 0.0, 0.0]
    value[place] = bad
    with pytest.raises(BadMessage, match=rf"^{name}\[{place}\]: "):
        scan_with(**{name: value})


@pytest.mark.parametrize("run", ["r" * 65, "r" * 1000, "a b", "a/b", "caf\u00e9", "r\n", "*", "\x00"])
def test_a_run_is_a_name_or_none_at_all(run):
    for decode, fields in ((decode_pose, POSE_FIELDS), (decode_scan, SCAN_FIELDS)):
        with pytest.raises(
            BadMessage, match=r"^run: 1 to 64 of A-Z a-z 0-9 _ - \. are needed, or none, got '"
        ):
            decode(payload(fields, run=run))
        assert decode(payload(fields, run="")).run == ""
        assert decode(payload(fields, run="A-z_0.9" + "r" * 57)).run == "A-z_0.9" + "r" * 57


def test_half_a_surrogate_pair_is_refused_before_it_cannot_be_sent():
    with pytest.raises(BadMessage, match=r"^run: "):
        messages.pose_from_fields({**POSE_FIELDS, "run": "\ud800"})


def test_the_limits_themselves_are_accepted():
    assert scan_with(range_min=0.0, range_max=1000.0).range_max == 1000.0
    assert scan_with(ranges=RANGES[:2].tobytes(), angle_increment=1e308).ranges.size == 2


def test_beams_are_counted():
    million = np.linspace(0, 1, 10**6, dtype="<f4").tobytes()
    data = payload(SCAN_FIELDS, ranges=million)
    assert decode_scan(data, max_beams=10**6).ranges.tobytes() == million
    with pytest.raises(BadMessage, match=r"^ranges: 1 to 999999 beams are needed, got 1000000$"):
        decode_scan(data, max_beams=10**6 - 1)
    with pytest.raises(BadMessage, match=r"^ranges: 1 to 200000 beams"):
        decode_scan(data)


def test_a_message_is_no_longer_than_its_kind_can_be():
    empty = len(payload(SCAN_FIELDS, ranges=bytes(4000), pad=bytes(1000))) - 1000
    room = messages.max_scan_bytes(1000) - empty
    assert messages.max_scan_bytes(1000) == 8096
    longest = payload(SCAN_FIELDS, ranges=bytes(4000), pad=bytes(room))
    assert decode_scan(longest, max_beams=1000).ranges.size == 1000
    with pytest.raises(BadMessage, match=r"^payload: at most 8096 bytes are needed, got 8097$"):
        decode_scan(payload(SCAN_FIELDS, ranges=bytes(4000), pad=bytes(room + 1)), max_beams=1000)
    pad = bytes(1024 - len(payload(POSE_FIELDS, pad=bytes(500))) + 500)
    assert decode_pose(payload(POSE_FIELDS, pad=pad)) == decode_pose(payload(POSE_FIELDS))
    with pytest.raises(BadMessage, match=r"^payload: at most 1024 bytes are needed, got 1025$"):
        decode_pose(payload(POSE_FIELDS, pad=pad + b"x"))


def test_bytes_are_little_endian():
    assert scan_with(ranges=b"\x00\x00\x80\x3f\x00\x00\x00\x40").ranges.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", "not MessagePack"),
        (b"\xc1", "not MessagePack"),
        (payload(POSE_FIELDS)[:-1], "not MessagePack"),
        (payload(POSE_FIELDS) + b"\x00", "not MessagePack"),
        (b"\x91" * 100_000, "not MessagePack"),
        (msgpack.packb({1: 2}), "not MessagePack"),
        (b"\x81\xa1\xff\x00", "not MessagePack"),
        (b"{}", "not MessagePack"),
        (msgpack.packb([1, 2]), "a MessagePack map is needed, got list"),
        (msgpack.packb(None), "a MessagePack map is needed, got null"),
    ],
)
@pytest.mark.parametrize("decode", [decode_pose, decode_scan])
def test_a_payload_that_is_no_map_is_refused(decode, data, text):
    with pytest.raises(BadMessage, match=f"^payload: .*{text}"):
        decode(data)


def nested(width, depth):
    """Lists in lists, `width` ** `depth` in all."""
    return b"\x90" if depth == 0 else bytes([0x90 + width]) + nested(width, depth - 1) * width


MANY = 20_000_000
HURTS = {
    "a list of millions of lists": b"\xdd" + MANY.to_bytes(4, "big") + b"\x90" * MANY,
    "millions of lists behind one": b"\x90" * MANY,
    "a long list in a field": b"\x81\xa1a\xdd" + MANY.to_bytes(4, "big") + b"\x90" * MANY,
    "short lists in lists": b"\x81\xa1a" + nested(8, 7),
    "short maps in maps": b"\x81\xa1a" * 500 + b"\xc0",
    "deep lists": b"\x81\xa1a" + b"\x91" * 10**6 + b"\xc0",
    "many fields": b"\xdf"
    + (10**6).to_bytes(4, "big")
    + b"".join(b"\xa3%03d\x01" % (k % 999) for k in range(10**6)),
    "keys that are numbers": b"\x82\x01\x01\x02\x02",
    "a key that is a list": b"\x81\x90\x01",
    "long text in a field": b"\x81\xa1a\xdb" + (10**7).to_bytes(4, "big") + b"x" * 10**7,
    "an extension": b"\x81\xa1a\xc7\x05\x01abcde",
    "a time": b"\x81\xa1a\xd6\xff\x00\x00\x00\x01",
    "a time far away": b"\x81\xa1a\xc7\x0c\xff" + b"\xff" * 12,
    "text that is no UTF-8": b"\x81\xa1a\xa2\xff\xfe",
}


@pytest.mark.parametrize("name", HURTS)
@pytest.mark.parametrize("decode", [decode_pose, decode_scan])
def test_a_payload_that_would_become_much_more_is_refused_before_it_does(decode, name):
    data = HURTS[name]
    tracemalloc.start()
    try:
        with pytest.raises(BadMessage, match=r"^payload: "):
            decode(data)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < len(data) + 200_000  # a rest that follows what was read is copied once, by msgpack


def test_small_fields_that_nobody_knows_may_hold_lists_and_maps():
    covariance = [[0.1] * 6] * 6
    extra = {"covariance": covariance, "flat": [0.0] * 64, "header": {"frame": "map", "tags": ["x"] * 20}}
    assert encode_scan(scan_with(**extra)) == encode_scan(scan_with())
    with pytest.raises(BadMessage, match=r"^payload: not MessagePack .*65 exceeds max_array_len\(64\)"):
        scan_with(flat=[0.0] * 65)
    with pytest.raises(BadMessage, match=r"^payload: it holds more than 128 lists and maps$"):
        scan_with(lists=[[[]] * 64] * 2)


def refuses_or_reads(decode, data):
    """What `decode` makes of `data`; anything but BadMessage passes through and fails the test."""
    try:
        return decode(data)
    except BadMessage:
        return None


@given(st.binary(max_size=200))
def test_random_bytes_raise_nothing_else(data):
    refuses_or_reads(decode_pose, data)
    refuses_or_reads(decode_scan, data)


@given(VALUES)
def test_random_structures_raise_nothing_else(value):
    refuses_or_reads(decode_pose, msgpack.packb(value))
    refuses_or_reads(decode_scan, msgpack.packb(value))


@given(st.sampled_from(sorted(SCAN_FIELDS)), VALUES)
def test_a_scan_with_one_random_field_is_sound_or_refused(name, value):
    scan = refuses_or_reads(decode_scan, payload(SCAN_FIELDS, **{name: value}))
    if scan is not None:
        numbers = (scan.angle_min, scan.angle_increment, scan.time_increment, *scan.mount, *(scan.pose or ()))
        assert all(type(number) is float and math.isfinite(number) for number in numbers)
        assert 0.0 <= scan.range_min < scan.range_max <= 1000.0
        assert scan.ranges.size > 0
        assert type(scan.stamp) is type(scan.seq) is type(scan.end_stamp) is int


@given(st.sampled_from(sorted(POSE_FIELDS)), VALUES)
def test_a_pose_with_one_random_field_is_sound_or_refused(name, value):
    message = refuses_or_reads(decode_pose, payload(POSE_FIELDS, **{name: value}))
    if message is not None:
        assert all(type(number) is float and math.isfinite(number) for number in message.pose)
        assert 0 <= message.stamp < 2**63


@given(st.binary(max_size=40), st.integers(0, 200))
def test_a_damaged_scan_raises_nothing_else(noise, place):
    data = payload(SCAN_FIELDS)
    refuses_or_reads(decode_scan, data[:place] + noise + data[place + len(noise) :])
