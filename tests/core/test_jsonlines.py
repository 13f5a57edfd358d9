"""JSON lines logs, line by line."""

import json
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from log_lines import POSE, SCAN, line, parsed_twice, same
from ogm_core.logs import jsonlines
from ogm_core.logs.jsonl_writer import to_line
from ogm_core.logs.jsonlines import JsonLog
from ogm_core.logs.recordings import RecordedPose, RecordedScan
from ogm_core.types import Pose, PoseStamped, Scan

FINITE = st.floats(allow_nan=False, allow_infinity=False)


def read(*lines, **options):
    """(messages, complaints) of the lines of a log, which are those of Python's own JSON reader."""
    return parsed_twice(by_python(JsonLog(**options)), JsonLog(**options).parse_line, *lines)


def by_python(log):
    """What a line says by the reader that is slow and takes every line that is one."""
    return lambda text: log.recorded(jsonlines._fields(text)) if text.strip() else None


def test_a_pose_line_is_read():
    messages, complaints = read(line(POSE))
    assert messages == [RecordedPose("r1", PoseStamped(10, Pose(1.0, 2.0, 0.5), 1, "a"))]
    assert complaints == []


def test_a_scan_line_is_read():
    [scan], _ = read(line(SCAN, mount=[0.1, 0.2, 0.3], pose=[1, 2, 3], time_increment=1e-4))
    assert (scan.robot, scan.sensor) == ("r1", "front")
    message = scan.message
    assert (message.stamp, message.seq, message.run) == (20, 2, "")
    assert (message.angle_min, message.angle_increment, message.time_increment) == (-1.0, 0.5, 1e-4)
    assert (message.range_min, message.range_max) == (0.1, 30.0)
    assert (message.mount, message.pose) == (Pose(0.1, 0.2, 0.3), Pose(1.0, 2.0, 3.0))
    expected = np.array([1.1, 2.0, np.inf, -np.inf, np.nan], np.float32)
    assert message.ranges.dtype == np.float32
    np.testing.assert_array_equal(message.ranges, expected)
    assert not message.ranges.flags.writeable


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"no json", "not JSON"),
        (line(POSE)[:-1], "not JSON"),
        (line(POSE) + b"}", "not JSON"),
        (b'{"type": "\xff"}', "not JSON .*utf-8"),
        (b"\x00", "not JSON"),
        (b"[" * 200_000, "not JSON .*recursion"),
        (b'{"stamp": ' + b"9" * 5000 + b"}", "not JSON .*digits"),
        (b"[1, 2]", "not a JSON object"),
        (b"null", "not a JSON object"),
        (b"{}", "type: .* got NoneType"),
        (line(POSE, type="map"), "type: .* got 'map'"),
        (line(POSE, type=["pose"]), "type: .* got list"),
        (line(POSE, robot="a/b"), "robot: "),
        (line(POSE, robot=1), "robot: "),
        (line(POSE, robot="r1\n"), "robot: "),
        (line(POSE, x=math.nan), "x: a finite number is needed, got nan"),
        (line(SCAN, range_max=math.inf), "range_max: a finite number is needed, got inf"),
        (line(POSE, x="nan"), "x: a number"),
        (line(POSE, x=True), "x: a number"),
        (line(POSE).replace(b"1.0", b"1e999"), "x: a finite number"),
        (line(POSE, x=10**400), "x: a finite number"),
        (line(POSE, stamp=1.5), "stamp: a whole number"),
        (line(POSE, run="\ud800"), "run: "),
        (line(POSE, run="r" * 65), "run: 1 to 64 of "),
        (line(SCAN, run="caf\u00e9"), "run: 1 to 64 of "),
        (line(SCAN, sensor=None), "sensor: "),
        (line(SCAN, ranges=[]), "ranges: 1 to"),
        (line(SCAN, ranges="inf"), "ranges: a list"),
        (line(SCAN, ranges=[1.0, True]), r"ranges\[1\]: .* got True"),
        (line(SCAN, ranges=[None]), r"ranges\[0\]: .* got NoneType"),
        (line(SCAN, ranges=[1.0, "Infinity"]), r"ranges\[1\]: .* got 'Infinity'"),
        (line(SCAN, ranges=["1.0"]), r"ranges\[0\]: "),
        (line(SCAN, ranges=[[1.0]]), r"ranges\[0\]: .* got list"),
        (line(SCAN, ranges=[1]).replace(b"[1]", b"[inf]"), "not JSON"),
        (line(SCAN, ranges=[1]).replace(b"[1]", b"[nan]"), "not JSON"),
        (line(SCAN, ranges=[10**400]), "ranges: .*float64"),
        (line(SCAN, range_max=0.05), "range_min: "),
        (line(SCAN, pose=[0, 0, "nan"]), r"pose\[2\]: "),
    ],
)
def test_a_malformed_line_is_named_and_passed_over(text, reason):
    messages, complaints = read(line(POSE), text, line(POSE))
    assert len(messages) == 2
    [(number, said)] = complaints
    assert number == 2
    assert re.match(reason, said), said


