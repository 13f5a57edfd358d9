"""Bags of real and simulated robots become maps, or are refused in a line that says what is missing."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import turtlebot4
from ogm_core.cells.classes import trinary
from ogm_core.grid import OccupancyGrid
from ogm_core.logs.recorded import RecordedPose, RecordedScan
from ogm_core.placing.pose_history import PoseHistory
from ogm_core.types import Pose
from ogm_services.commands.log_readers import AS_IT_SAYS, log_reader
from ogm_services.ros2.bag_reader import BagOptions, BagReader
from ogm_services.ros2.options import Ros2Options
from ogm_services.settings.settings import Settings

AS_SORTED = "mapper: {max_speed: .inf, max_turn_rate: .inf}"
"""The bag of the real building was sorted by stamps, which go back in its log: its poses jump."""


BY_BEAM = "--scan-topic /scan --sensor *:deskew=auto"


@pytest.mark.parametrize(
    ("bag", "flags", "scans", "hits", "within"),
    [
        ("tb3walker", "", 92, 0.80, 0.945),
        ("neato23_square_drive_bag_2", BY_BEAM, 178, 0.46, 0.56),
        ("neato23_square_bag_one", BY_BEAM, 187, 0.29, 0.41),
        ("neato23_square_drive_bag_2", "--scan-topic /scan", 178, 0.50, 0.58),
        ("neato23_square_drive_bag_2", "--scan-topic /stable_scan", 178, 0.73, 0.79),
    ],
)
def test_maps_of_small_bags_are_as_sharp_as_their_poses(ogm, datasets, bag, flags, scans, hits, within):
    """The first three are the figures of the README beside the bags, to 0.02.

    Those of the Neato's were taken beam by beam: its scans do say when each was taken (0.56 ms apart), and
    the map is worse for it, as that is not true of `/scan`. Taken as a whole, as here by default, and by its
    other topic, whose stamps are better, it is sharper.
    """
    ended = ogm.call("build", datasets / "bags" / bag, "--out", "built", "--hold-out", 10, *flags.split())
    assert ended.code == 0
    assert f"{scans} scans read" in ended.out
    quality = json.loads((ogm.folder / "built" / "quality.json").read_text())
    assert quality["consistency"]["hits"] == pytest.approx(hits, abs=0.02)
    assert quality["held_out"]["within_0_1_m"] == pytest.approx(within, abs=0.02)


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
    """Nearly all cells are equal; next test: what those come from that are not.

    A class is whether a cell is rather occupied. Of the three classes of map.pgm 99.9947 % are equal: those
    that one beam more makes free have had one beam, or two.
    """
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
    assert np.mean(trinary_of(one) == trinary_of(other)) >= 0.99994
    classes = [np.asarray(Image.open(ogm.folder / name / "map.pgm")) for name in ("bag", "log")]
    assert not any(np.any((a == 0) & (b == 254)) for a, b in (classes, classes[::-1]))


@pytest.mark.parametrize(("suffix", "size"), [("mcap", 1_500_000), ("db3", 1_800_000)])
def test_a_bag_that_was_cut_is_replayed_as_it_is_built(ogm, datasets, assert_equal_maps, suffix, size):
    """As far as it goes, by the same flags; all three commands say how far."""
    (whole,) = turtlebot4.folder(datasets).glob(f"rosbag2_*/*.{suffix}")
    (ogm.folder / f"cut.{suffix}").write_bytes(whole.read_bytes()[:size])
    starting = ogm.mapper()
    built = ogm.call("build", f"cut.{suffix}", "--scan-delay", "-0.1", "--out", "built")
    cut = f"cut.{suffix} was cut short, and is read as far as it goes: "
    assert built.code == 0
    assert cut in built.err
    scans = int(built.out.split(" scans read")[0].removeprefix("built: "))
    assert 100 < scans < 250
    mapper = ogm.ready(starting)
    flags = "--connect", mapper.endpoint, "--scan-delay", "-0.1", "--speed", "max"
    replayed = ogm.call("replay", f"cut.{suffix}", *flags)
    assert replayed.code == 0
    assert f"{scans} scans sent, {scans} integrated" in replayed.out
    assert cut in replayed.out
    assert_equal_maps(mapper.map(), ogm.map("built/map.npz"))
    assert f"note: {cut}" in ogm.call("info", f"cut.{suffix}").out


def trinary_of(log_odds):
    return trinary(1.0 / (1.0 + np.exp(-log_odds)), np.ones(log_odds.shape, bool))


def test_all_that_a_bag_changes_of_a_log_is_the_order_and_the_precision_of_angles(intel):
    """With the bag's order and the angles of a LaserScan, in float32, the log gives the same cells."""
    read = {}
    for log in ("mcap", "intel-corrected.log.gz"):
        with log_reader(intel / log, AS_IT_SAYS, Settings())() as messages:
            read[log] = list(messages)
    history, grids = PoseHistory(), [OccupancyGrid(Settings().grid_settings()) for _ in range(2)]
    for each in read["mcap"]:
        if isinstance(each, RecordedPose):
            history.append(each.message.stamp, each.message.pose)
    for scan in (each.message for each in read["mcap"] if isinstance(each, RecordedScan)):
        grids[0].integrate(scan, history.at(scan.stamp))
    for scan in sorted(
        (each.message for each in read["intel-corrected.log.gz"]), key=lambda scan: scan.stamp
    ):
        angles = {name: float(np.float32(getattr(scan, name))) for name in ("angle_min", "angle_increment")}
        grids[1].integrate(replace(scan, **angles), scan.pose)
    bag, log = (grid.snapshot() for grid in grids)
    assert bag.origin == log.origin
    np.testing.assert_array_equal(bag.log_odds(), log.log_odds())


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
