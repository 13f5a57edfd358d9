"""Lines of recorded logs, for the tests that read and write them."""

import json

from ogm_core.recordings import RecordedPose

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


def parsed(read, *lines, **options):
    """(messages, complaints) of lines."""
    complaints = []
    messages = list(read(lines, lambda number, reason: complaints.append((number, reason)), **options))
    return messages, complaints


def same(one, other):
    """Whether two recorded messages are equal, bit for bit."""
    return repr(one) == repr(other) and (
        isinstance(one, RecordedPose) or one.message.ranges.tobytes() == other.message.ranges.tobytes()
    )
