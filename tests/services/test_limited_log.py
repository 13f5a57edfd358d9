"""Complaints about what lasts: ever fewer lines, and none is left out without being counted."""

import logging
from itertools import pairwise
from types import SimpleNamespace

import pytest

from ogm_services.runtime.limited_log import LONGEST_WAIT, MAX_SOURCES, LimitedLog


@pytest.fixture
def clock():
    return SimpleNamespace(now=1000.0)


@pytest.fixture
def limited(clock, caplog):
    caplog.set_level(logging.WARNING)
    return LimitedLog(logging.getLogger("limited"), lambda: clock.now)


def lasts(clock, complain, seconds):
    """Complain eight times a second for so long: an eighth is what floats add up without an error."""
    for _ in range(8 * seconds):
        complain()
        clock.now += 0.125


def test_what_lasts_is_said_ever_more_rarely_with_how_many_were_left_out(limited, clock, caplog):
    at, began = [], clock.now
    for _ in range(8 * 320):
        before = len(caplog.messages)
        limited.warning("r/s", "no scan")
        at += [clock.now - began] * (len(caplog.messages) - before)
        clock.now += 0.125
    assert at == [0, 1, 3, 7, 15, 31, 63, 123, 183, 243, 303]
    left_out = [None, *(8 * (later - earlier) - 1 for earlier, later in pairwise(at))]
    assert caplog.messages == [
        "r/s: no scan" if count is None else f"r/s: no scan ({count:.0f} more were not logged)"
        for count in left_out
    ]
    assert LONGEST_WAIT == 60.0


def test_after_a_minute_of_quiet_all_begins_anew(limited, clock, caplog):
    lasts(clock, lambda: limited.warning("r/s", "no scan"), 60)
    caplog.clear()
    clock.now += 59.0
    limited.warning("r/s", "again")
    clock.now += 30.0
    limited.warning("r/s", "left out")
    assert len(caplog.messages) == 1
    clock.now += 60.0
    for pause in (0.5, 0.5, 1.0, 1.0):
        limited.warning("r/s", "anew")
        clock.now += pause
    assert caplog.messages[1:] == [
        "r/s: anew (1 more were not logged)",
        "r/s: anew (1 more were not logged)",
    ]


def test_sources_and_kinds_keep_each_other_from_nothing(limited, clock, caplog):
    lasts(clock, lambda: limited.of_kind("r/s", "no_pose", "no pose"), 60)
    caplog.clear()
    limited.of_kind("r/s", "stale", "too old")
    limited.of_kind("r/t", "no_pose", "no pose")
    limited.warning("r/s", "malformed")
    assert caplog.messages == ["r/s: too old", "r/t: no pose", "r/s: malformed"]


def test_a_failure_comes_with_its_traceback_as_rarely(limited, clock, caplog):
    def fail():
        try:
            [].pop()
        except IndexError:
            limited.failure("r/s")

    lasts(clock, fail, 6)
    assert [record.exc_info[0] for record in caplog.records] == [IndexError] * 3
    assert caplog.messages[:2] == ["r/s failed", "r/s failed (7 more were not logged)"]


def test_names_without_end_push_out_the_one_that_was_silent_longest(limited, clock, caplog):
    limited.warning("first", "one")
    limited.warning("steady", "one")
    for number in range(MAX_SOURCES - 2):
        limited.warning(f"flood{number}", "one")
    limited.warning("steady", "two")
    assert len(caplog.messages) == MAX_SOURCES
    limited.warning("one more", "one")
    limited.warning("steady", "three")
    assert caplog.messages[-1] == "one more: one"
    limited.warning("first", "two")
    assert caplog.messages[-1] == "first: two"