@pytest.mark.parametrize("fields", [POSE, SCAN])
def test_every_missing_field_is_named(fields):
    optional = {"run", "seq"}
    for name in fields.keys() - optional:
        rest = {key: value for key, value in fields.items() if key != name}
        messages, [(_, said)] = read(line(rest))
        assert messages == []
        assert said.startswith(f"{name}: ")


def test_what_is_not_finite_may_stand_in_ranges_as_python_writes_it():
    text = line(SCAN, ranges=[1.5, math.inf, -math.inf, math.nan, "inf"], other=math.nan)
    assert b"Infinity, -Infinity, NaN" in text
    [scan], complaints = read(text)
    assert complaints == []
    expected = np.array([1.5, np.inf, -np.inf, np.nan, np.inf], np.float32)
    np.testing.assert_array_equal(scan.message.ranges, expected)


def without_seq(fields, **changes):
    return line({key: value for key, value in {**fields, **changes}.items() if key != "seq"})


def seqs(*lines):
    messages, complaints = read(*lines)
    assert complaints == []
    return [message.message.seq for message in messages]


def test_messages_without_seq_are_counted_by_source_and_run():
    pose, scan = without_seq(POSE), without_seq(SCAN)
    assert seqs(pose, scan, scan, pose, pose) == [0, 0, 1, 1, 2]
    assert seqs(scan, without_seq(SCAN, sensor="rear"), without_seq(SCAN, robot="r2"), scan) == [0, 0, 0, 1]
    assert seqs(pose, without_seq(POSE, run="b"), without_seq(POSE, robot="r2"), pose) == [0, 0, 0, 1]
    assert seqs(scan, without_seq(SCAN, run="b"), scan) == [0, 0, 1]


def test_the_count_goes_on_from_the_largest_seq_that_was_given():
    scan = without_seq(SCAN)
    assert seqs(line(SCAN, seq=7), scan, line(SCAN, seq=3), scan, scan) == [7, 8, 3, 9, 10]


def test_a_malformed_message_is_not_counted():
    scan, bad = without_seq(SCAN), without_seq(SCAN, range_max=-1)
    messages, complaints = read(scan, bad, scan)
    assert [message.message.seq for message in messages] == [0, 1]
    assert [number for number, _ in complaints] == [2]


def test_blank_lines_are_nothing_but_count_as_lines():
    messages, complaints = read(b"", b"  \t", line(POSE) + b"\r", b"x")
    assert len(messages) == 1
    assert [number for number, _ in complaints] == [4]


def test_numbers_beyond_float32_read_as_infinite():
    [scan], _ = read(line(SCAN, ranges=[1e39, -1e39, 3.4e38]))
    np.testing.assert_array_equal(scan.message.ranges, np.array([np.inf, -np.inf, 3.4e38], np.float32))


