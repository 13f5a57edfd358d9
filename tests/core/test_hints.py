"""Hints at sensors whose data look wrong: told once, and not without reason."""

import math

import numpy as np
import pytest

from ogm_core.cells.forgetting import TICKS_OF_LOG_ODDS, MapTime, tick_length
from ogm_core.placing.clock_hints import ClockHints
from ogm_core.placing.hints import Hints
from ogm_core.types import IDENTITY, Scan

DAY = 1_700_000_000
STEP = math.tau / 360


def scan(n=0, ranges=None, *, stamp=None, **fields):
    values = {"angle_min": 0.0, "angle_increment": STEP, "range_min": 0.1, "range_max": 8.0}
    ranges = np.full(360, 2.0, np.float32) if ranges is None else np.array(ranges, np.float32)
    stamp = DAY * 10**9 + n * 10**8 if stamp is None else stamp
    return Scan(stamp=stamp, ranges=ranges, **(values | fields))


def told(scans, hints=None):
    found = []
    hints = hints or Hints()
    for one in scans:
        found += hints.look("r/s", one)
        found += hints.placed("r/s", one, IDENTITY)
    return [hint.slug for hint in found]


def test_of_a_sound_sensor_nothing_is_said():
    assert told(scan(n) for n in range(300)) == []


@pytest.mark.parametrize(("beams", "hinted"), [(361, False), (362, False), (363, True)])
def test_bearings_that_go_round_more_than_once(beams, hinted):
    assert told([scan(0, np.ones(beams)), scan(1, np.ones(beams))]) == ["turns"] * hinted


def test_a_range_max_that_changes_now_and_then_is_none_that_differs_from_scan_to_scan():
    assert told(scan(n, range_max=8.0 + (n > 20) + (n > 30)) for n in range(100)) == []
    assert told(scan(n, range_max=8.0 + n) for n in range(100)) == ["range_max"]


@pytest.mark.parametrize(("share", "hinted"), [(18, False), (19, True)])
def test_more_than_5_percent_of_the_finite_ranges_beyond_range_max(share, hinted):
    ranges = [9.0] * share + [2.0] * (360 - share)
    assert told(scan(n, ranges) for n in range(60)) == ["beyond"] * hinted
    assert told(scan(n, [math.inf, 2.0] * 180) for n in range(60)) == []


