"""Four shares of a map hold what one mapper would, each scan once, whatever is killed or frozen.

Each of these is longer, with more kills, in `make soak ARGS=shares`.
"""

import pytest

from tests.soak.share_fleet import ALONE, COUNTS
from tests.soak.shares import (
    AT_THE_CUTS,
    log_across_shares,
    share_frozen,
    shares_killed,
    shares_robots_killed,
    shares_router_killed,
)


@pytest.mark.parametrize("cells", [ALONE, COUNTS], ids=["alone", "counts"])
def test_shares_that_are_killed_have_every_scan_once(tmp_path, cells):
    """Alone the order of each robot's scans shows; counts are of robots that see each other's places."""
    found = shares_killed(tmp_path, 2, robots=range(40, 60), rate=10.0, cells=cells)
    assert found.right, found
    assert all(away > 0 for away in found.away), "something was missed"


def test_a_share_that_is_frozen_for_4_s_has_every_scan_once(tmp_path):
    found = share_frozen(tmp_path, 4.0, robots=AT_THE_CUTS, rate=10.0)
    assert found.right, found
    assert found.away[0] > 0


def test_shares_whose_router_is_killed_have_every_scan_once(tmp_path):
    found = shares_router_killed(tmp_path, 1.5, robots=AT_THE_CUTS, rate=20.0)
    assert found.right, found
    assert found.away[0] > 0


def test_shares_have_all_that_had_left_a_robot_that_is_killed(tmp_path):
    found = shares_robots_killed(tmp_path, robots=(45, 55, 65), rate=20.0)
    assert found.right, found


def test_a_log_across_four_shares_that_are_killed_is_the_map_of_ogm_build(ogm, tmp_path):
    """Log odds of two bytes, with clamps: the order of a robot's scans matters."""
    ogm.run("simulate", "--world", "lab", "--scans", 300, "--seed", 3, "--out", "lab.jsonl.gz")
    flags = {"resolution": 0.05, "reach": 4.0}
    ogm.run("build", "lab.jsonl.gz", "--out", "built", "--resolution", 0.05, "--reach", 4)
    built = ogm.folder / "built" / "map.npz"
    cut = {"cuts_x": 0.0, "cuts_y": 0.0}
    found = log_across_shares(ogm.folder / "lab.jsonl.gz", built, tmp_path, 2, rate=30.0, **flags, **cut)
    assert found.right, found
    assert found.sent == 300
    assert sum(found.away) > 0