def test_max_beams_holds_for_logs_too():
    messages, complaints = read(line(SCAN), max_beams=4)
    assert (messages, complaints) == ([], [(1, "ranges: 1 to 4 beams are needed, got 5")])


@given(
    ranges=arrays(np.float32, st.integers(1, 40), elements=st.floats(width=32)),
    numbers=st.tuples(*[FINITE] * 6),
    stamp=st.integers(0, 2**63 - 1),
    run=st.from_regex(r"[A-Za-z0-9_.\-]{0,64}", fullmatch=True),
)
def test_a_line_reads_back_bit_for_bit(ranges, numbers, stamp, run):
    ranges[np.isnan(ranges)] = np.nan
    pose, mount = Pose(*numbers[:3]), Pose(*numbers[3:])
    scan = Scan(stamp, 0.1, -0.2, 0.0, 0.1, ranges, 1e-300, mount, pose, stamp, run)
    written = [RecordedPose("r", PoseStamped(stamp, pose, stamp, run)), RecordedScan("r", "s", scan)]
    lines = [to_line(message).encode() for message in written]
    assert not any(b"\n" in text for text in lines)
    back, complaints = read(*lines)
    assert complaints == []
    assert len(back) == 2
    assert all(map(same, written, back))


def test_every_kind_of_float32_reads_back():
    bits = np.random.default_rng(1).integers(0, 2**32, 200_000, dtype=np.uint32)
    ranges = bits.view(np.float32)
    ranges[np.isnan(ranges)] = np.nan
    scan = Scan(0, 0.0, 1e-6, 0.0, 1.0, ranges)
    [back], _ = read(to_line(RecordedScan("r", "s", scan)).encode())
    assert back.message.ranges.tobytes() == ranges.tobytes()


def test_written_ranges_are_short_and_strict_json():
    scan = Scan(0, 0.0, 0.1, 0.0, 1.0, np.array([0.1, 5.123, np.inf, -np.inf, np.nan], np.float32))
    text = to_line(RecordedScan("r", "s", scan))
    assert '"ranges":[0.1,5.123,"inf","-inf","nan"]' in text
    assert "pose" not in json.loads(text)


@pytest.mark.parametrize(
    "text",
    [
        line(POSE),
        line(SCAN),
        line(SCAN, run="r" * 64, stamp=2**63 - 1, mount=[0, -0.0, 1e-320], other={"caf\u00e9": [[1], {}]}),
        line(SCAN, other="[[[").replace(b"[1.1, 2,", b"[ 1.1\t,2 ,").replace(b'"ranges":', b'"ranges" : '),
    ],
)
def test_a_usual_line_is_left_to_nobody_else(text, monkeypatch):
    [expected], [] = read(text)

    def refuse(_):
        raise AssertionError("it was read twice")

    monkeypatch.setattr(jsonlines, "_fields", refuse)
    assert same(JsonLog().parse_line(text), expected)


@pytest.mark.parametrize(
    "text",
    [
        line(SCAN, other={"ranges": [3]}),
        line({**SCAN, "other": {"ranges": [3]}}).replace(b'"ranges": [1.1', b'"others": [1.1'),
        line(SCAN, ranges=[1]).replace(b"[1]", b'[1], "ranges": [2, 3]'),
        line(SCAN, ranges=[1]).replace(b"[1]", b'[1], "r\\u0061nges": [2, 3]'),
        line(SCAN, run='"ranges": [1]'),
        line(SCAN, ranges=[1]).replace(b'"ranges"', b'{"ranges"'),
        line(SCAN, ranges=[1]).replace(b"[1]", b"[1]]"),
        line(SCAN, ranges=[1]).replace(b"[1]", b"[1\v]"),
        line(SCAN, ranges=[1]).replace(b"[1]", b"[1 2]"),
        line(SCAN, ranges=[1]).replace(b"[1]", b"[1,]"),
        line(SCAN, ranges=[1]).replace(b"[1]", b"[01]"),
        line(SCAN, ranges=[1]).replace(b"[1]", b"[nan]"),
        line(SCAN, ranges=[1], range_max=-1),
        line(SCAN, ranges=[1]) + b"}",
        line(POSE, ranges=[1]),
    ],
)
def test_odd_ranges_are_read_as_they_always_were(text):
    read(text)


