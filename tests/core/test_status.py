"""The status as JSON: names, values and order are what those who read it rely on."""

import dataclasses
import subprocess
import sys
from dataclasses import FrozenInstanceError

import pytest

from ogm_core.status import RobotStatus, SourceStatus, StoreInfo, encode_status
from ogm_core.types import Pose
from status_json import STATUS

HERE = Pose(0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("robot", "gone"),
    [
        (RobotStatus(HERE, 1, alive=True, age_s=900.0), False),
        (RobotStatus(None, None, alive=True), False),
        (RobotStatus(HERE, 1, alive=False, age_s=60.0), False),
        (RobotStatus(HERE, 1, alive=False, age_s=60.1), True),
        (RobotStatus(None, None), True),
        (RobotStatus(HERE, 1), False),  # an older mapper does not say
        (RobotStatus(None, None, sources={"s": SourceStatus("", 1, 1, 0, 0)}), True),  # of before a restart
    ],
)
def test_a_robot_is_gone_a_minute_after_its_last_message(robot, gone):
    assert robot.gone is gone


def test_its_json_is_word_for_word_this():
    assert encode_status(STATUS) == (
        b'{"map": "hall", "epoch": "e1", "revision": 41, "stamp": 1700000000500000001, '
        b'"scans": {"received": 50, "integrated": 41, "pending": 2, '
        b'"dropped": {"malformed": 0, "no_pose": 7}, "lost": 8, "replayed": 9, "beams_on_robots": 12}, '
        b'"poses": {"received": 60, "malformed": 1, "late": 3, "restarted": 2, "ambiguous": 4, '
        b'"outlier": 5, "superseded": 6, "refused": 7, "lost": 10, "replayed": 11}, "other": {"ignored": 5}, '
        b'"map_info": {"known_cells": 1234, "bytes": 2500000, "width": 400, "height": 300, '
        b'"resolution": 0.05}, '
        b'"robots": {"r2": {"pose": [1.0, -2.5, 0.1], "stamp": 7, "alive": true, "age_s": 0.25, "sources": '
        b'{"front": {"run": "a", "last_seq": null, "received": 40, "pending": 2, "integrated": 33, '
        b'"dropped": {"no_pose": 5}, "hints": ["range_max"], "lost": 8, "beams_on_robots": 13}}}, '
        b'"r1": {"pose": null, "stamp": null, "alive": false, "age_s": null, "sources": {}}}, '
        b'"uptime_s": 12.25, "run": "r1", "threads": 1, "restored": false}'
    )


def test_what_is_said_of_a_store_is_word_for_word_this_and_only_said_where_there_is_one():
    stored = dataclasses.replace(STATUS, store=StoreInfo(40, None, 4096))
    assert encode_status(stored) == (
        encode_status(STATUS)[:-1] + b', "store": {"revision": 40, "failing": null, "bytes": 4096}}'
    )


def test_nobody_changes_it():
    with pytest.raises(FrozenInstanceError):
        STATUS.scans.received = 3


def test_it_is_light():
    program = (
        "import sys, ogm_core.status; print({'pydantic', 'numba', 'zenoh', 'fastapi'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout == "set()\n"
