"""Watch of `ogm ros2`: a mapper that is not there is told of once, and once when it is back."""

import logging
from types import SimpleNamespace

from gateway_desk import KEYS
from ogm_client.robot import RobotPublisher
from ogm_services.ros2.account import Account
from ogm_services.ros2.mapper_watch import MapperWatch
from ogm_services.ros2.robots import RobotKey, Robots
from ogm_services.runtime.limited_log import LimitedLog


def test_a_mapper_that_is_away_for_long_is_told_of_once_and_again_when_it_is_back(caplog):
    caplog.set_level(logging.INFO)
    robots, now = SimpleNamespace(heard=None), [0.0]
    watch = MapperWatch(robots, "hall", "at tcp/a:1", lambda: now[0])

    def said(heard, *times):
        robots.heard = heard
        caplog.clear()
        for now[0] in times:
            watch.look()
        return [record.getMessage() for record in caplog.records]

    assert said(None, 1, 30, 60) == []  # there is no robot yet
    assert said(True, 61, 62) == []
    assert said(False, 63, 72.9) == []
    assert said(True, 74) == []
    assert said(False, 75, 84.9) == []
    assert said(False, 86, 100, 200) == [
        "no mapper of map 'hall' takes the robots' poses and scans at tcp/a:1: is `ogm mapper` running "
        "there, with --map hall?"
    ]
    assert said(True, 201, 202) == ["a mapper of map 'hall' takes the robots' poses and scans again"]
    assert said(False, 203, 213.5) != []


def test_it_does_not_look_at_each_message():
    looked = []
    robots = type("Robots", (), {"heard": property(lambda self: looked.append(self))})()
    watch = MapperWatch(robots, "hall", "at tcp/a:1", iter([5.0, 5.1, 5.9, 6.0]).__next__)
    for _ in range(4):
        watch.look()
    assert len(looked) == 2


def test_a_robot_is_heard_by_who_subscribes_to_its_maps_robots(listener, network, eventually):
    session = network()
    account = Account(LimitedLog(logging.getLogger("test")))
    robots = Robots(lambda name: RobotPublisher(name, session=session, map_name="hall"), (), "map", account)
    try:
        assert robots.heard is None
        robots.take_on(RobotKey("here", "", ""), "r1", "map", odometry=False)
        assert robots.heard is False
        listener.declare_subscriber(KEYS.robots, lambda sample: None)
        eventually(lambda: robots.heard)
    finally:
        robots.close()