def odd(value):
    """A scan's line with a field that nobody reads, of any text."""
    return line(SCAN, other="?").replace(b'"?"', value)


@pytest.mark.parametrize(
    "text",
    [
        odd(b"[" * 900 + b"]" * 900),
        odd(b'"\\ud800"'),
        odd(b'"\\ud83d\\ude00\\u0000"'),
        odd(b"1" * 4300),
        odd(b"-1e400"),
        odd(b"1e-400"),
        odd(b'{"a": 1, "a": [2], "": -0}'),
        line(SCAN, range_max=7).replace(b'"type"', b'"range_max": "x", "ranges": [], "type"'),
        line(SCAN, mount=[10**20, -(10**300), 2**64], ranges=[10**30, -(2**64), 2**63, 3]),
        line(SCAN, ranges=[1]).replace(b"[1]", b"[1e400, -1e400, 1e-400, -1e-400, -0, -0.0, 1E+2, -0e5]"),
        line(SCAN, ranges=[1]).replace(
            b"[1]", b"[0.1000000014901161193847656250000000000000000000000000001]"
        ),
        line(SCAN, ranges=[1]).replace(b"[1]", b"[16777217, 16777217.0, 1.00000017881393432617187500001]"),
        b" \t" + line(SCAN) + b" \r\n",
    ],
)
def test_a_strange_line_is_read_as_it_always_was(text):
    [message], [] = read(text)
    assert (message.sensor, message.message.seq) == ("front", 2)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (odd(b"[" * 1010 + b"]" * 1010), "not JSON .*recursion"),
        (odd(b'{"a":' * 1010 + b"1" + b"}" * 1010), "not JSON .*recursion"),
        (odd(b"1" * 4301), "not JSON .*digits"),
        (odd(b'"\xed\xa0\x80"'), "not JSON .*utf-8"),
        (odd(b'"\x01"'), "not JSON .*control character"),
        (odd(b"'a'"), "not JSON .Expecting value"),
        (b"\xef\xbb\xbf" + line(SCAN), "not JSON .*BOM"),
        (line(SCAN) + b" x", "not JSON .Extra data"),
        (line(SCAN) + b"\0", "not JSON .Extra data"),
        (line(SCAN) + line(SCAN), "not JSON .Extra data"),
        (line(SCAN, stamp=2**64), r"stamp: 0 to 2\^63 - 1 is needed, got 18446744073709551616$"),
        (line(SCAN, seq=-(2**64)), r"seq: 0 to 2\^63 - 1 is needed, got -18446744073709551616$"),
        (line(SCAN, sensor=2**64), "sensor: .* got 18446744073709551616$"),
        (
            line(SCAN, range_max=1).replace(b": 1,", b": 1e400,"),
            "range_max: a finite number is needed, got inf",
        ),
        (line(SCAN).replace(b'"type"', b'"seq": 1, "type"').replace(b'"seq": 2', b'"seq": -1'), "seq: 0 to"),
    ],
)
def test_a_strange_line_is_refused_as_it_always_was(text, reason):
    messages, [(_, said)] = read(text)
    assert messages == []
    assert re.match(reason, said), said


@given(st.lists(st.one_of(st.floats(), st.integers(-(10**25), 10**25)).map(str), min_size=1, max_size=20))
def test_every_number_is_read_as_python_reads_it(numbers):
    read(line(SCAN, ranges=[1]).replace(b"[1]", f"[{','.join(numbers)}]".encode()))


@given(st.binary(max_size=12), st.integers(0, 200), st.integers(0, 12))
def test_a_line_with_anything_in_it_is_read_as_python_reads_it(anything, at, gone):
    text = line(SCAN, other="\u00e9", mount=[0, -1.5e3, 2])
    read(text[:at] + anything + text[at + gone :])
