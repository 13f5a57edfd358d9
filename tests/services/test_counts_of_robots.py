"""A running mapper that counts: its map is the same in whatever order the messages of its robots come."""

import math

import numpy as np

SECOND = 10**9
SWEEP = {"angle_min": -math.pi, "angle_increment": math.tau / 60, "time_increment": 0.0005}


def send(mapper, robot, k):
    """A pose, and a scan that is taken from then on, beam by beam."""
    rng = np.random.default_rng(k)
    place = {"robot": robot, "run": robot, "seq": k, "at": k * SECOND // 10}
    x = 2.0 * len(robot)
    mapper.pose(x + 0.1 * k, 0.05 * k, 0.03 * k * len(robot), **place)
    if k < 12:
        mapper.scan(rng.uniform(0.5, 9.0, 60), sensor="laser", **SWEEP, **place)


def test_the_order_of_messages_between_robots_does_not_matter(start_mapper, no_errors):
    both = [(robot, k) for k in range(13) for robot in ("a", "bcd")]
    maps = []
    for order in (both, sorted(both)):
        with start_mapper(
            map={"resolution": 0.1, "cell_model": "rate"}, mapper={"pose_wait": 60.0}
        ) as mapper:
            for robot, k in order:
                send(mapper, robot, k)
            assert mapper.settle(received=24)["scans"]["integrated"] == 24
            maps.append(mapper.http.get("/map.npz").raise_for_status().content)
    assert len(maps[0]) > 2000
    assert maps[0] == maps[1]
