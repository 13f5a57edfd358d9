"""Six robots that cross each other's ways: they stay in the map, unless their radius is known.

Through everything that a scan passes: a recording and `ogm build`, and a replay into a mapper.
"""

import numpy as np
import pytest

CORNERS = np.array([(2, 2), (12, 8), (12, 2), (2, 8)], float)
WAITING = 80
"""Scans that a robot takes before it turns at a corner; it all but stands."""


def stops():
    """Waypoints of the bow tie through the corners: robots wait before each."""
    for before, corner in zip(np.roll(CORNERS, 1, axis=0), CORNERS, strict=True):
        ahead = (corner - before) / np.hypot(*(corner - before))
        yield from (corner - 0.001 * n * ahead for n in range(WAITING, 0, -1))


HALL = f"""
name: hall
walls: [[0, 0, 14, 0], [14, 0, 14, 10], [14, 10, 0, 10], [0, 10, 0, 0]]
circles: [[2.5, 5, 0.4], [11.5, 5, 0.4]]
path: {{waypoints: {np.round(list(stops()), 6).tolist()}, spacing: 0.1}}
"""
"""Its path crosses itself in the middle."""
RADIUS = 0.25
SKIPPED = 0.35
"""The noise has a standard deviation of 0.02 m."""
RULE = ("--robot", f"robot*:radius={SKIPPED}")
SCANS = 200


@pytest.fixture(scope="module")
def crossing(module_ogm):
    """A recording of six robots that see each other."""
    module_ogm.file("hall.yaml", HALL)
    flags = (
        "--world",
        "hall.yaml",
        "--robots",
        6,
        "--robot-radius",
        RADIUS,
        "--range-max",
        12,
        "--fov",
        180,
        "--beams",
        180,
    )
    done = module_ogm.call("simulate", *flags, "--seed", 3, "--scans", SCANS, "--out", "six.jsonl.gz")
    assert done.code == 0, done
    return module_ogm.folder / "six.jsonl.gz"


def on_the_floor(grid):
    """How many occupied cells lie where nothing stands: 0.3 m and more from walls and pillars."""
    height, width = grid["log_odds"].shape
    x = (grid["offset"][0] + np.arange(width) + 0.5) * grid["resolution"]
    y = (grid["offset"][1] + np.arange(height)[:, None] + 0.5) * grid["resolution"]
    floor = (x > 0.3) & (x < 13.7) & (y > 0.3) & (y < 9.7)
    for cx in (2.5, 11.5):
        floor &= np.hypot(x - cx, y - 5.0) > 0.7
    occupied = grid["log_odds"] > np.log(0.65 / 0.35)
    known = np.isfinite(grid["log_odds"])
    assert np.count_nonzero(floor & known) > 0.9 * np.count_nonzero(floor)
    assert np.count_nonzero(occupied & ~floor) > 500  # walls
    return int(np.count_nonzero(occupied & floor))


def test_no_occupied_cell_stays_on_the_free_floor_and_some_do_without(module_ogm, crossing):
    ogm = module_ogm
    without, known = (
        ogm.call("build", crossing, "--out", out, *flags) for out, flags in (("no", ()), ("yes", RULE))
    )
    assert (without.code, known.code, known.err) == (0, 0, "")
    assert on_the_floor(ogm.map("no/map.npz")) > 20
    assert on_the_floor(ogm.map("yes/map.npz")) == 0
    assert "beams skipped that ended at other robots" in known.out
    assert "skipped" not in without.out


def test_a_mapper_gives_the_map_of_the_build_and_counts_what_it_skips(
    module_ogm, crossing, assert_equal_maps
):
    ogm = module_ogm
    mapper = ogm.ready(ogm.mapper(*RULE))
    built = ogm.call("build", crossing, "--out", "built", *RULE)
    played = ogm.call("replay", crossing, "--connect", mapper.endpoint, "--speed", "max")
    assert (built.code, played.code) == (0, 0), (built, played)
    assert_equal_maps(mapper.map(), ogm.map("built/map.npz"))
    status = mapper.status()
    skipped = status["scans"]["beams_on_robots"]
    assert f"{skipped} beams skipped" in built.out
    sources = [robot["sources"]["laser"] for robot in status["robots"].values()]
    assert sum(source["beams_on_robots"] for source in sources) == skipped > 6 * SCANS
    assert not any(source["hints"] for source in sources)
    metrics = mapper.get("metrics").decode()
    assert f'ogm_beams_on_robots_total{{map="default"}} {float(skipped)}' in metrics
    assert f"on robots {skipped} beams" in " ".join(ogm.call("status", "--url", mapper.url).out.split())
