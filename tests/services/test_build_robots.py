"""`ogm build` of a log of robots that see each other: what is skipped, held out, counted and told."""

import json
import math

import numpy as np
import pytest

from ogm_core.files.map_files import read_npz
from ogm_core.logs.jsonl_writer import write_jsonl
from ogm_core.logs.recorded import RecordedPose, RecordedScan
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_services.commands import build, mapped_logs
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.held_scans import HeldScans
from ogm_services.settings.sources import load_settings

PLACES = {"a": Pose(0.0, 0.0, 0.0), "b": Pose(2.0, 0.0, 0.0)}
SCANS = 12
"""Of each robot."""


def messages():
    """Two robots that stand; a looks at b, and at a wall."""
    for n in range(SCANS):
        for robot, pose in PLACES.items():
            stamp = n * 100_000_000
            yield RecordedPose(robot, PoseStamped(stamp, pose, n, "x"))
            ranges = np.array([1.8, 3.0], np.float32)
            yield RecordedScan(
                *(robot, "s"),
                Scan(stamp, 0.0, math.pi / 2, 0.0, 8.0, ranges, seq=n, run="x"),
            )


@pytest.fixture
def built(tmp_path, capsys):
    """`built(robots, hold_out)`: the map, its figures, and what was printed."""
    log = tmp_path / "log.jsonl"
    write_jsonl(log, messages())

    def run(*robots, hold_out=None):
        settings = load_settings(config=None, flags={}, environ={}, robots=robots)
        build.run_build(BuildRequest([log], tmp_path, settings, held=HeldScans(hold_out)))
        grid = read_npz((tmp_path / "map.npz").read_bytes())
        return grid, json.loads((tmp_path / "quality.json").read_text()), capsys.readouterr()

    return run


def log_odds(grid, x, y):
    ix, iy = (
        math.floor(x / grid.resolution) - grid.offset[0],
        math.floor(y / grid.resolution) - grid.offset[1],
    )
    return float(grid.log_odds[iy, ix])


def test_where_a_robot_stood_is_occupied_unless_its_radius_is_known(built):
    grid, quality, said = built()
    assert log_odds(grid, 1.78, 0.02) > 5.0
    assert "skipped" not in said.out
    grid, quality, said = built("b:radius=0.3")
    assert log_odds(grid, 1.78, 0.02) < 1.0  # of one scan: it comes before the first pose of b
    assert log_odds(grid, 0.02, 3.02) > 5.0
    assert f"{SCANS - 1} beams skipped that ended at other robots" in said.out
    assert quality["scans"] == 2 * SCANS
    assert said.err == ""


@pytest.mark.parametrize("room", [0, 10_000_000])
def test_scans_that_are_held_out_stay_out_and_are_judged_without_other_robots(built, monkeypatch, room):
    monkeypatch.setattr(mapped_logs, "MAX_KEPT", room)
    _, quality, said = built("*:radius=0.3", hold_out=3)
    assert quality["scans"] == 2 * SCANS * 2 // 3
    assert f"{2 * SCANS // 3} held out" in said.out
    # Of each held-out scan of b both beams are judged, of a's all but that which ended at b.
    assert quality["held_out"]["beams"] == 2 * SCANS // 3 * 2 - SCANS // 3


def test_a_pattern_that_no_robot_matches_is_told(built):
    said = built("b:radius=0.3", "cart*:radius=1", "dog:name=x")[2]
    assert said.err == "robots: cart*: no robot of this log is called so\n"
