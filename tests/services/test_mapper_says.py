"""A running mapper says in its log, once for each kind of trouble and then now and then, what is wrong."""

import logging

from ogm_client import RobotPublisher

SWEEP = {"angle_min": -0.5, "angle_increment": 0.25, "range_min": 0.1, "range_max": 30.0}
T0 = 1_700_000_000_000_000_000


def warnings(caplog):
    return [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]


def test_two_publishers_under_one_name(start_mapper, caplog, eventually):
    """Each drives on its own way, and sends its scans to one mapper, one after the other."""
    with start_mapper() as mapper:
        at = {"address": mapper.endpoint, "map_name": "hall", "reliable": True}
        with RobotPublisher("r1", run="one", **at) as one, RobotPublisher("r1", run="two", **at) as two:
            one.wait_for_mapper(30.0)
            two.wait_for_mapper(30.0)
            sent = 0
            for k in range(40):
                stamp = T0 + k * 50_000_000
                for robot, x in ((one, 0.05 * k), (two, 9.0 - 0.05 * k)):
                    robot.publish_pose(x, 0.0, 0.0, stamp=stamp)
                    robot.publish_scan([1.0], **SWEEP, stamp=stamp)
                    sent += 1
                    eventually(lambda sent=sent: mapper.status()["scans"]["received"] == sent)
            status = mapper.settle(received=80)
    superseded = status["robots"]["r1"]["sources"]["laser"]["dropped"]["superseded"]
    assert status["poses"]["superseded"] == superseded == 39
    lines = warnings(caplog)
    for source, words in (
        (
            "r1/pose",
            "poses of run 'one' are refused, because run 'two' has replaced it: two publishers under one",
        ),
        (
            "r1/laser",
            "a scan is dropped (superseded): run 'one' was replaced by run 'two': two publishers under one",
        ),
    ):
        told = [line for line in lines if line.startswith(f"{source}: {words}")]
        assert 1 <= len(told) < 39


def test_each_kind_is_told_however_soon_after_another(start_mapper, caplog):
    with start_mapper() as mapper:
        mapper.pose(at=0, run="a")
        for k in range(20):
            mapper.scan([1.0], at=k, run="a", seq=0)
        mapper.scan([1.0], at=9 * 10**9, run="a", seq=1)
        mapper.pose(at=0, x=0.5, run="a", seq=1)
        mapper.scan([1.0], at=0, run="a", seq=2)
        mapper.settle(received=22)
    lines = warnings(caplog)
    for words in (
        "of this run and seq has come before",
        "numbering has begun anew",
        "ahead of",
        "stamps repeat",
    ):
        assert sum(words in line for line in lines) == 1, words


def test_who_has_reset_the_map_is_who_is_connected_whatever_a_request_says(mapper, caplog):
    """Over Zenoh nothing tells who asks, unless they say so themselves."""
    caplog.set_level(logging.INFO)
    forged = {"X-Forwarded-For": "203.0.113.9", "X-Forwarded-Proto": "https", "Forwarded": "for=203.0.113.9"}
    assert mapper.http.post("/reset", headers=forged).status_code == 200
    mapper.answer("reset")
    said = [record.getMessage() for record in caplog.records if "has reset the map" in record.getMessage()]
    assert [line.partition(" has ")[0] for line in said] == ["127.0.0.1 over HTTP", "somebody over Zenoh"]
