"""Scans that come before their robot's poses: they wait for them, and what keeps these away is told."""

import pytest

import naive_cdr
from gateway_desk import MS, RANGES, Driver, S, all_heard, known, planar
from ros2_robots import RmwZenohRobot


def test_a_lidar_that_is_late_does_not_have_its_scans_before_the_poses(gateway, network):
    """A mapper waits for no pose that is much older than a scan."""
    driver = Driver(RmwZenohRobot(network()))
    found = gateway()
    found.until(all_heard(driver))
    for n in range(50):
        driver.drive(n, scan=False)
    (tf,) = found.work.conversion._poses.values()
    found.until(lambda: getattr(tf._tree.edge("base_link"), "newest", None) == 49 * 100 * MS)
    driver.drive(50)
    found.until(lambda: len(found.sent.order) == 52)
    assert found.sent.order.index("scan") >= 50


def scan_at(stamp):
    return naive_cdr.laser_scan(stamp, "laser", (-0.5, 0.5, 0.5, 0, 0.1, 0.1, 10.0), RANGES)


def test_scans_that_come_seconds_before_their_poses_wait_for_them(gateway, network):
    """As of a localisation that stalls: a mapper drops what is too far ahead of the newest pose."""
    driver = Driver(RmwZenohRobot(network()))
    found = gateway()
    found.until(all_heard(driver))
    for n in (0, 1):
        driver.drive(n)
    found.until(lambda: sorted(found.sent.order) == ["pose", "pose", "scan"])
    for n in range(2, 40):
        driver.scan(scan_at(n * 100 * MS))
    (feed,) = found.work.conversion._feeds.values()
    found.until(lambda: len(feed.waiting) == 28)
    found.until(lambda: len(found.sent.scans["domain0/scan"]) == 11)
    assert found.sent.scans["domain0/scan"][-1].stamp == 1100 * MS  # 1 s after the newest pose
    for n in range(2, 40):
        driver.drive(n, scan=False)
    found.until(lambda: len(found.sent.scans["domain0/scan"]) == 39)
    newest = 0
    for kind, message in zip(found.sent.order, messages_in_order(found.sent), strict=True):
        newest = message.stamp if kind == "pose" else newest
        assert message.stamp <= newest + S
    assert found.counts == {"domain0/scan": {"sent": 39}}


def messages_in_order(sent):
    poses, scans = iter(sent.poses["domain0"]), iter(sent.scans["domain0/scan"])
    return [next(poses if kind == "pose" else scans) for kind in sent.order]


def test_scans_whose_poses_never_come_are_the_mappers_to_judge(gateway, network, monkeypatch, caplog):
    monkeypatch.setattr("ogm_services.ros2.conversion.PATIENCE", 0.3)
    driver = Driver(RmwZenohRobot(network()))
    found = gateway()
    found.until(all_heard(driver))
    for n in (0, 1):
        driver.drive(n)
    found.until(lambda: sorted(found.sent.order) == ["pose", "pose", "scan"])
    driver.scan(scan_at(5 * S))
    found.until(lambda: [scan.stamp for scan in found.sent.scans["domain0/scan"]] == [50 * MS, 5 * S])
    assert found.counts == {"domain0/scan": {"sent": 2}}
    assert "waited: no transform that says where base_link moves to has come since" in caplog.text


@pytest.mark.parametrize(
    ("moving", "why"),
    [
        (True, "no transform from base_link to map: map -> odom: its newest sample is 1.100 s older"),
        (False, "every transform from base_link up to map is static, so none says when it was there"),
    ],
)
def test_what_keeps_a_robots_poses_from_coming_is_told(gateway, network, monkeypatch, caplog, moving, why):
    """As a localisation that has ended, of which else only the mapper would know something."""
    monkeypatch.setattr("ogm_services.ros2.conversion.PATIENCE", 0.3)
    driver = Driver(RmwZenohRobot(network()))
    found = gateway()
    found.until(all_heard(driver))
    if moving:
        driver.drive(0)
        driver.map_frame = False
        for n in range(1, 60):
            driver.drive(n, scan=False)
    else:
        still = (planar(0.0, 0.0, 0.0), planar(0.2, 0.0, 0.0))
        edges = [(0, "map", "base_link", still[0]), (0, "base_link", "laser", still[1])]
        driver.static(naive_cdr.tf_message(edges))
        found.until(lambda: known(found, "map"))
    driver.scan(scan_at(5 * S))
    found.until(lambda: len(found.sent.scans.get("domain0/scan", ())) == 1)
    assert (
        f"domain0/scan: no_pose: its scans go on without the robot's poses, for which they waited: {why}"
        in (caplog.text)
    )
