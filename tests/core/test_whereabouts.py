"""Which of many robots a scan may have seen: none is left out, however fast they drive and late it comes."""

import math

import numpy as np
import pytest

from mapper_desk import Desk
from ogm_core.grid_settings import GridSettings
from ogm_core.placing.robot_rules import RobotRule, RobotRules
from ogm_core.placing.whereabouts import Whereabouts
from ogm_core.sensor_models.hits import hits_at_robots
from ogm_core.types import Pose

ROBOTS = [f"r{n}" for n in range(12)]
RADIUS = 0.4
POSES = 60
"""Of each robot, 100 ms apart."""


def drives(rng):
    """Places of robots at each of their poses, m: at up to 15 m/s they come close to each other, late."""
    met, speed = rng.uniform(0, 12, (len(ROBOTS), 2)), rng.uniform(-11, 11, (len(ROBOTS), 2))
    return met[:, None] + speed[:, None] * 0.1 * np.arange(-0.8 * POSES, 0.2 * POSES)[:, None]


@pytest.mark.parametrize("sweep", [0.0, 0.02])
def test_who_is_near_is_skipped_and_nobody_else(sweep):
    rng = np.random.default_rng(4)
    places = drives(rng)
    found = Desk(radii=[("*", RADIUS)], mark_hits=hits_at_robots(GridSettings()), max_speed=math.inf)
    for k in range(POSES):
        for robot, at in zip(ROBOTS, places[:, k], strict=True):
            found.pose(100 * k, Pose(*at, 0.0), robot=robot)
    skipped = 0
    last = 100 * POSES - 560
    for ms in (*range(30, 4200, 400), *range(4430, last, 60)):  # long after the poses around them, and soon
        own = rng.integers(len(ROBOTS))
        times = ms + 1000 * sweep * np.arange(24)
        at = np.array([[np.interp(times, 100 * np.arange(POSES), xy) for xy in robot.T] for robot in places])
        # Every beam looks to where a robot is when it is taken, and reads that distance, or another.
        to = (own + 1 + np.arange(24) % (len(ROBOTS) - 1)) % len(ROBOTS)
        way = at[to, :, np.arange(24)] - at[own, :, np.arange(24)]
        away, bearing = np.hypot(*way.T), np.arctan2(way[:, 1], way[:, 0])
        for beam in np.flatnonzero(away < 7.0):
            for off, seen in ((0.3, True), (0.5, False)):
                before = len(found.sink.scans)
                found.scan(
                    ms,
                    robot=ROBOTS[own],
                    sensor=f"s{beam % 16}",
                    seq=before,
                    time_increment=sweep,
                    angle_increment=1e-12,
                    mount=Pose(0.0, 0.0, bearing[beam]),
                    ranges=np.full(24, away[beam] + off, np.float32),
                )
                end = at[own, :, beam] + (away[beam] + off) * way[beam] / away[beam]
                others = [n for n in range(len(ROBOTS)) if n != own]
                near = np.hypot(*(at[others, :, beam] - end).T).min() < RADIUS
                assert near == (seen or near)
                (scan,) = found.sink.scans[before:]
                assert math.isnan(scan.ranges[beam]) == near
                skipped += near
    assert skipped > 100


def test_a_robot_that_is_forgotten_is_nowhere_and_its_row_is_another_s():
    robots = Desk(radii=[("*", RADIUS)])
    for n in range(40):
        robots.pose(0, Pose(float(n), 0.0, 0.0), robot=f"a{n}")
    table = Whereabouts(RobotRules([RobotRule("a*", RADIUS)]))
    for n in range(40):
        table.moved(f"a{n}")
    known = robots.placer._robots.get

    def near(x, robot="z"):
        looked = table.look(robot, known, (0, 10**9, 0), (x, 0.0, x, 0.0), 0.1)
        return [history.newest_pose.x for history, _ in looked.near]

    stamp = robots.placer._robots.get("a0").poses.newest
    found = table.look("z", known, (stamp, 10**9, stamp), (7.0, 0.0, 8.0, 0.0), 0.1)
    assert [history.newest_pose.x for history, _ in found.near] == [7.0, 8.0]
    assert [radius for _, radius in found.near] == [RADIUS] * 2
    assert len(table.look("a7", known, (stamp, 10**9, stamp), (7.0, 0.0, 8.0, 0.0), 0.1).near) == 1
    table.forget("a7")
    assert near(7.0) == []
    robots.pose(0, Pose(7.1, 0.0, 0.0), robot="a40")
    table.moved("a40")
    found = table.look("z", known, (stamp, 10**9, stamp), (7.0, 0.0, 7.0, 0.0), 0.1)
    assert [history.newest_pose.x for history, _ in found.near] == [7.1]
    assert len(table._names) == 40


def test_those_whose_stamps_are_far_away_are_told_of_when_they_change():
    robots = Desk(radii=[("*", RADIUS)])
    robots.pose(0, Pose(0.0, 0.0, 0.0), robot="a").pose(5000, Pose(0.0, 0.0, 0.0), robot="b")
    table = Whereabouts(RobotRules([RobotRule("*", RADIUS)]))
    table.moved("a")
    table.moved("b")
    known, here = robots.placer._robots.get, (0.0, 0.0, 0.0, 0.0)
    own, other = (known(name).poses.newest for name in "ab")

    def apart():
        return table.look("a", known, (own, 10**9, own), here, 8.0)

    assert apart() == ([], [("b", other)])
    assert apart() == ([], [])
    robots.pose(5100, Pose(0.0, 0.0, 0.0), robot="b")
    table.moved("b")
    assert apart() == ([], [("b", other + 10**8)])
