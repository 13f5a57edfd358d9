"""A running mapper reads scans by the settings of their sensors, and hints at those that look wrong."""

import math

import numpy as np
import pytest

from ogm_core.grid import OccupancyGrid
from ogm_core.types import Pose
from ogm_core.wire.values import scan_of

ANGLES = {"angle_min": 0.0, "angle_increment": math.pi / 90, "range_min": 0.1}
MS = 1_000_000


def log_odds(mapper):
    return mapper.service.live_map.snapshot().log_odds()


def test_scans_are_read_by_the_settings_of_their_sensor(start_mapper, no_errors):
    ranges = [2.0, 9.0, math.inf, 0.3] * 45
    rules = [
        {"match": "*/s", "time_offset": -0.5, "range_max": 8.0, "beyond": "clear", "clear_range": 1.0},
        {"match": "r/*", "range_min": 0.5, "mount": [1.0, 2.0, 0.5], "upside_down": True},
    ]
    with start_mapper(sensors=rules) as mapper:
        mapper.pose(3.0, 0.0, 0.0, at=0)
        mapper.scan(ranges, at=500 * MS, range_max=5.0, **ANGLES)
        # The range_max of this one lies below the range_min of the settings.
        mapper.scan(ranges, at=0, sensor="other", range_max=0.4, **ANGLES)
        status = mapper.settle(received=2)
        assert status["robots"]["r"]["sources"]["other"]["dropped"] == {"malformed": 1}
        found = log_odds(mapper)
    grid = OccupancyGrid(mapper.service.live_map._grid.settings)
    upside_down = {"angle_min": 0.0, "angle_increment": -math.pi / 90, "range_min": 0.5, "range_max": 8.0}
    walls = scan_of([r if r == 2.0 else math.nan for r in ranges], **upside_down)
    cleared = [math.inf if r > 8.0 else math.nan for r in ranges]
    nothing = scan_of(cleared, **upside_down | {"range_max": 1.0})
    pose = Pose(4.0, 2.0, 0.5)
    grid.integrate(walls, pose)
    grid.integrate(nothing, pose)
    assert np.array_equal(np.sign(found), np.sign(grid.snapshot().log_odds()))


def test_hints_are_in_the_status_and_once_in_the_log(start_mapper, caplog):
    with start_mapper(map={"sensor_model": "sector"}) as mapper:
        for k in range(70):
            mapper.scan([1.0] * 40, pose=[0, 0, 0], angle_min=0.0, angle_increment=0.2, range_max=8.0 + k)
        assert set(mapper.settle(received=70)["robots"]["r"]["sources"]["s"]["hints"]) == {
            *("turns", "sector", "range_max")
        }
    lines = [record.getMessage() for record in caplog.records if record.getMessage().startswith("r/s: its ")]
    assert sum("range_max differs" in line for line in lines) == 1
    assert len(lines) == 3


@pytest.mark.parametrize("invalid", [True, False])
def test_a_sensor_that_says_inf_for_invalid_is_hinted_at_by_what_the_map_says(start_mapper, invalid):
    rng = np.random.default_rng(3)
    with start_mapper() as mapper:
        for k in range(260):
            lost = rng.random(180) < 0.85 if invalid else np.arange(180) < 150
            ranges = np.where(lost, np.inf, 3.02).astype(np.float32)
            mapper.scan(ranges, pose=[0, 0, 0.013 * k if invalid else 0], range_max=6.0, **ANGLES)
        hints = mapper.settle(received=260)["robots"]["r"]["sources"]["s"]["hints"]
    assert hints == ["ignore_no_return"] * invalid
