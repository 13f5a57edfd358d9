"""Nothing that a mapper misses is lost, and nothing is taken twice: processes that are killed and frozen."""

import pytest

from tests.noting_mapper import Noted
from tests.soak.missed import (
    Outcome,
    mapper_frozen,
    mapper_killed,
    outcome,
    robot_frozen,
    robots_stopped,
    router_killed,
)


def test_a_mapper_that_is_killed_five_times_misses_nothing_of_a_robot_at_40_hz(tmp_path):
    found = mapper_killed(tmp_path, 5, robots=1, rate=40.0)
    assert found.right, found
    assert found.sent > 400


def test_twenty_robots_that_publish_when_they_and_the_mapper_declare_lose_nothing(tmp_path):
    found = mapper_killed(tmp_path, 4, robots=20, rate=10.0)
    assert found.right, found
    assert found.sent > 1000


def test_a_mapper_that_is_frozen_misses_nothing(tmp_path):
    found = mapper_frozen(tmp_path, 4.0, robots=4, rate=40.0)
    assert found.right, found
    assert found.sent > 1000


def test_a_robot_that_is_frozen_loses_nothing(tmp_path):
    found = robot_frozen(tmp_path, 4.0)
    assert found.right, found
    assert found.sent > 100


def test_a_router_that_is_killed_and_started_again_loses_nothing(tmp_path):
    found = router_killed(tmp_path, 2, robots=3, rate=40.0)
    assert found.right, found
    assert found.sent > 500


def test_robots_that_stop_while_the_mapper_is_away_lose_nothing(tmp_path):
    found = robots_stopped(tmp_path, robots=3, rate=40.0)
    assert found.right, found
    assert found.sent > 200


@pytest.mark.parametrize(
    ("wrong", "counts"),
    [
        ({"seqs": [0, 1, 2]}, (6, 0, 0, 0)),
        ({"seqs": [0, 2]}, (5, 1, 0, 0)),
        ({"seqs": [0, 1, 1, 2]}, (7, 0, 1, 0)),
        ({"seqs": [0, 2, 1]}, (6, 0, 0, 1)),
    ],
)
def test_what_is_wrong_would_be_seen(wrong, counts):
    noted = Noted()
    noted.taken["robot0"] = [("pose", "a", seq, 0) for seq in range(3)]
    noted.taken["robot0"] += [("laser", "a", seq, 0) for seq in wrong["seqs"]]
    found = outcome(noted, {"robot0": 3})
    assert found == Outcome(6, *counts, lost=0, replayed=0)
    assert found.right == (wrong["seqs"] == [0, 1, 2])
