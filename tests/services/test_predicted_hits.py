"""Every tenth scan is judged by the newest copy of the map, before it is integrated."""

import math

import numpy as np
import pytest

from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.quality.first_walls import count_hits, first_walls
from ogm_core.quality.held_out_beams import beams_of
from ogm_core.quality.judged_map import JudgedMap
from ogm_core.simulation.lidar import Lidar, measure
from ogm_core.simulation.worlds import lab
from ogm_core.tiles.polygon import Polygon
from ogm_core.types import PlacedScan, Pose, Scan
from ogm_services.mapper.live import predicted_hits
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.predicted_hits import EVERY, PredictedHits

SETTINGS = GridSettings(resolution=0.1)


def wall(distance, beams=1):
    return Scan(0, 0.0, 0.01, 0.0, 30.0, np.full(beams, distance, np.float32))


@pytest.fixture(scope="module")
def placed():
    """Scans of a lap through the lab."""
    sensor, path, rng = Lidar.lab(), lab().path, np.random.default_rng(1)
    return [
        PlacedScan(
            Scan(
                i,
                sensor.angle_min,
                sensor.angle_increment,
                0.0,
                8.0,
                measure(lab(), path.pose(i), sensor, rng),
            ),
            path.pose(i),
        )
        for i in range(0, 220, 5)
    ]


@pytest.mark.parametrize("model", ["beam", "sector"])
def test_hits_are_those_of_the_whole_map(placed, model):
    settings = GridSettings(resolution=0.1, sensor_model=model)
    grid, total = OccupancyGrid(settings, "e"), [0, 0]
    for n, (scan, pose, _) in enumerate(placed):
        if n % 2:
            grid.integrate(scan, pose)
    snapshot = grid.snapshot()
    far = [PlacedScan(wall(2.0), Pose(x, 0.0, 0.0)) for x in (60.0, 1e12, -1e300)]  # no cell is there
    for one in [*placed[::2], *far]:
        whole = first_walls(JudgedMap.of(snapshot), beams_of([one], settings).rays)
        hits, judged = count_hits(snapshot, one, settings, 360)
        assert hits == round(whole.hit * judged)
        assert 0 <= count_hits(snapshot, one, settings, 100)[1] <= 90  # every fourth of 360
        total = [total[0] + hits, total[1] + judged]
    assert 0.5 < total[0] / total[1] < 1.0


class Watched:
    """A live map, and what judges its scans."""

    def __init__(self):
        self.live = LiveMap(OccupancyGrid(SETTINGS, "first"))
        self.hits = PredictedHits(self.live)

    def scans(self, distance, count=EVERY, theta=0.0):
        for _ in range(count):
            self.live.integrate(wall(distance), Pose(0.05, 0.05, theta))


@pytest.fixture
def watched():
    """A map with a wall at 3 m ahead, and a copy of it that was looked at."""
    watched = Watched()
    watched.scans(3.0)
    assert watched.hits.share() is None  # nobody has taken a copy yet
    watched.live.snapshot()
    assert watched.hits.share() is None  # it has all scans
    return watched


def test_scans_are_judged_by_the_copy_that_does_not_have_them(watched):
    watched.scans(3.0)
    assert watched.hits.share() == 1.0
    watched.scans(3.0, theta=math.pi / 2)  # what they look at the copy does not know, though the map does
    assert watched.hits.share() == 0.0
    watched.live.snapshot()
    assert watched.hits.share() is None
    watched.scans(3.0, theta=math.pi / 2)
    assert watched.hits.share() == 1.0


def test_one_scan_in_ten_is_judged_ten_at_a_time(watched, monkeypatch):
    judged = []

    def count(copy, placed, settings, most):
        judged.append(placed.pose.theta)
        return 1, 1

    monkeypatch.setattr(predicted_hits, "count_hits", count)
    for come, want in ((EVERY - 1, 0), (1, 1), (EVERY + 5, 1), (4, 0), (1, 1), (35, 3)):
        del judged[:]
        watched.scans(3.0, come)
        watched.hits.share()
        assert len(judged) == want
    watched.live.snapshot()
    del judged[:]
    for n in range(1, 301):
        watched.scans(3.0, 1, theta=float(n))
    watched.hits.share()
    # Of the hundred newest, evenly spread; what is older nobody remembers.
    assert judged == [300.0 - 10 * k for k in range(10)]
    watched.scans(3.0, EVERY - 1)
    watched.hits.share()
    assert len(judged) == 10


def test_a_scan_that_a_copy_has_taken_meanwhile_is_not_judged(watched):
    watched.scans(3.0, EVERY)
    watched.live.snapshot()
    assert watched.hits.share() is None
    watched.scans(2.5, 1)  # is owed for the ten before
    assert watched.hits.share() == 0.0


def test_only_returns_below_15_m_count(watched):
    watched.scans(math.nan)
    assert watched.hits.share() is None
    watched.live.snapshot()
    watched.scans(16.0)
    assert watched.hits.share() is None


def test_a_new_life_begins_anew(watched):
    watched.scans(3.0)
    watched.live.reset("second")
    assert watched.hits.share() is None
    watched.scans(2.0)
    watched.live.snapshot()
    assert watched.hits.share() is None
    watched.scans(2.0, EVERY - 1)
    assert watched.hits.share() is None
    watched.scans(2.0, 1)
    assert watched.hits.share() == 1.0


def test_erasing_is_no_scan(watched):
    watched.live.erase(Polygon.of_region(Region(-0.5, -0.5, 0.5, 0.5), SETTINGS.lattice))
    assert watched.hits.share() is None
    watched.scans(3.0, EVERY)
    ahead = watched.live.ahead_of_copy()
    assert (ahead.scans, len(ahead.newest), ahead.copy.scans) == (2 * EVERY, EVERY, EVERY)
    assert watched.hits.share() == 1.0
