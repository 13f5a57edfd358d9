"""Robots that come and go, as the log tells of them, on a clock that is told."""

import logging

import pytest

from ogm_core.placing.receipts import Presence, Receipts
from ogm_core.status import GONE_AFTER
from ogm_services.mapper.live.presence import MAX_LINES, RobotPresence


@pytest.fixture
def told(caplog):
    """`told(presence, now)`: what a look logs."""
    caplog.set_level(logging.INFO, "ogm_services")

    def look(presence, now):
        caplog.clear()
        presence.look(now)
        return [record.getMessage() for record in caplog.records]

    return look


def test_a_robot_with_a_token_comes_and_goes_with_it(told):
    receipts = Receipts()
    presence = RobotPresence(receipts.presence)
    receipts.robot_alive("r1", "a", True)
    assert told(presence, 0.0) == ["robot r1 came"]
    receipts.pose_received("r1", 0.5)
    assert told(presence, 1000.0) == []
    receipts.robot_alive("r1", "a", False)
    assert told(presence, 1000.1) == ["robot r1 went: it does not say any more that it is alive"]
    assert told(presence, 1000.2) == []
    receipts.robot_alive("r1", "b", True)
    assert told(presence, 1000.3) == ["robot r1 came"]


def test_a_robot_whose_token_goes_with_its_last_message_does_not_come_back_for_it(told):
    receipts = Receipts()
    presence = RobotPresence(receipts.presence)
    receipts.robot_alive("r1", "a", True)
    told(presence, 0.0)
    receipts.pose_received("r1", 1.0)
    receipts.robot_alive("r1", "a", False)
    assert len(told(presence, 1.1)) == 1
    assert told(presence, 1.2) == []
    receipts.pose_received("r1", 2.0)
    assert told(presence, 2.1) == ["robot r1 came"]
    assert told(presence, 2.0 + GONE_AFTER + 0.1) == ["robot r1 went: it has been silent for 60 s"]


def test_a_robot_that_is_forgotten_with_its_token_has_gone(told):
    receipts = Receipts()
    presence = RobotPresence(receipts.presence)
    receipts.robot_alive("r1", "a", True, 0.0)
    told(presence, 0.0)
    receipts.robot_alive("r1", "a", False, 0.5)
    assert receipts.forget("r1", 0.6)
    assert told(presence, 1.0) == ["robot r1 went: it does not say any more that it is alive"]
    assert told(presence, 2.0) == []


def test_a_robot_without_a_token_comes_with_a_message_and_goes_when_silent(told):
    receipts = Receipts()
    presence = RobotPresence(receipts.presence)
    receipts.pose_received("r1")
    assert told(presence, 0.0) == []
    receipts.pose_received("r1", 10.0)
    assert told(presence, 10.5) == ["robot r1 came"]
    assert told(presence, 10.0 + GONE_AFTER) == []
    assert told(presence, 10.1 + GONE_AFTER) == ["robot r1 went: it has been silent for 60 s"]
    receipts.pose_received("r1", 100.0)
    assert told(presence, 100.0) == ["robot r1 came"]


def test_a_flood_of_robots_is_a_few_lines(told):
    robots = {f"r{number}": Presence(True, None) for number in range(1000)}
    presence = RobotPresence(lambda: robots)
    came = told(presence, 0.0)
    assert len(came) == MAX_LINES + 1
    assert came[-1] == f"and {1000 - MAX_LINES} more robots came"
    robots = {name: Presence(False, None) for name in robots}
    assert told(presence, 1.0)[-1] == f"and {1000 - MAX_LINES} more robots went"


def test_robots_that_the_mapper_forgets_take_no_memory(told):
    robots = {"r1": Presence(True, 1.0)}
    presence = RobotPresence(lambda: robots)
    told(presence, 0.0)
    robots = {"r1": Presence(False, 1.0)}
    told(presence, 1.0)
    robots = {}
    told(presence, 2.0)
    assert (presence._here, presence._heard_last) == ({}, {})
