"""Messages over Zenoh that are not well-formed: rejected, counted, said, and the service goes on."""

import logging
import math
import random
import re
import struct

import msgpack
import numpy as np
import pytest

from status_json import NO_POSES

INF, NAN = math.inf, math.nan
HERE = [0.0, 0.0, 0.0]
LAST = 2**63 - 1
GARBAGE = [
    *(
        b"",
        b"\xc1",
        b"\x00",
        b"\x80",
        b"\xff" * 100,
        b"\x91" * 100_000,
        b"null",
        b'{"stamp": 1}',
        bytes(10_000),
    ),
    *(
        msgpack.packb(value)
        for value in (None, 1, NAN, "text", b"bytes", [1, 2], True, {1: 2}, {"stamp": None})
    ),
    msgpack.packb({"stamp": 1})[:-1],
    msgpack.packb({"stamp": 1}) * 2,
    msgpack.packb({"x": "\x7f"}).replace(b"\x7f", b"\xff"),
]
NOT_A_NUMBER = (..., None, "1", b"1", [1.0], {}, True, NAN, INF, -INF)
NOT_A_COUNT = (..., None, "1", 1.0, True, -1, 2**63, 2**64 - 1, NAN)
NOT_A_POSE = (None, 1.0, [], [0.0, 0.0], [0.0] * 4, ["0", 0, 0], [0, 0, NAN], [INF, 0, 0], [0, -INF, 0], {})
NUMBERS = ("angle_min", "angle_increment", "range_min", "range_max")
BAD_SCANS = [
    *({name: value} for name in NUMBERS for value in NOT_A_NUMBER),
    *({name: value} for name in ("stamp", "seq") for value in NOT_A_COUNT),
    *({name: value} for name in ("pose", "mount") for value in NOT_A_POSE),
    *({"time_increment": value} for value in NOT_A_NUMBER[1:]),
    *({"run": value} for value in (None, 1, b"a", ["a"])),
    *({"ranges": value} for value in (..., None, [1.0], "1234", 1.0, b"", b"123", b"12345")),
    *(
        {"angle_increment": 0, "ranges": bytes(8)},
        {"angle_increment": 1e308, "ranges": bytes(4000)},
        {"time_increment": 1e308},
    ),
    *(
        {"range_min": -1e-9},
        {"range_min": 8.0},
        {"range_max": 1000.001},
        {"range_max": 1e9},
        {"range_max": 0},
    ),
]
BAD_SCANS[-6]["ranges"] = bytes(8)
BAD_POSES = [
    *({name: value} for name in ("x", "y", "theta") for value in NOT_A_NUMBER),
    *({name: value} for name in ("stamp", "seq") for value in NOT_A_COUNT),
    *({"run": value} for value in (None, 1, b"a")),
]


def packed(message, changes):
    """A message with some fields changed; those that are changed to ... are left out."""
    return msgpack.packb({name: value for name, value in {**message, **changes}.items() if value is not ...})


def test_garbage(sound):
    for payload in GARBAGE:
        # The scan comes last: it is scans that are waited for.
        sound.put("robots/r/pose", payload)
        sound.put("robots/r/scan/s", payload)
    status = sound.settle(received=3 + len(GARBAGE))
    assert status["scans"]["dropped"]["malformed"] == len(GARBAGE)
    assert status["poses"] == NO_POSES | {"received": len(GARBAGE), "malformed": len(GARBAGE)}
    assert status["revision"] == 3


def test_malformed_scans(sound, fields):
    for changes in BAD_SCANS:
        sound.put("robots/r/scan/s", packed(fields.scan(pose=HERE), changes))
    status = sound.settle(received=3 + len(BAD_SCANS))
    assert status["scans"]["dropped"]["malformed"] == len(BAD_SCANS)
    assert (status["revision"], status["robots"]["r"]["sources"]["s"]["last_seq"]) == (3, 0)


def test_malformed_poses(sound, fields):
    for changes in BAD_POSES:
        sound.put("robots/p/pose", packed(fields.pose(), changes))
    sound.pose(robot="p", x=1, y=-2, theta=3)  # whole numbers are numbers
    sound.scan([NAN], robot="p")
    status = sound.settle(received=4)
    assert status["poses"] == NO_POSES | {
        "received": len(BAD_POSES) + 1,
        "malformed": len(BAD_POSES),
        "late": 0,
    }
    assert status["robots"]["p"]["pose"] == [1.0, -2.0, 3.0]


@pytest.mark.parametrize(("beams", "dropped"), [(0, 1), (200_000, 0), (200_001, 1), (1_000_000, 1)])
def test_the_number_of_beams_is_limited(sound, beams, dropped):
    sound.scan(np.full(beams, NAN, "<f4"), pose=HERE)
    scans = sound.settle(received=4)["scans"]
    assert (scans["dropped"]["malformed"], scans["integrated"]) == (dropped, 4 - dropped)


