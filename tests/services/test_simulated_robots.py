"""Simulated robots see each other where they are, if they have a radius; the true world has none in it."""

import math

import numpy as np
import pytest

from ogm_services.commands.simulator import Simulation
from ogm_services.commands.simulator_options import SimulatorOptions

HALL = """
name: hall
walls: [[0, 0, 20, 0], [20, 0, 20, 6], [20, 6, 0, 6], [0, 6, 0, 0]]
path: {waypoints: [[2, 3], [9, 3]], spacing: 1.0}
"""


@pytest.fixture
def simulated(tmp_path):
    (tmp_path / "hall.yaml").write_text(HALL)
    options = {"world": str(tmp_path / "hall.yaml"), "robots": 3, "seed": 1, "noise": 0.0, "beams": 720}

    def make(radius):
        return Simulation(SimulatorOptions(**options, range_max=30.0, robot_radius=radius))

    return make


def test_a_robot_s_outline_is_what_the_others_measure(simulated):
    blind, seeing = simulated(None), simulated(0.4)
    for step in range(40):
        poses = [seeing.world.path.pose(step + robot * seeing.world.path.count // 3) for robot in range(3)]
        for robot, (x, y, theta) in enumerate(poses):
            pose, ranges = seeing.step(robot, step)
            assert pose == (x, y, theta)
            bearings = theta + seeing.lidar.bearings
            ends = np.array((x, y)) + ranges[:, None] * np.stack((np.cos(bearings), np.sin(bearings)), 1)
            others = [other for n, other in enumerate(poses) if n != robot]
            away = np.min([np.hypot(*(ends - other[:2]).T) for other in others], axis=0)
            at_one = np.abs(away - 0.4) < 1e-5
            before = blind.step(robot, step)[1]
            assert (ranges[~at_one] == before[~at_one]).all()
            assert away.min() > 0.4 - 1e-5
            widest = min(math.hypot(other[0] - x, other[1] - y) for other in others)
            assert np.count_nonzero(at_one) >= (
                720 * math.asin(0.4 / widest) / math.pi - 2 if widest > 0.4 else 1
            )


def test_the_true_world_has_no_robots_in_it(simulated):
    seeing = simulated(0.4)
    seeing.step(0, 0)
    assert seeing.world.circles.size == 0


@pytest.mark.parametrize(("rate", "warned"), [(5.0, False), (20.0, False), (30.0, True)])
def test_a_speed_that_no_mapper_believes_is_warned_of(simulated, caplog, rate, warned):
    """Its poses are 1 m apart, and it turns back in steps of pi / 16."""
    assert simulated(None).fastest(rate) == pytest.approx(rate)
    said = f"{rate:g} m/s and turn up to {rate * math.pi / 16:.3g} rad/s, more than a mapper believes"
    assert [said in record.getMessage() for record in caplog.records] == [True] * warned


def test_so_is_a_turn_that_is_too_fast(caplog):
    office = Simulation(SimulatorOptions("office"))
    assert office.fastest(200.0) == pytest.approx(20.0)
    assert "turn up to 39.3 rad/s" in caplog.text
