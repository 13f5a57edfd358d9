"""A moment of the soak's overload: what must never be wrong is not, and what is wrong would be seen."""

from collections import Counter

import numpy as np
import pytest

from ogm_core.files.map_files import NpzMap
from ogm_core.wire.messages import encode_scan
from tests.soak.bad_messages import GOOD_BUT_ODD, MESSAGES, REQUESTS
from tests.soak.overload import HONEST, Report, differing, overloaded
from tests.soak.robots import messages, placed


def test_no_cell_is_wrong_after_a_moment_of_overload():
    report = overloaded(3.0, trial=1.0)
    assert report.looks > 1
    assert (report.not_balanced, report.misplaced, report.strangers, report.wrong_cells) == (0, 0, 0, 0)
    assert all(report.integrated[robot] > 0 for robot in HONEST)
    kinds = {kind.partition(": ")[0] for kind in report.sent}
    assert kinds >= {*MESSAGES, *GOOD_BUT_ODD, *REQUESTS}
    assert report.status["scans"]["dropped"]["malformed"] >= len(MESSAGES) - 1  # a flipped bit may do no harm


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"wrong_cells": 3}, "3 wrong cells"),
        ({"misplaced": 1}, "1 misplaced scans"),
        ({"strangers": 2}, "2 scans of strangers in the map"),
        ({"not_balanced": 1}, "1 statuses that do not add up"),
        ({"integrated": Counter(dict.fromkeys(HONEST, 94))}, "94.0% of the scans of honest-0 are in the map"),
    ],
)
def test_what_is_wrong_is_said(wrong, said):
    good = {"sent": Counter(dict.fromkeys(HONEST, 100)), "integrated": Counter(dict.fromkeys(HONEST, 95))}
    assert Report(1.0, 1.0, **good).failures() == []
    assert Report(1.0, 1.0, **{**good, **wrong}).failures()[0].startswith(said)


@pytest.mark.parametrize("robot", ["honest-2", "flood-0", "heavy-0"])
@pytest.mark.parametrize("number", [0, 1, 300, 70_000])
def test_a_message_encoded_ahead_is_the_one_encoded_anew(robot, number):
    assert messages(robot, number)[-1][1] == encode_scan(placed(robot, number).scan)


def test_cells_that_differ_are_counted():
    cells = np.array([[0.5, np.nan], [np.nan, -0.5]], np.float32)

    def made(log_odds, offset=(0, 0)):
        return NpzMap(log_odds, 0.05, (0.0, 0.0), offset)

    other = cells.copy()
    other[0, 0], other[0, 1] = np.nextafter(np.float32(0.5), np.float32(1.0)), 0.0
    assert differing(made(cells), made(cells.copy())) == 0
    assert differing(made(cells), made(other)) == 2
    assert differing(made(cells), made(cells, (1, 0))) == 4
