"""A robot that drives through a small room and publishes its poses and its LiDAR's scans to a mapper.

python examples/publish_a_robot.py --scans 200

Replace `drive` by your localisation and `measure` by your sensor.
"""

import argparse
import math
import sys
import time
from contextlib import suppress
from itertools import count

import numpy as np
from numpy.typing import NDArray

from ogm_client import DEFAULT_ADDRESS, OgmError, RobotPublisher

RANGE_MIN, RANGE_MAX = 0.1, 5.0
BEARINGS = np.linspace(-math.pi, math.pi, 360, endpoint=False)
MOUNT = (0.2, 0.0, 0.0)
"""The LiDAR sits 0.2 m ahead of the robot's base."""
WALLS = np.array(
    [
        (-3.02, -2.02, 3.02, -2.02),
        (3.02, -2.02, 3.02, 2.02),
        (3.02, 2.02, 0.50, 2.02),  # a door to the north ...
        (-0.50, 2.02, -3.02, 2.02),
        (-3.02, 2.02, -3.02, -2.02),
        (-0.32, -0.32, 0.32, -0.32),  # ... and a cupboard in the middle
        (0.32, -0.32, 0.32, 0.32),
        (0.32, 0.32, -0.32, 0.32),
        (-0.32, 0.32, -0.32, -0.32),
    ]
)
"""From (x0, y0) to (x1, y1), m."""


def drive(step: int) -> tuple[float, float, float]:
    """Pose of the robot's base in the map frame, m and rad: a lap of 100 steps round the cupboard."""
    turn = 2 * math.pi * step / 100
    return 1.8 * math.cos(turn), 1.1 * math.sin(turn), math.atan2(1.1 * math.cos(turn), -1.8 * math.sin(turn))


def measure(x: float, y: float, theta: float) -> NDArray[np.float64]:
    """Distance, m, from the LiDAR to the nearest wall along every bearing; inf where there is none."""
    x, y = x + MOUNT[0] * math.cos(theta), y + MOUNT[0] * math.sin(theta)
    dx, dy = np.cos(theta + BEARINGS)[:, None], np.sin(theta + BEARINGS)[:, None]
    x0, y0, x1, y1 = WALLS.T
    with np.errstate(divide="ignore", invalid="ignore"):  # a beam along a wall does not meet it
        across = dx * (y1 - y0) - dy * (x1 - x0)
        distance = ((x0 - x) * (y1 - y0) - (y0 - y) * (x1 - x0)) / across
        part = ((x0 - x) * dy - (y0 - y) * dx) / across
    return np.where((distance > 0) & (part >= 0) & (part <= 1), distance, np.inf).min(axis=1)


def main() -> None:
    """Drive and publish until the asked number of scans, or Ctrl-C."""
    parser = argparse.ArgumentParser(description="Publish a simulated robot's poses and scans.")
    parser.add_argument("--address", default=DEFAULT_ADDRESS, help="Zenoh endpoint of the mapper")
    parser.add_argument("--map", default="default", help="name of the map")
    parser.add_argument("--robot", default="robot7", help="name of the robot")
    parser.add_argument("--rate", type=float, default=20.0, help="scans a second")
    parser.add_argument("--scans", type=int, help="end after so many; without it Ctrl-C ends")
    options = parser.parse_args()
    if not options.rate > 0:
        parser.error("--rate: more than 0 is needed")
    if options.scans is not None and options.scans < 1:
        parser.error("--scans: 1 or more is needed")

    with RobotPublisher(options.robot, address=options.address, map_name=options.map) as robot:
        robot.wait_for_mapper()
        for step in count() if options.scans is None else range(options.scans):
            pose, now = drive(step), time.time_ns()
            robot.publish_pose(*pose, stamp=now)
            robot.publish_scan(
                measure(*pose),
                angle_min=BEARINGS[0],
                angle_increment=BEARINGS[1] - BEARINGS[0],
                range_min=RANGE_MIN,
                range_max=RANGE_MAX,
                mount=MOUNT,
                stamp=now,
            )
            time.sleep(1 / options.rate)


if __name__ == "__main__":
    try:
        with suppress(KeyboardInterrupt):
            main()
    except OgmError as error:
        sys.exit(f"publish_a_robot: {error}")
