"""No scan is lost, and none is taken twice, whatever is killed or frozen: the map is that of all scans.

Each of these is longer, with more kills, in `make soak ARGS=missed`.
"""

import signal

import pytest

from tests.soak.missed import (
    mapper_frozen,
    mapper_killed,
    robots_frozen,
    robots_killed,
    robots_stopped,
    router_killed,
)


def test_a_mapper_that_is_killed_three_times_has_every_scan_of_a_robot_at_40_hz(tmp_path):
    found = mapper_killed(tmp_path, 3, robots=1, rate=40.0)
    assert found.right, found
    assert found.sent > 250


@pytest.mark.parametrize("rate", [2.0, 10.0])
def test_a_hundred_robots_that_publish_when_they_and_the_mapper_declare_lose_nothing(tmp_path, rate):
    found = mapper_killed(tmp_path, 2, robots=100, rate=rate)
    assert found.right, found
    assert found.sent > 200 * rate


def test_a_mapper_that_is_stopped_has_every_scan_as_well(tmp_path):
    found = mapper_killed(tmp_path, 1, robots=4, rate=40.0, number=signal.SIGTERM)
    assert found.right, found
    assert found.sent > 200


def test_a_mapper_that_is_frozen_for_10_s_has_every_scan(tmp_path):
    """Of a hundred robots there is more to come than its queue takes."""
    found = mapper_frozen(tmp_path, 10.0, robots=100, rate=10.0)
    assert found.right, found
    assert found.sent > 10_000


def test_robots_that_are_frozen_lose_nothing(tmp_path):
    found = robots_frozen(tmp_path, 3.0, rate=40.0)
    assert found.right, found
    assert found.sent > 160


def test_robots_that_are_killed_and_started_again_lose_nothing_that_had_left_them(tmp_path):
    found = robots_killed(tmp_path, 1, rate=40.0)
    assert found.right, found
    assert found.sent > 160


def test_a_router_that_is_killed_and_started_again_loses_nothing(tmp_path):
    found = router_killed(tmp_path, 2, robots=4, rate=40.0)
    assert found.right, found
    assert found.sent > 500


@pytest.mark.parametrize("routed", [False, True])
def test_robots_that_stop_while_the_mapper_or_the_router_is_away_lose_nothing(tmp_path, routed):
    found = robots_stopped(tmp_path, robots=4, rate=40.0, routed=routed)
    assert found.right, found
    assert found.sent > 160