def test_max_beams_is_a_setting(start_mapper, no_errors):
    with start_mapper(mapper={"max_beams": 3}) as mapper:
        for beams in (3, 4):
            mapper.scan([1.0] * beams, pose=HERE)
        scans = mapper.settle(received=2)["scans"]
        assert (scans["integrated"], scans["dropped"]["malformed"]) == (1, 1)


def test_what_is_too_long_for_its_kind_is_counted_and_not_even_copied(
    start_mapper, no_errors, monkeypatch, fields, eventually
):
    def padded(message, length):
        short = len(msgpack.packb({**message, "pad": bytes(1000)})) - 1000
        return msgpack.packb({**message, "pad": bytes(length - short)})

    put = []
    with start_mapper(map={"resolution": 0.5}, mapper={"max_beams": 1000}) as mapper:
        queue = mapper.service.parts.queue
        queue_put = queue.put
        monkeypatch.setattr(queue, "put", lambda item: put.append(item) or queue_put(item))
        for longer in (0, 1, 5_000_000):
            mapper.put(
                "robots/r/scan/s",
                padded(fields.scan([1.0] * 1000, pose=HERE, angle_increment=0.001), 8096 + longer),
            )
            mapper.put("robots/r/pose", padded(fields.pose(x=1.5), 1024 + longer))
        eventually(lambda: mapper.status()["poses"]["received"] == 3)  # the last that was sent
        status = mapper.settle(received=3)
    assert (status["scans"]["integrated"], status["scans"]["dropped"]["malformed"]) == (1, 2)
    assert status["poses"] == NO_POSES | {"received": 3, "malformed": 2}
    assert status["robots"]["r"]["pose"][0] == 1.5
    assert [len(item.payload) for item in put] == [8096, 1024]
    complaints = {record.getMessage() for record in no_errors.records if record.levelno == logging.WARNING}
    assert complaints == {
        "r/s: payload: at most 8096 bytes are needed, got 8097",
        "r/pose: payload: at most 1024 bytes are needed, got 1025",
    }


def test_complaints_are_logged_at_a_limited_rate(sound, no_errors):
    for _ in range(500):
        sound.put("robots/r/scan/s", b"garbage")
        sound.scan([1.0], pose=[1e6, 1e6, 0])
    sound.settle(received=1003)
    warnings = [record for record in no_errors.records if record.levelno == logging.WARNING]
    assert 2 <= len(warnings) <= 10
    assert all("r/s" in record.getMessage() for record in warnings)


def test_random_messages_on_random_keys(sound, fields):
    rng = random.Random(20)
    before, scans, poses, ignored = sound.status(), 0, 0, 0
    for _ in range(2000):
        key, payload = random_key(rng), random_payload(rng, fields)
        sound.put(f"robots/{key}", payload)
        named = re.fullmatch(r"[\w.-]{1,64}/(?:(pose)|scan/[\w.-]{1,64})", key, re.ASCII)
        ignored += named is None
        poses += named is not None and named[1] is not None
        scans += named is not None and named[1] is None
    assert min(scans, poses, ignored) > 100
    status = sound.settle(received=before["scans"]["received"] + scans)
    assert (status["poses"]["received"], status["other"]["ignored"]) == (poses, ignored)
    assert status["scans"]["integrated"] > 100
    assert status["scans"]["dropped"]["malformed"] > 100


def random_key(rng):
    robot = rng.choice(["r", "q", "ü", "x" * 65, "a b", ".", "-", "1/2"])
    sensor = rng.choice(["s", "s", "s", "t:u", "ß", "0", "s/t"])
    return rng.choice([f"{robot}/pose", f"{robot}/scan/{sensor}", f"r/scan/{sensor}", f"{robot}/{sensor}"])


def random_payload(rng, fields):
    good = fields.scan([rng.uniform(0, 9) for _ in range(rng.randrange(1, 9))], at=rng.randrange(10**9))
    good |= {"pose": [rng.uniform(-9, 9) for _ in range(3)], "x": 0.0, "y": 1.0, "theta": rng.uniform(-4, 4)}
    match rng.randrange(4):
        case 0:
            return rng.randbytes(rng.randrange(40))
        case 1:
            good[rng.choice(list(good))] = random_value(rng)
        case 2:
            payload = bytearray(msgpack.packb(good))
            for _ in range(rng.randrange(1, 4)):
                payload[rng.randrange(len(payload))] = rng.randrange(256)
            return bytes(payload)
    return msgpack.packb(good)


def random_value(rng, depth=2):
    some = [
        None,
        True,
        -1,
        LAST,
        2**64 - 1,
        0.0,
        -0.0,
        NAN,
        INF,
        5e-324,
        1.7e308,
        "",
        "é",
        b"",
        rng.randbytes(8),
    ]
    some.append(struct.unpack("<d", rng.randbytes(8))[0])
    if depth:
        some += [[random_value(rng, depth - 1) for _ in range(3)], {"x": random_value(rng, depth - 1)}]
    return rng.choice(some)
