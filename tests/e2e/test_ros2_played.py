"""A real robot's recording, played by nodes of others, through `ogm ros2` into a mapper: `make test-ros2`."""

import json
import os
import random
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field

import numpy as np
import pytest

import turtlebot4
from ogm_client.robot import RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from ogm_core.errors import NoPose
from ogm_core.placing.pose_history import PoseHistory
from ogm_core.ros2 import cdr
from ogm_core.wire.keys import MapKeys
from ogm_core.wire.messages import decode_pose, decode_scan
from ogm_services.mapper.intake.caches import Account, Caches
from witness import rclpy_node, zenoh_node

KEYS = MapKeys("default")
MOVING = {"reliable": True, "latched": False, "depth": 100}
LATCHED = {"reliable": True, "latched": True, "depth": 1}


@dataclass
class Sent:
    """What a mapper was sent."""

    poses: list = field(default_factory=list)
    scans: list = field(default_factory=list)

    @classmethod
    def kept_for(cls, session, robot):
        """All of it: what Zenoh drops on a busy machine the mapper asks for, as is done here."""
        caches, sent = Caches(session, KEYS, lambda _: 10**6), cls()
        for message in caches.ask(robot, caches.keys_of(robot), "", Account()).messages:
            if message.source.sensor is None:
                sent.poses.append(decode_pose(message.payload))
            else:
                sent.scans.append(decode_scan(message.payload))
        for messages in (sent.poses, sent.scans):
            messages.sort(key=lambda message: message.seq)
        return sent

    def placed(self):
        history = PoseHistory()
        for message in self.poses:
            history.append(message.stamp, message.pose)
        for scan in self.scans:
            with suppress(NoPose):
                yield scan, history.at(scan.stamp)


class Received:
    """The scans that a mapper has received."""

    def __init__(self, mapper):
        self._mapper = mapper

    def __len__(self):
        return self._mapper.status()["scans"]["received"]


@pytest.fixture
def domain():
    """A domain of DDS that nobody else is in, by all odds."""
    pytest.importorskip("cyclonedds", reason="the extra dds is not installed")
    return random.Random(os.urandom(8)).randint(1, 101)


@pytest.fixture
def mapped(ogm, domain, datasets, eventually):
    """`mapped(robots, *flags)`: what a mapper was sent when they played the recording, and its status."""
    said = list(turtlebot4.messages(datasets))
    statics = [message for message in said if message.topic == "/tf_static"]
    x, y, theta = turtlebot4.alignment(datasets)

    def mapped(robots, *flags, late):
        mapper = ogm.ready(ogm.mapper())
        for robot in robots:
            robot.ask(publish="/tf_static", type=cdr.TF_MESSAGE, **(LATCHED if late else MOVING))
        robots[0].ask(publish="/scan", type=cdr.LASER_SCAN, **MOVING)
        robots[0].ask(publish="/tf", type=cdr.TF_MESSAGE, **MOVING)

        def tell_statics():
            for robot, message in zip(robots, statics, strict=True):
                robot.ask(put="/tf_static", cdr=message.payload.hex())

        if late:
            tell_statics()
        with open_session(NetworkConfig(connect=(mapper.endpoint,))) as session:
            origin = f"domain{domain}:origin={x!r},{y!r},{theta!r}"
            feed = ogm.start(
                *("ros2", "--connect", mapper.endpoint, "--domain", domain, "--scan-delay", "-0.1"),
                *("--robot", origin, *flags),
            )
            eventually(lambda: all(robot.ask(heard="/tf_static")["count"] for robot in robots), timeout=120)
            if not late:
                tell_statics()
            turtlebot4.play(said, robots[0], {"/scan": Received(mapper)}, eventually)
            eventually(lambda: mapper.status()["poses"]["received"] == turtlebot4.TRANSFORMS)
            eventually(lambda: not mapper.status()["scans"]["pending"])
            sent = Sent.kept_for(session, f"domain{domain}")
            ended = feed.stop()
        told = ended.warnings.splitlines()
        assert (ended.code, len(told)) == (0, 2), ended
        assert "there is no map frame" in told[0]
        assert "time_increment" in told[1]
        return sent, mapper.status()

    return mapped


