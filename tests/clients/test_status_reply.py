"""A status that was read is the one that was sent; mappers of other versions are understood."""

import dataclasses
import json

import pytest

from ogm_client.errors import BadReply
from ogm_client.status_reply import read_status
from ogm_core.status import PoseCounts, SourceStatus, StoreInfo, encode_status
from ogm_core.types import Pose
from status_json import STATUS


def sent():
    return json.loads(encode_status(STATUS))


def read(reply):
    return read_status(json.dumps(reply).encode())


def test_what_was_sent_is_read():
    assert read(sent()) == STATUS
    assert encode_status(read(sent())) == encode_status(STATUS)


@pytest.mark.parametrize("store", [StoreInfo(None, "a full disk", 0), StoreInfo(40, None, 4096)])
def test_what_a_mapper_says_of_its_store_is_read(store):
    status = dataclasses.replace(STATUS, store=store)
    assert read_status(encode_status(status)) == status


def test_what_only_a_newer_mapper_says_is_passed_over():
    newer = sent()
    newer["build"] = {"of": "tomorrow"}
    newer["scans"] |= {"lost": 3}
    newer["robots"]["r2"] |= {"battery": 0.5}
    newer["robots"]["r2"]["sources"]["front"] |= {"latency": 0.1}
    newer["scans"]["dropped"] |= {"superseded": 4}
    status = read(newer)
    assert status.scans.dropped == {"malformed": 0, "no_pose": 7, "superseded": 4}
    assert status.robots == STATUS.robots
    assert (status.map_info, status.poses) == (STATUS.map_info, STATUS.poses)


def test_reasons_that_an_older_mapper_does_not_know_are_not_needed():
    older = sent()
    older["scans"]["dropped"] = {}
    del older["run"]
    for name in ("lost", "replayed", "beams_on_robots"):
        del older["scans"][name]
    for name in ("restarted", "ambiguous", "outlier", "superseded", "refused", "lost", "replayed"):
        del older["poses"][name]
    for name in ("alive", "age_s"):
        del older["robots"]["r2"][name]
    for name in ("dropped", "hints", "lost", "beams_on_robots"):
        del older["robots"]["r2"]["sources"]["front"][name]
    status = read(older)
    assert (status.scans.dropped, status.scans.lost, status.scans.replayed, status.run) == ({}, 0, 0, "")
    assert status.poses == PoseCounts(received=60, malformed=1, late=3)
    robot = status.robots["r2"]
    assert (robot.pose, robot.alive, robot.age_s) == (Pose(1.0, -2.5, 0.1), False, None)
    assert robot.sources["front"] == SourceStatus("a", None, 40, 2, 33)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("scans",), None, "scans"),
        (("scans", "received"), "many", "scans.received"),
        (("robots", "r2", "pose"), [1.0, 2.0], "robots.r2.pose"),
        (("stamp",), 1.5, "stamp"),
        (("stamp",), True, "stamp: a whole number is needed, got bool"),
        (("map",), 7, "map: a text"),
        (("uptime_s",), "long", "uptime_s: a number"),
        (("uptime_s",), 10**400, "uptime_s: a number below"),
        (("map_info", "bytes"), 2**64, "map_info.bytes: a number below"),
        (("robots", "r2", "pose"), [1e300, 0.0, 0.0], "robots.r2.pose: a number below"),
        (("map",), "hall\x1b[2J", "map: a text has characters that cannot be shown"),
        (("robots",), {"x" * 500: None}, "robots.x{293}"),
        (("scans", "dropped"), {"\n": 1}, "scans.dropped: a text has characters"),
        (("robots",), [], "robots"),
        (("robots", "r2", "sources", "front", "received"), None, "robots.r2.sources.front.received"),
    ],
)
def test_what_is_no_status_is_refused_in_one_line(path, value, said):
    reply = sent()
    inner = reply
    for name in path[:-1]:
        inner = inner[name]
    inner[path[-1]] = value
    with pytest.raises(BadReply, match=rf"^status: {said}.*mapper of another version\?$") as caught:
        read(reply)
    assert "\n" not in str(caught.value)
    del inner[path[-1]]
    with pytest.raises(BadReply, match=r"^status: .*: missing"):
        read(reply)
