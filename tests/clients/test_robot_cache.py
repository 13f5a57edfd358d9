"""What a robot's publisher keeps for a mapper that has missed it, and that it says so."""

import numpy as np
import pytest
import zenoh

from ogm_client import RobotPublisher
from ogm_core.errors import BadSetting
from ogm_core.types import Pose, PoseStamped
from ogm_core.wire import messages

SWEEP = {"angle_min": -0.5, "angle_increment": 0.25, "range_min": 0.1, "range_max": 30.0}


def asked(session, key, parameters=""):
    """What the caches of a key answer, in order."""
    selector = f"ogm/v1/hall/robots/{key}/@adv/**{'?' if parameters else ''}{parameters}"
    replies = session.get(
        selector,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        accept_replies=zenoh.ReplyKeyExpr.ANY,
        timeout=30.0,
    )
    return [reply.ok for reply in replies]


def tokens(session):
    """The keys of which there are caches, by their liveliness tokens."""
    found = []
    for key in ("robots/*/pose", "robots/*/scan/*"):
        replies = session.liveliness().get(f"ogm/v1/hall/{key}/@adv/**", timeout=30.0)
        found += [str(reply.ok.key_expr).partition("/@adv/")[0] for reply in replies]
    return sorted(key.removeprefix("ogm/v1/hall/robots/") for key in found)


def scans(samples):
    return [messages.decode_scan(sample.payload.to_bytes()) for sample in samples]


def poses(samples):
    return [messages.decode_pose(sample.payload.to_bytes()) for sample in samples]


@pytest.fixture
def publisher(listener, endpoint):
    """Makes a robot's publisher, connected to `listener`, on which nobody subscribes."""

    def make(**options):
        return RobotPublisher("r1", address=endpoint, map_name="hall", **options)

    return make


def test_the_last_scans_of_each_sensor_and_five_times_as_many_poses_are_kept(listener, publisher, eventually):
    with publisher(cache_samples=3) as robot:
        for k in range(20):
            robot.publish_pose(float(k), 0.0, 0.0, stamp=k)
            robot.publish_scan([1.0 + k], sensor="low", stamp=k, **SWEEP)
            if k < 2:
                robot.publish_scan([5.0 + k], sensor="high", stamp=k, **SWEEP)
        eventually(lambda: len(tokens(listener)) == 3)
        assert tokens(listener) == ["r1/pose", "r1/scan/high", "r1/scan/low"]
        assert poses(asked(listener, "r1/pose")) == [
            PoseStamped(k, Pose(float(k), 0.0, 0.0), k, robot.run) for k in range(5, 20)
        ]
        low, high = scans(asked(listener, "r1/scan/low")), scans(asked(listener, "r1/scan/high"))
        assert [(scan.seq, scan.stamp, scan.run) for scan in low] == [(k, k, robot.run) for k in (17, 18, 19)]
        np.testing.assert_array_equal([scan.ranges[0] for scan in low], np.float32([18.0, 19.0, 20.0]))
        assert [scan.seq for scan in high] == [0, 1]
    assert asked(listener, "r1/pose") == []
    assert tokens(listener) == []


def test_a_part_of_what_is_kept_can_be_asked_for(listener, publisher, eventually):
    with publisher() as robot:
        for k in range(10):
            robot.publish_scan([1.0], stamp=k, **SWEEP)
        eventually(lambda: tokens(listener))
        part = asked(listener, "r1/scan/laser", "_sn=2..4")
        assert [
            (scan.seq, sample.source_info.source_sn) for scan, sample in zip(scans(part), part, strict=True)
        ] == [
            (2, 2),
            (3, 3),
            (4, 4),
        ]
        assert [scan.seq for scan in scans(asked(listener, "r1/scan/laser", "_max=2"))] == [8, 9]


def test_messages_that_are_given_are_kept_as_they_are(listener, publisher, eventually):
    given = PoseStamped(7, Pose(1.0, 2.0, 3.0), 41, "recorded")
    with publisher() as robot:
        robot.put_pose(given)
        eventually(lambda: tokens(listener))
        assert poses(asked(listener, "r1/pose")) == [given]


def test_nothing_is_kept_with_cache_samples_0(listener, publisher, eventually):
    got = []
    listener.declare_subscriber("ogm/v1/hall/robots/**", zenoh.handlers.Callback(got.append, indirect=False))
    with publisher(cache_samples=0) as robot:
        robot.wait_for_mapper(30.0)
        robot.publish_pose(1.0, 2.0, 3.0, stamp=1)
        eventually(lambda: got)
        assert asked(listener, "r1/pose") == []
        assert tokens(listener) == []


@pytest.mark.parametrize("wrong", [-1, 100_001, 1.5, True, None])
def test_a_wrong_number_of_scans_to_keep_is_refused(listener, wrong):
    with pytest.raises(BadSetting, match="cache_samples: 0 to 100000 are needed"):
        RobotPublisher("r1", session=listener, cache_samples=wrong)