def test_a_recording_played_on_dds_and_on_zenoh(mapped, domain, datasets, listener, endpoint):
    with ExitStack() as running:
        names = ("/driver", "/urdf")
        nodes = [running.enter_context(rclpy_node("kilted", domain, name)) for name in names]
        on_dds, status = mapped(nodes, "--dds", "--interface", "lo", late=True)
    assert (len(on_dds.scans), len(on_dds.poses)) == (turtlebot4.SCANS, turtlebot4.TRANSFORMS)
    assert status["scans"]["integrated"] >= 356
    hits, share = turtlebot4.on_walls(datasets, on_dds.placed())
    assert hits > 190_000
    assert share >= 0.85
    with ExitStack() as running:
        nodes = [running.enter_context(zenoh_node("pyzeros", domain, endpoint, name)) for name in names]
        on_zenoh, _ = mapped(nodes, "--zenoh", endpoint, late=False)
    assert [(each.stamp, each.pose, each.seq) for each in on_zenoh.poses] == [
        (each.stamp, each.pose, each.seq) for each in on_dds.poses
    ]
    for one, other in zip(on_zenoh.scans, on_dds.scans, strict=True):
        assert one.ranges.tobytes() == other.ranges.tobytes()
        for name in one.__dataclass_fields__.keys() - {"ranges", "run"}:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("distribution", ["jazzy", "kilted"])
def test_a_display_of_ros_follows_the_map(ogm, distribution, domain, lab_recording, eventually):
    mapper = ogm.ready(ogm.mapper())
    where = "--domain", domain, "--connect", mapper.endpoint
    ogm.start("ros2", "--dds", "--interface", "lo", *where, "--publish-map", "/ogm/map")
    with rclpy_node(distribution, domain, "/display") as display:
        display.ask(subscribe="/ogm/map", type=cdr.OCCUPANCY_GRID, **LATCHED)
        display.ask(subscribe="/ogm/map_updates", type=cdr.OCCUPANCY_GRID_UPDATE, **LATCHED)

        replayed = ogm.run("replay", lab_recording, "--connect", mapper.endpoint, "--speed", "max")
        assert replayed.code == 0, replayed

        def shows_the_map():
            expected = trinary(mapper.get("map.pgm"))
            return np.array_equal(shown(display), expected)

        eventually(shows_the_map)
        (robot,) = mapper.status()["robots"].values()
        x, y, _ = robot["pose"]
        looks = {"angle_min": -1.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 10.0}
        with RobotPublisher("box", address=mapper.endpoint) as box:
            for _ in range(30):  # few cells change, so that is told as an update
                box.publish_scan([0.3] * 21, **looks, pose=(x, y, 0.0))
        eventually(lambda: display.ask(take="/ogm/map_updates")["values"])
        eventually(shows_the_map)
        info = display.ask(take="/ogm/map")["values"][-1]["info"]
    position, origin = info["origin"]["position"], json.loads(mapper.get("map.json"))["origin"]
    assert (position["x"], position["y"]) == (origin["x"], origin["y"])


def shown(display):
    """The last map, with the last update of it."""
    whole, updates = (display.ask(take=topic)["values"] for topic in ("/ogm/map", "/ogm/map_updates"))
    if not whole:
        return None
    info = whole[-1]["info"]
    cells = np.array(whole[-1]["data"], np.int8).reshape(info["height"], info["width"])
    for update in updates[-1:]:
        rows, columns = update["height"], update["width"]
        patch = np.array(update["data"], np.int8).reshape(rows, columns)
        cells[update["y"] : update["y"] + rows, update["x"] : update["x"] + columns] = patch
    return cells


def trinary(pgm):
    """Cells of a picture as nav2 reads it, row 0 south."""
    head, greys = pgm.rsplit(b"\n255\n", 1)
    width, height = map(int, head.split()[-2:])
    values = {0: 100, 254: 0, 205: -1}
    return np.vectorize(values.get)(np.frombuffer(greys, np.uint8).reshape(height, width))[::-1]
