"""Robots of the soak: a name and a number say what is sent, so that a map can be made again."""

import functools
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.workloads import simulated
from ogm_core.simulation.lidar import Lidar
from ogm_core.simulation.worlds import lab
from ogm_core.types import PlacedScan, Pose, PoseStamped, Scan
from ogm_core.wire.messages import encode_pose
from tests.soak.encoded import Encoded

T0 = 1_700_000_000_000_000_000
PERIOD = 50_000_000
"""Between two scans, ns by their stamps."""
SENSORS = 16


@dataclass(frozen=True)
class Kind:
    """What a kind of robot sends: scans of so many beams; `sends_poses`, or each scan carries its own."""

    lidar: Lidar
    stops: int
    """Poses of a lap that it has scans of."""
    sends_poses: bool = False
    sensors: int = 1


KINDS = {
    "honest": Kind(Lidar.lab(), 220, sends_poses=True),
    "flood": Kind(Lidar(beams=8000, fov=4.712, range_max=30.0), 64, sensors=SENSORS),
    "heavy": Kind(Lidar(beams=200_000, fov=6.28, range_max=100.0), 1),
}


@functools.cache
def lap(kind: str) -> list[PlacedScan]:
    """The scans of a lap through the lab; a heavy robot stands, and its beams are as long as can be."""
    chosen, world = KINDS[kind], lab()
    if kind == "heavy":
        pose, lidar = Pose(0.5, 0.5, 0.0), chosen.lidar
        ranges = np.full(lidar.beams, lidar.range_max, np.float32)
        scan = Scan(0, lidar.angle_min, lidar.angle_increment, 0.0, lidar.range_max, ranges, pose=pose)
        return [PlacedScan(scan, pose)]
    every = world.path.count // chosen.stops
    poses = [world.path.pose(k * every) for k in range(chosen.stops)]
    return simulated(world, poses, chosen.lidar, np.random.default_rng(len(kind)))


def placed(robot: str, number: int) -> PlacedScan:
    """The scan of that number, as the robot sends it, and where its sensor then is."""
    kind = robot.partition("-")[0]
    known = lap(kind)[number % KINDS[kind].stops]
    pose = None if KINDS[kind].sends_poses else known.pose
    return PlacedScan(
        replace(known.scan, stamp=T0 + number * PERIOD, seq=number, run=robot, pose=pose), known.pose
    )


def messages(robot: str, number: int) -> list[tuple[str, bytes]]:
    """Keys, below the robot's, and payloads of that number: its pose, where it sends poses, and its scan."""
    kind = KINDS[robot.partition("-")[0]]
    payload = _encoded(robot, number % kind.stops).message(T0 + number * PERIOD, number)
    scan = (f"scan/laser{number % kind.sensors}", payload)
    if not kind.sends_poses:
        return [scan]
    here = placed(robot, number)
    return [("pose", encode_pose(PoseStamped(here.scan.stamp, here.pose, number, robot))), scan]


@functools.cache
def _encoded(robot: str, number: int) -> Encoded:
    """The scan of that number, encoded once a lap."""
    return Encoded.of(placed(robot, number).scan)
