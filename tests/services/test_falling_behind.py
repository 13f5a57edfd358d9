"""A mapper counts as behind after ten seconds over half of its work, on a clock that is told."""

import logging

from ogm_services.mapper.live.load import HOLD, FallingBehind


class Load:
    def __init__(self):
        self.work = 0.0
        self.behind = FallingBehind(lambda: self.work, 5.0)

    def looks(self, work, *times):
        """Whether it is behind after looks at these times, s, while so much work waits, s."""
        self.work = work
        for now in times:
            self.behind.look(now)
        return self.behind.reason() is not None


def test_half_of_the_work_for_ten_seconds_is_behind_and_not_a_moment_less():
    load = Load()
    assert HOLD == 10.0
    assert not load.looks(2.5, 0, 5, 10, 20)
    assert not load.looks(2.6, 21, 26, 30.9)
    assert load.looks(2.6, 31)
    assert load.behind.reason() == "the mapper falls behind: 2.6 s of work wait"


def test_a_moment_below_begins_the_ten_seconds_anew():
    load = Load()
    assert not load.looks(5.0, 0, 9)
    assert not load.looks(1.0, 9.5)
    assert not load.looks(5.0, 10, 19.9)
    assert load.looks(5.0, 20)


def test_it_has_caught_up_after_ten_seconds_below():
    load = Load()
    assert load.looks(5.0, 0, 10)
    assert load.looks(0.0, 11, 20.9)
    assert load.looks(5.0, 20.95)
    assert load.looks(0.0, 21, 30.9)
    assert not load.looks(0.0, 31)


def test_it_is_logged_once_when_it_begins_and_ends(caplog):
    caplog.set_level(logging.INFO, "ogm_services")
    load = Load()
    load.looks(4.0, *range(30))
    load.looks(0.0, *range(30, 60))
    behind, caught_up = caplog.records
    assert (behind.levelname, caught_up.levelname) == ("WARNING", "INFO")
    assert "for 10 s more than half of the work that may wait has waited, 4.0 s now" in behind.getMessage()
    assert caught_up.getMessage() == "the mapper has caught up"
