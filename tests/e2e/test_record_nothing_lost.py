"""Nothing that robots publish is missing in a recording, or in it twice, whatever is killed or frozen.

Held against the map of all their messages as they were published, whose cells tell if one is missing.
"""

import signal
from dataclasses import dataclass
from pathlib import Path

import pytest

from ogm_client.session import NetworkConfig, open_session
from ogm_core.errors import BadRecording
from ogm_core.logs.recorded import RecordedPose
from ogm_core.wire.keys import MapKeys
from ogm_services.ros2.mcap_reader import McapReader
from tests.soak.drives import mapped, uninterrupted
from tests.soak.missed import POSE_FIRST, TELLING
from tests.soak.overload import differing
from tests.soak.services import Robots, Service

RATE = 40.0


@dataclass
class Scene:
    """Robots, a router, and a recorder, each a process."""

    router: Service
    robots: Robots
    recorder: Service
    path: Path

    @property
    def sent(self):
        return sum(self.robots.sent().values())

    def recorded(self):
        """What can be read so far."""
        with McapReader(self.path) as reader:
            try:
                return list(reader)
            except BadRecording:  # there is no scan yet
                return []


@pytest.fixture
def scene(tmp_path, endpoint, eventually):
    path = tmp_path / "a.mcap"
    with (
        Service("tests.soak.router", endpoint) as router,
        Service("ogm_services", "record", "--connect", endpoint, "-o", path) as recorder,
        Robots(endpoint, POSE_FIRST, RATE) as robots,
    ):
        scene = Scene(router, robots, recorder, path)
        eventually(lambda: path.exists() and len(scene.recorded()) > 20 * len(POSE_FIRST))
        yield scene


def assert_whole(scene, eventually):
    """Stop all, and compare: each robot's messages are there once, and give the map that they should."""
    sent = scene.robots.stop()
    eventually(lambda: len(scene.recorded()) >= sum(2 * count + 1 for count in sent.values()), 60.0)
    scene.recorder.end(signal.SIGTERM)
    found = scene.recorded()
    for robot, count in sent.items():
        mine = [each for each in found if each.robot == f"robot{robot}"]
        poses = [each.message.seq for each in mine if isinstance(each, RecordedPose)]
        scans = [each.message.seq for each in mine if not isinstance(each, RecordedPose)]
        assert (poses, scans) == (list(range(count + 1)), list(range(count)))
    made = mapped(((int(each.robot[5:]), [each.message]) for each in found), TELLING)
    assert (
        differing(made, uninterrupted({robot: [count] for robot, count in sent.items()}, RATE, TELLING)) == 0
    )


def after(scene, eventually, count=20):
    """Wait until each robot has published so many more."""
    before = scene.sent
    eventually(lambda: scene.sent >= before + count * len(POSE_FIRST), 60.0)


def test_a_router_is_killed_and_the_recorder_and_the_robots_stand_still(scene, eventually, endpoint):
    scene.router.end()
    after(scene, eventually)
    scene.router.start()
    after(scene, eventually)
    with scene.recorder.frozen():
        after(scene, eventually, 120)
    alive = MapKeys("default").alive("robot", "*", "*")
    with open_session(NetworkConfig(connect=(endpoint,), connect_timeout=60.0)) as session:
        eventually(lambda: list(session.liveliness().get(alive)), 60.0)
        with scene.robots.frozen():  # until they are taken for gone
            eventually(lambda: not list(session.liveliness().get(alive)), 60.0)
    after(scene, eventually)
    assert_whole(scene, eventually)


def test_a_recorder_that_comes_late(scene, eventually, tmp_path, endpoint):
    """What was published before it came is in the publishers' caches."""
    scene.recorder.end(signal.SIGTERM)
    after(scene, eventually)
    scene.path = tmp_path / "b.mcap"
    with Service("ogm_services", "record", "--connect", endpoint, "-o", scene.path) as scene.recorder:
        eventually(lambda: scene.path.exists() and scene.recorded())
        assert_whole(scene, eventually)
