"""Bags of real and simulated robots become maps, or are refused in a line that says what is missing."""

import json

import numpy as np
import pytest
from PIL import Image

import turtlebot4
from ogm_core.logs.recorded import RecordedPose
from ogm_core.placing.pose_history import PoseHistory
from ogm_core.types import Pose
from ogm_services.ros2.bag_reader import BagOptions, BagReader
from ogm_services.ros2.options import Ros2Options
from ogm_services.settings.settings import Settings

AS_SORTED = "mapper: {max_speed: .inf, max_turn_rate: .inf}"
"""The bag of the real building was sorted by stamps, which go back in its log: its poses jump."""


def hits(ogm, name="built"):
    return json.loads((ogm.folder / name / "quality.json").read_text())["consistency"]["hits"]


@pytest.mark.parametrize(
    ("bag", "flags", "counts", "share"),
    [
        ("tb3walker", "", "92 scans read, 92 integrated", 0.80),
        ("neato23_square_drive_bag_2", "--scan-topic /scan --sensor *:deskew=auto", "178 scans read", 0.46),
        ("neato23_square_bag_one", "--scan-topic /scan --sensor *:deskew=auto", "187 scans read", 0.29),
    ],
)
def test_maps_of_small_bags_are_as_sharp_as_their_poses(ogm, datasets, bag, flags, counts, share):
    """The shares are those of the README beside the bags."""
    ended = ogm.call("build", datasets / "bags" / bag, "--out", "built", *flags.split())
    assert ended.code == 0
    assert counts in ended.out
    assert hits(ogm) == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize(
    ("bag", "why"),
    [
        ("ros1/no_scan.bag", "holds no LaserScan; there are /tf (tf2_msgs/msg/TFMessage)"),
        ("ros1/maps_only.bag", "holds no LaserScan; there are /map (nav_msgs/msg/OccupancyGrid)"),
        ("ros1/laser_frame_missing.bag", "no tf says where laser is; there are back_left_wheel, back_right"),
        ("neato23_square_bag_one", "say which to map by --scan-topic: /scan (187), /stable_scan (186)"),
    ],
)
def test_bags_that_lack_something_are_refused(ogm, datasets, bag, why):
    complaint = ogm.call("build", datasets / "bags" / bag, "--out", "built").complaint(2)
    assert why in complaint
    assert complaint.count("\n") == 1
    assert not (ogm.folder / "built").exists()


def test_a_laser_without_a_frame_is_mounted_by_hand(ogm, datasets):
    bag = datasets / "bags" / "ros1" / "laser_frame_missing.bag"
    ended = ogm.call("build", bag, "--mount", "0.3,0,0", "--out", "built")
    assert (ended.code, ended.out) == (0, "built: 102 scans read, 101 integrated, 1 dropped: stale\n")


def test_a_building_from_its_bag_and_from_its_log(ogm, intel):
    """Nearly all cells are equal: the bag's stamps are in another order, and its poses went through tf."""
    ogm.file("sorted.yaml", AS_SORTED)
    for log, name in {"mcap": "bag", "intel-corrected.log.gz": "log"}.items():
        ended = ogm.call("build", intel / log, "--config", "sorted.yaml", "--out", name)
        assert (ended.code, ended.out) == (0, f"{name}: 910 scans read, 910 integrated\n")
    bag, log = (ogm.map(f"{name}/map.npz") for name in ("bag", "log"))
    np.testing.assert_array_equal(bag["origin"], log["origin"])
    common = ~np.isnan(bag["log_odds"]) & ~np.isnan(log["log_odds"])
    assert common.sum() > 3_000_000
    one, other = bag["log_odds"][common], log["log_odds"][common]
    assert np.mean(one == other) >= 0.9998
    assert np.mean((one > 0.0) == (other > 0.0)) >= 0.99999
    classes = [np.asarray(Image.open(ogm.folder / name / "map.pgm")) for name in ("bag", "log")]
    assert not any(np.any((a == 0) & (b == 254)) for a, b in (classes, classes[::-1]))


@pytest.mark.parametrize("kind", ["rosbag2_sqlite3", "rosbag2_mcap"])
def test_readings_of_a_real_robots_bag_lie_on_the_walls_of_its_floor(datasets, kind):
    options = BagOptions(Ros2Options(scan_delay=turtlebot4.DELAY))
    history, scans, aligned = PoseHistory(), [], Pose(*turtlebot4.alignment(datasets))
    with BagReader(turtlebot4.folder(datasets) / kind, options, Settings()) as messages:
        for each in messages:
            if isinstance(each, RecordedPose):
                history.append(each.message.stamp, aligned.compose(each.message.pose))
            else:
                scans.append(each.message)
    found, share = turtlebot4.on_walls(datasets, ((scan, history.at(scan.stamp)) for scan in scans))
    assert found > 190_000
    assert share >= 0.85
