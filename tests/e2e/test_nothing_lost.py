"""A robot that goes on publishing while its mapper is killed: all of its scans are in the map in the end."""

import signal
import threading
import time

import httpx
import pytest

from ogm_client import RobotPublisher

SWEEP = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 9.0}
STAMP = 10**18
RATE = 40.0


class Drive(threading.Thread):
    """A robot at 40 Hz, poses and scans on keys of their own, until it is stopped."""

    def __init__(self, endpoint, scans):
        super().__init__()
        self._robot = RobotPublisher("r1", address=endpoint, run="drive", cache_samples=5000)
        self._scans = scans
        self.sent = 0
        self.finish = threading.Event()

    def run(self):
        began = time.monotonic()
        for k in range(self._scans):
            stamp = STAMP + int(k * 1e9 / RATE)
            self._robot.publish_pose(0.01 * k, 0.0, 0.02 * k, stamp=stamp)
            self._robot.publish_scan([2.0 + 0.01 * (k % 50)] * 20, **SWEEP, stamp=stamp)
            self.sent += 1
            time.sleep(max(0.0, began + (k + 1) / RATE - time.monotonic()))
        self.finish.wait(120.0)
        self._robot.close()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_map_after_kills_is_that_of_all_scans(ogm, endpoint, eventually, tmp_path, number):
    scans = 600
    mapper = ogm.ready(ogm.mapper("--listen", endpoint, "--data", tmp_path / "data"))
    drive = Drive(endpoint, scans)
    drive.start()
    try:
        for sent in (150, 350):
            eventually(lambda sent=sent: drive.sent >= sent, 60.0)
            mapper.command.process.send_signal(number)
            mapper.command.process.wait()
            mapper = ogm.ready(ogm.mapper("--listen", endpoint, "--data", tmp_path / "data"))
        eventually(lambda: mapper.status()["revision"] >= scans, 60.0)
        status = mapper.status()
        assert status["revision"] == scans
        assert status["scans"]["lost"] == 0
        served = httpx.get(f"{mapper.url}map.npz", timeout=30.0).content
    finally:
        drive.finish.set()
        drive.join()
    mapper.command.stop()

    again = ogm.ready(ogm.mapper("--listen", endpoint))
    calm = Drive(endpoint, scans)
    calm.start()
    try:
        eventually(lambda: again.status()["revision"] == scans, 60.0)
    finally:
        calm.finish.set()
        calm.join()
    assert httpx.get(f"{again.url}map.npz", timeout=30.0).content == served