@pytest.mark.parametrize(("unit", "hinted"), [(1, True), (10**3, True), (10**6, True), (10**9, False)])
def test_stamps_in_other_units(unit, hinted):
    assert told(scan(stamp=DAY * unit + n * unit // 20) for n in range(60)) == ["stamp"] * hinted


@pytest.mark.parametrize("hertz", [2, 20, 2000])
def test_stamps_in_microseconds_at_any_rate(hertz):
    assert told(scan(stamp=DAY * 10**6 + n * 10**6 // hertz) for n in range(60)) == ["stamp"]


def test_simulated_time_is_none_of_our_days():
    for start in (0, 10**9, 16 * 60 * 10**9, 11 * 86_400 * 10**9):
        assert told(scan(stamp=start + n * 50_000_000) for n in range(60)) == []


def test_wide_increments_matter_to_sectors():
    wide = scan(0, [1.0] * 60, angle_increment=math.radians(6))
    assert told([wide], Hints(sector=True)) == ["sector"]
    assert told([wide]) == told([scan()], Hints(sector=True)) == []


@pytest.mark.parametrize(
    ("empty", "agreeing", "hinted"), [(181, 2, True), (181, 3, True), (181, 4, False), (180, 0, False)]
)
def test_most_beams_without_return_and_a_map_that_does_not_agree(empty, agreeing, hinted):
    asked = []

    def agreement(one, pose):
        asked.append(one)
        return agreeing, 32

    ranges = [math.inf] * empty + [2.0] * (360 - empty)
    assert told((scan(n, ranges) for n in range(500)), Hints(agreement)) == ["ignore_no_return"] * hinted
    assert len(asked) == (0 if empty == 180 else 1 if hinted else 10)


def test_sources_are_told_apart():
    found = []
    hints = Hints()
    for source in ("a", "b", "a"):
        found += [(source, hint.slug) for hint in hints.look(source, scan(0, np.ones(400)))]
    assert found == [("a", "turns"), ("b", "turns")]


def test_ranges_in_millimetres_are_hinted_at_otherwise():
    hints = Hints()
    found = [hint for n in range(60) for hint in hints.look("r/s", scan(n, [2000.0] * 360))]
    assert ["are they in metres" in hint.text for hint in found if hint.slug == "beyond"] == [True]


@pytest.mark.parametrize("value", [math.nan, 0.0, -math.inf, 0.05])
def test_a_sensor_of_which_no_beam_counts(value):
    assert told(scan(n, [value] * 360) for n in range(49)) == []
    assert told(scan(n, [value] * 360) for n in range(60)) == ["nothing_counts"]


def test_a_sensor_that_never_has_a_return():
    assert told(scan(n, [math.inf] * 360) for n in range(60)) == ["ignore_no_return"]
    assert told(scan(n, [math.inf] * 359 + [2.0 if n == 7 else math.inf]) for n in range(60)) == []


def test_a_scan_that_takes_longer_than_any_turn():
    assert told([scan(0, time_increment=2.0 / 359)]) == []
    assert told([scan(0, time_increment=0.1)]) == told([scan(0, time_increment=-0.1)]) == ["time_increment"]


class MapOfTime:
    """The time of a map that forgets: a scan of this stamp is in it."""

    def __init__(self, half_life=600.0):
        self.tick = tick_length(half_life, TICKS_OF_LOG_ODDS)
        self.now = MapTime()
        self.hints = Hints(clocks=ClockHints(lambda: self.now.time, self.tick))
        self.told = []

    def take(self, source, stamp):
        """A scan comes, and is in the map."""
        one = scan(stamp=stamp)
        self.now = self.now.after(stamp, 1, self.tick)
        self.hints.look(source, one)
        self.told += [(source, hint) for hint in self.hints.placed(source, one, IDENTITY)]

    @property
    def slugs(self):
        return [(source, hint.slug) for source, hint in self.told]


YEAR = 365 * 86_400 * 10**9
NOW = DAY * 10**9


def test_who_is_a_year_ahead_of_the_time_of_a_map_that_forgets_and_then_who_is_left_behind():
    """The one that is ahead moves the time by a second a scan: the honest one falls behind it."""
    forgetting = MapOfTime()
    for n in range(400):
        forgetting.take("honest/s", NOW + n * 50_000_000)
        forgetting.take("ahead/s", NOW + YEAR + n * 50_000_000)
        if n == 50:
            assert forgetting.slugs == [("ahead/s", "map_clock")]
    assert forgetting.slugs == [("ahead/s", "map_clock"), ("honest/s", "map_clock")]
    (_, ahead), (_, honest) = forgetting.told
    assert ahead.text.startswith("its stamps are 365 days ahead of the time of the map")
    assert "s behind the time of the map" in honest.text


@pytest.mark.parametrize(("begins", "said"), [(5 * 10**9, "1.97e+04 days ahead"), (NOW + YEAR, "s behind")])
def test_a_map_whose_first_scan_came_by_a_wrong_clock(begins, said):
    forgetting = MapOfTime()
    forgetting.take("r/s", begins)
    for n in range(200):
        forgetting.take("r/s", NOW + n * 50_000_000)
    assert forgetting.slugs == [("r/s", "map_clock")]
    assert said in forgetting.told[0][1].text


def test_an_hour_without_scans_and_scans_that_come_late_are_no_wrong_clock():
    forgetting = MapOfTime(half_life=10.0)
    for n in range(400):
        forgetting.take("here/s", NOW + n * 50_000_000)
    later = NOW + 3_600 * 10**9
    for n in range(4_000):
        forgetting.take("here/s", later + n * 50_000_000)
    now = later + 4_000 * 50_000_000
    assert forgetting.now.time == now - 50_000_000  # it has come there
    for n in range(400):  # a robot that was out of reach for 20 s sends what it has, four scans at a time
        forgetting.take("here/s", now + n * 50_000_000)
        for k in range(4 * n, min(4 * n + 4, 400 + n)):
            forgetting.take("late/s", now + (k - 400) * 50_000_000)
    assert forgetting.slugs == []


def test_a_map_that_keeps_what_it_knows_has_no_time():
    assert told([scan(stamp=NOW), *(scan(stamp=NOW + YEAR + n) for n in range(100))]) == []
