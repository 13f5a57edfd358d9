"""What is erased while a robot maps at 40 Hz, and the mapper is killed, is erased between the same scans."""

import json
import signal
import threading
import urllib.request

import numpy as np
import pytest

from ogm_client import MapClient, RobotPublisher
from ogm_core.grid import OccupancyGrid
from ogm_core.tiles.polygon import Polygon
from ogm_core.types import Pose, Scan
from ogm_services.settings.settings import Settings

SWEEP = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 9.0}
STAMP = 10**18
PERIOD = 0.025
BOW = [(-2.0, -1.5), (3.0, 2.0), (3.0, -1.5), (-2.0, 2.0)]
"""It crosses itself."""


def scan_of(k):
    """Ranges, pose and stamp of scan k: round and round, so that what is erased is seen again."""
    ranges = np.random.default_rng(k).uniform(0.5, 4.5, 63).astype(np.float32)
    return ranges, (np.cos(k / 9), np.sin(k / 9), 0.3 * k), STAMP + int(k * PERIOD * 1e9)


class Driving:
    """A robot that publishes a scan every PERIOD until it is told to stop, whatever becomes of the mapper."""

    def __init__(self, endpoint):
        self.published = 0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(endpoint,))
        self._thread.start()

    def _run(self, endpoint):
        with RobotPublisher("r1", address=endpoint, run="first", reliable=True) as robot:
            robot.wait_for_mapper(60.0)
            while not self._ending.wait(PERIOD):
                ranges, pose, stamp = scan_of(self.published)
                robot.publish_scan(ranges, **SWEEP, pose=pose, stamp=stamp)
                self.published += 1

    def stop(self):
        self._ending.set()
        self._thread.join(60.0)


def erase(mapper, corners):
    """Erase a polygon; what is answered."""
    polygon = ",".join(str(value) for corner in corners for value in corner)
    request = urllib.request.Request(f"{mapper.url}erase?polygon={polygon}", method="POST")
    with urllib.request.urlopen(request, timeout=60) as response:
        return json.loads(response.read())


def map_of(count, erased, half_life):
    """The map of so many scans, with areas erased as these revisions."""
    grid = OccupancyGrid(Settings(map={"half_life": half_life}).grid_settings(), "e")
    k = 0
    while k < count or grid.revision + 1 in erased:
        if (area := erased.get(grid.revision + 1)) is not None:
            assert grid.erase(Polygon(area[0], grid.lattice)) == area[1]
            continue
        ranges, pose, stamp = scan_of(k)
        grid.integrate(Scan(ranges=ranges, stamp=stamp, **SWEEP), Pose(*pose))
        k += 1
    return grid.snapshot()


@pytest.mark.parametrize("half_life", [None, 1.0], ids=["keeps", "forgets"])
def test_it_is_the_map_of_these_scans_with_these_areas_erased_between_them(
    ogm, endpoint, eventually, tmp_path, half_life
):
    flags = ["--data", tmp_path / "data", "--listen", endpoint]
    flags += [] if half_life is None else ["--half-life", half_life]
    mapper, erased = ogm.ready(ogm.mapper(*flags)), {}
    driving = Driving(endpoint)
    rng = np.random.default_rng(1)

    try:
        for round_ in range(2):
            eventually(lambda m=mapper: m.status()["revision"] >= 40)
            for n in range(6):
                corners = BOW if n == 0 else rng.uniform(-2.0, 2.0, (5, 2)).tolist()
                answer = erase(mapper, corners)
                erased[answer["revision"]] = ([tuple(corner) for corner in corners], answer["cells"])
                eventually(lambda m=mapper, a=answer: m.status()["revision"] >= a["revision"] + 4)
            if round_ == 0:
                mapper.command.process.send_signal(signal.SIGKILL)
                mapper.command.process.wait()
                mapper = ogm.ready(ogm.mapper(*flags))
    finally:
        driving.stop()
    count = driving.published
    eventually(lambda: mapper.status()["revision"] == count + len(erased))
    assert len(erased) == 12
    assert sum(cells for _, cells in erased.values()) > 1000
    with MapClient(endpoint, timeout=60.0) as client:
        found = client.get_map()
    expected = map_of(count, erased, half_life)
    _, known = expected.published()
    cells = np.where(known, expected.log_odds(), np.nan).astype(np.float32)
    assert (found.offset, found.revision, found.stamp) == (
        expected.offset,
        expected.revision,
        expected.stamp,
    )
    np.testing.assert_array_equal(found.log_odds, cells)
    assert mapper.command.stop().code == 0
