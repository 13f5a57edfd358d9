"""What robots of the soak put, and how fast, is what the map that is made again is made of."""

import numpy as np
import pytest

from ogm_core.wire.messages import decode_scan
from tests.soak import driving
from tests.soak.drives import SIGHTS, encoded_scan, scan, uninterrupted_grid
from tests.soak.share_fleet import COUNTS, LOG_ODDS


@pytest.mark.parametrize("sight", SIGHTS)
@pytest.mark.parametrize("number", [1, 127, 128, 70_000])
def test_a_message_that_was_encoded_beforehand_is_the_scan_of_its_number(sight, number):
    again = decode_scan(encoded_scan(7, number, "run0", 10.0, sight))
    right = scan(7, number, "run0", 10.0, sight)
    assert (again.stamp, again.seq, again.run) == (right.stamp, number - 1, "run0")
    assert again.ranges.tobytes() == right.ranges.tobytes()
    assert (again.angle_increment, again.range_max) == (right.angle_increment, SIGHTS[sight].reach)


def test_what_robots_see_of_each_other_commutes_in_counts_and_is_known_either_way():
    def mapped(cells, *robots):
        sent = {robot: [40] for robot in robots}
        return uninterrupted_grid(sent, 10.0, cells.map_flags, cells.sight).snapshot()

    counts, other = mapped(COUNTS, 1, 2, 3), mapped(COUNTS, 3, 2, 1)
    assert counts.rect == other.rect
    np.testing.assert_equal(counts.counted(), other.counted())
    odds, other = mapped(LOG_ODDS, 1, 2, 3), mapped(LOG_ODDS, 3, 2, 1)
    np.testing.assert_equal(odds.published()[1], other.published()[1])
    assert not np.array_equal(odds.log_odds(), other.log_odds()), "its clamps do not commute"


def test_a_clock_goes_at_its_pace_from_then_on(monkeypatch):
    now = 100.0
    monkeypatch.setattr(driving.time, "monotonic", lambda: now)
    clock = driving.Clock()
    now = 104.0
    clock.set_pace(0.5)
    assert clock.until(4.01) == pytest.approx(0.02)
    assert clock.until(9.0) == driving._LOOK  # it is asked anew: the pace may be another one by then
    now = 110.0
    assert clock.now() == pytest.approx(7.0)
    clock.set_pace(1.0)
    now = 111.0
    assert clock.now() == pytest.approx(8.0)
