"""Lines of recorded logs, for the tests that read and write them."""

import json

from ogm_core.logs.recordings import RecordedPose, read_lines

POSE = {"type": "pose", "robot": "r1", "stamp": 10, "seq": 1, "run": "a", "x": 1.0, "y": 2.0, "theta": 0.5}
SCAN = {
    "type": "scan",
    "robot": "r1",
    "sensor": "front",
    "stamp": 20,
    "seq": 2,
    "angle_min": -1.0,
    "angle_increment": 0.5,
    "range_min": 0.1,
    "range_max": 30.0,
    "ranges": [1.1, 2, "inf", "-inf", "nan"],
}


def line(fields, **changes):
    return json.dumps({**fields, **changes}).encode()


def flaser(ranges, *, pose="1.5 -2.5 0.25", odometry="7 8 9", ipc_time="32.9068", tail="pippo 40.0"):
    return f"FLASER {len(ranges)} {' '.join(map(str, ranges))} {pose} {odometry} {ipc_time} {tail}".encode()


def robotlaser(
    ranges,
    *,
    setup="0 -1.25 2.0 0.5 30.5 0.01 0",
    remissions=(),
    pose="1.5 -2.5 0.25",
    robot="1.5 -2.5 0.25",
    safety="0.3 0.1 0.5 0.4 1e6",
    ipc_time="32.9068",
    tail="pippo 40.0",
):
    readings = [len(ranges), *ranges, len(remissions), *remissions]
    text = f"ROBOTLASER1 {setup} {' '.join(map(str, readings))} {pose} {robot} {safety} {ipc_time} {tail}"
    return text.encode()


def odom(pose="1.0 2.0 0.5", *, speed="0.3 0.1 0", ipc_time="32.5", tail="pippo 40.0"):
    return f"ODOM {pose} {speed} {ipc_time} {tail}".encode()


def parsed(parse, *lines):
    """(messages, complaints) of lines."""
    complaints = []
    messages = list(read_lines(lines, parse, lambda number, reason: complaints.append((number, reason))))
    return messages, complaints


def parsed_twice(careful, quick, *lines):
    """The same, by two readers that must not differ: one reads ranges one by one, the other at once."""
    messages, complaints = parsed(careful, *lines)
    others, other_complaints = parsed(quick, *lines)
    assert other_complaints == complaints
    assert len(others) == len(messages)
    assert all(same(one, other) for one, other in zip(messages, others, strict=True))
    return messages, complaints


def same(one, other):
    """Whether two recorded messages are equal, bit for bit."""
    return repr(one) == repr(other) and (
        isinstance(one, RecordedPose) or one.message.ranges.tobytes() == other.message.ranges.tobytes()
    )
