"""A robot's path: the base's way, thinned and broken where it must be."""

import json
import math

import numpy as np
import pytest

from ogm_core.types import IDENTITY, Pose, Scan
from ogm_services.commands.build import run_build
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.held_scans import HeldScans
from ogm_services.results import driven_paths, figure
from ogm_services.results.driven_paths import DrivenPath
from ogm_services.settings.settings import Settings

NAN = math.nan


def scan_at(x, y, theta=0.0, mount=IDENTITY):
    scan = Scan(0, 0.0, 0.1, 0.0, 9.0, np.ones(1, np.float32), mount=mount)
    return scan, Pose(x, y, theta).compose(mount)


def path_of(*points):
    path = DrivenPath()
    for point in points:
        path.add(*scan_at(*point))
    return path


def test_a_path_joins_what_was_driven_and_nothing_else():
    path = path_of((0, 0), (1, 0), (7, 0), (7, 1), (7, 6), (20, 6))
    expected = [(0, 0), (1, 0), (NAN, NAN), (7, 0), (7, 1), (7, 6), (NAN, NAN), (20, 6)]
    np.testing.assert_array_equal(path.line(), expected)
    assert DrivenPath().line().shape == (0, 2)
    np.testing.assert_array_equal(path_of((3, 4)).line(), [(3, 4)])


def test_a_path_is_that_of_the_base_wherever_the_sensor_sits():
    path = DrivenPath()
    for k in range(4):
        for mount in (Pose(0.3, 0.1, 0.5), Pose(-0.4, 0.0, math.pi)):
            path.add(*scan_at(k, 2 * k, 0.7 * k, mount))
    expected = np.repeat([(k, 2 * k) for k in range(4)], 2, axis=0)
    np.testing.assert_allclose(path.line(), expected, atol=1e-12)


@pytest.mark.parametrize("count", [10, 11, 12, 21, 22, 23, 999])
def test_a_long_path_is_thinned(monkeypatch, count):
    monkeypatch.setattr(driven_paths, "MOST", 10)
    line = path_of(*((k, 0) for k in range(count))).line()
    assert len(line) <= 12
    assert (line[0, 0], line[-1, 0]) == (0, count - 1)
    steps = np.diff(line[:, 0])
    assert (steps[:-1] == steps[0]).all()
    assert 0 < steps[-1] <= steps[0]
    assert steps[0] == next(2**n for n in range(20) if (count - 1) // 2**n < 10)


def test_a_thinned_path_stays_broken_where_it_was(monkeypatch):
    monkeypatch.setattr(driven_paths, "MOST", 10)
    for jump in range(1, 40):
        line = path_of(*((k if k < jump else 1000 + k, 0) for k in range(40))).line()
        (gap,) = np.flatnonzero(np.isnan(line[:, 0]))
        assert line[gap - 1, 0] < jump
        assert line[gap + 1, 0] >= 1000 + jump


def test_build_gives_every_robot_the_path_of_its_scans_in_the_map(monkeypatch, tmp_path):
    """Scans wait for poses, and one of them is held out, one repeated, one never placed."""

    def pose(robot, stamp, x, y):
        return {"type": "pose", "robot": robot, "stamp": stamp, "seq": stamp, "x": x, "y": y, "theta": 0.0}

    def scan(robot, stamp, seq, **changes):
        fields = {"type": "scan", "robot": robot, "sensor": "s", "run": "1", "stamp": stamp, "seq": seq}
        fields |= {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 9.0}
        return {**fields, "ranges": [1.0], **changes}

    lines = [
        pose("a", 0, 0.0, 0.0),
        pose("b", 0, 0.0, 4.0),
        scan("a", 0, 0),
        scan("a", 10, 1),
        scan("b", 5, 0),
        scan("a", 20, 2),  # held out: number 3 of all, as 3 % 7 == 7 // 2
        scan("b", 5, 1, pose=[7.0, 7.0, 0.0]),
        pose("a", 20, 2.0, 0.0),
        pose("b", 10, 2.0, 4.0),
        scan("b", 10, 2),
        scan("b", 10, 2),
        scan("c", 10, 0),
    ]
    log = tmp_path / "two.jsonl"
    log.write_text("\n".join(map(json.dumps, lines)))
    drawn = []
    monkeypatch.setattr(figure, "encode_figure", lambda *_: b"drawn")
    monkeypatch.setattr(figure, "draw_map", lambda *given: drawn.append(given))
    out = tmp_path / "out"
    settings = Settings.model_validate({"mapper": {"max_speed": "inf"}})
    run_build(BuildRequest([log], out, settings, held=HeldScans(7), world="lab", figure=out / "two.png"))
    ((_, name, description, world, paths),) = drawn
    assert (name, world.name) == ("two.jsonl", "lab")
    assert description == "5 scans, resolution 0.05 m, model beam, traversal bresenham"
    assert list(paths) == ["a", "b"]
    np.testing.assert_array_equal(paths["a"].line(), [(0, 0), (1, 0)])
    np.testing.assert_array_equal(paths["b"].line(), [(7, 7), (NAN, NAN), (1, 4), (2, 4)])
    assert (out / "two.png").read_bytes() == b"drawn"
