"""A real building: its walls come out sharp, by the judgement of scans that are not in the map.

`ogm build` reports the judgement; that of a few scans is repeated here the slow, obvious way.
"""

import gzip
import json
import math

import numpy as np
import pytest

FLAGS = ("--range-max", "80", "--clear-range", "25", "--hold-out", "10")
SURE = 0.6
"""Log odds from the prior (0 here) beyond which a cell counts as free or occupied."""


@pytest.fixture(scope="module")
def maps(module_ogm, intel):
    """What was built of the corrected log and of the same scans at raw odometry: quality by name."""
    module_ogm.file("raw.jsonl", raw_odometry(intel))
    builds = {
        "corrected": module_ogm.start(
            "build", intel / "intel-corrected.log.gz", "--out", "corrected", *FLAGS
        ),
        "raw": module_ogm.start("build", "raw.jsonl", "--out", "raw", *FLAGS),
    }
    for build in builds.values():
        ended = build.wait()
        assert (ended.code, ended.err) == (0, "")
        assert "910 scans read, 819 integrated, 91 held out" in ended.out
    return {name: json.loads((module_ogm.folder / name / "quality.json").read_text()) for name in builds}


def flasers(intel):
    """Ranges and pose of every scan of the corrected log, in its order."""
    with gzip.open(intel / "intel-corrected.log.gz", "rt") as log:
        fields = [line.split() for line in log if line.startswith("FLASER ")]
    return [([float(r) for r in f[2:182]], [float(v) for v in f[182:185]]) for f in fields]


def raw_odometry(intel):
    """The scans of the corrected log, in its order, as JSON lines with the poses of the wheels alone.

    The two files list a few scans in different orders, so they are matched by their ranges.
    """
    with gzip.open(intel / "intel_raw_odometry.json.gz") as file:
        raw = json.load(file)["map"].values()
    poses = {tuple(scan["range"]): [scan["x"], scan["y"], scan["theta"]] for scan in raw}
    scan = {"type": "scan", "robot": "robot1", "sensor": "laser", "range_min": 0.0, "range_max": 80.0}
    scan |= {"angle_min": -math.pi / 2, "angle_increment": math.radians(1.0)}
    lines = [
        json.dumps({**scan, "stamp": k, "seq": k, "ranges": ranges, "pose": poses[tuple(ranges)]})
        for k, (ranges, _) in enumerate(flasers(intel))
    ]
    return "\n".join(lines)


def test_walls_are_sharp(maps):
    held_out = maps["corrected"]["held_out"]
    assert held_out["within_0_1_m"] >= 0.70
    assert held_out["within_0_2_m"] >= held_out["within_0_1_m"]
    assert held_out["median_abs_m"] < 0.05
    assert held_out["into_unknown"] < 0.2
    assert held_out["bits"] == pytest.approx(4.25, abs=0.1)
    assert held_out["hit"] == pytest.approx(0.766, abs=0.005)
    assert maps["corrected"]["consistency"]["free"] > 0.95


def test_walls_of_raw_odometry_are_not(maps):
    assert maps["raw"]["held_out"]["beams"] == maps["corrected"]["held_out"]["beams"]
    assert maps["raw"]["held_out"]["within_0_1_m"] < 0.20


def naive_prediction(grid, x, y, bearing):
    """Distance at which a ray enters the first cell that is not surely free; None if that is no wall.

    The ray is cut at every cell border that it crosses, one piece per cell.
    """
    log_odds, resolution = grid["log_odds"], float(grid["resolution"])
    u, v = (np.array([x, y]) - grid["anchor"]) / resolution - grid["offset"]
    du, dv = math.cos(bearing), math.sin(bearing)
    longest = 25.0 / resolution
    crossed = [
        (border - start) / slope
        for start, slope in ((u, du), (v, dv))
        for border in range(math.floor(start - longest), math.ceil(start + longest) + 1)
        if slope
    ]
    crossed = sorted(t for t in crossed if 0.0 < t <= longest)
    for entry, after in zip(crossed, [*crossed[1:], crossed[-1] + 1e-6], strict=True):
        middle = (entry + after) / 2
        ix, iy = math.floor(u + middle * du), math.floor(v + middle * dv)
        if not (0 <= iy < log_odds.shape[0] and 0 <= ix < log_odds.shape[1]):
            return None
        value = log_odds[iy, ix]
        if not value < -SURE:  # an unknown cell is NaN
            return entry * resolution if value > SURE else None
    return None


def test_a_naive_judge_agrees(maps, intel, module_ogm):
    grid = module_ogm.map("corrected/map.npz")
    held = [scan for i, scan in enumerate(flasers(intel)) if i % 10 == 5]
    judged = [
        (r, naive_prediction(grid, x, y, theta + math.radians(k - 90)))
        for ranges, (x, y, theta) in held
        for k, r in list(enumerate(ranges))[::12]
        if 0.0 < r < 15.0
    ]
    assert len(judged) > 1000
    within = np.mean([p is not None and abs(p - r) <= 0.1 for r, p in judged])
    # The same share of a twelfth of the beams: its standard deviation is 0.012.
    assert within == pytest.approx(maps["corrected"]["held_out"]["within_0_1_m"], abs=0.04)
