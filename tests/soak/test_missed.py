"""What the kills of the soak look for is seen where it is, and told."""

from collections import Counter
from dataclasses import replace

import pytest

from tests.soak.drives import mapped, messages, uninterrupted
from tests.soak.missed import TELLING, Outcome
from tests.soak.overload import differing


def changed(what):
    """The messages of 300 scans, one of them wrong; without numbers, so that no mapper would see it."""
    sent = [replace(message, run="") for message in messages(1, 300, "", 10.0)]
    scan, pose = 301, 302
    if what == "a scan is missing":
        del sent[scan]
    elif what == "a scan comes twice":
        sent.insert(scan, sent[scan])
    elif what == "a pose is missing":
        del sent[pose]
    elif what == "a scan comes after the next one":
        sent.insert(scan + 3, sent.pop(scan))
    return sent


def test_the_same_messages_make_the_same_map():
    again = [(1, changed("nothing")), (2, messages(2, 50, "a", 10.0)), (2, messages(2, 20, "b", 10.0))]
    assert differing(mapped(again, TELLING), uninterrupted({1: [300], 2: [50, 20]}, 10.0, TELLING)) == 0


@pytest.mark.parametrize(
    "what",
    ["a scan is missing", "a scan comes twice", "a scan comes after the next one", "a pose is missing"],
)
def test_a_message_that_is_wrong_shows_in_the_map(what):
    assert differing(mapped([(1, changed(what))], TELLING), uninterrupted({1: [300]}, 10.0, TELLING)) > 0


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ({}, True),
        ({"counted": Counter({"scans replayed": 5, "poses replayed": 2})}, True),
        ({"integrated": 99}, False),
        ({"integrated": 101}, False),
        ({"wrong_cells": 1}, False),
        ({"counted": Counter({"poses lost": 1})}, False),
        ({"counted": Counter({"duplicate": 1})}, False),
        ({"counted": Counter({"poses late": 1})}, False),
    ],
)
def test_an_outcome_is_right_if_every_scan_is_in_the_map_once(wrong, right):
    assert Outcome(**{"sent": 100, "integrated": 100, **wrong}).right == right
