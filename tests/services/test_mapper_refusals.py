"""Well-formed scans that are not integrated: too far, outside, without a pose, too old, twice."""

import math

import msgpack
import numpy as np
import pytest

from status_json import NO_POSES

INF, NAN = math.inf, math.nan
HERE = [0.0, 0.0, 0.0]
LAST = 2**63 - 1
SECOND = 1_000_000_000


def changed(status, before, *, integrated=0, **dropped):
    """Check that just so many scans more were integrated, and dropped for these reasons."""
    counts = {
        reason: n - before["scans"]["dropped"][reason] for reason, n in status["scans"]["dropped"].items()
    }
    assert {reason: n for reason, n in counts.items() if n} == dropped
    assert status["scans"]["integrated"] - before["scans"]["integrated"] == integrated
    assert status["revision"] - before["revision"] == integrated


@pytest.mark.parametrize(
    "pose", [[1e6, 1e6, 0], [-1e6, 1e6, 0], [1e300, 1e300, 1e300], [1.7e308, -1.7e308, 0]]
)
def test_a_scan_from_far_away_is_dropped_before_any_cell_changes(sound, pose):
    before, image = sound.status(), sound.http.get("/map.npz").content
    sound.scan([1.0, 2.0], pose=pose)
    sound.pose(*pose)
    sound.scan([1.0, 2.0])
    sound.scan([1.0, 2.0], pose=HERE, mount=pose)
    status = sound.settle(received=6)
    changed(status, before, limit=3)
    assert sound.http.get("/map.npz").content == image
    assert status["map_info"] | {"known_cells": 0} == before["map_info"] | {"known_cells": 0}


def test_a_map_of_ordinary_make_does_not_reach_a_million_metres(start_mapper, no_errors):
    with start_mapper() as mapper:
        for pose in (HERE, [1e6, 0.0, 0.0], HERE):
            mapper.scan([1.0] * 63, pose=pose)
        status = mapper.settle(received=3)
        assert (status["scans"]["dropped"]["limit"], status["revision"]) == (1, 2)
        assert status["map_info"]["width"] * 0.05 < 3.0


def test_max_cells_and_max_bytes_are_settings(start_mapper, no_errors):
    for limits in ({"max_cells": 30}, {"max_bytes": 10_000}):
        with start_mapper(map={"resolution": 0.5}, mapper=limits) as mapper:
            mapper.scan([5.0], pose=HERE)
            mapper.scan([2.0], pose=[600.0, 600.0, 0])
            status = mapper.settle(received=2)
            assert (status["scans"]["dropped"]["limit"], status["revision"]) == (1, 1)
            assert status["map_info"]["width"] == 10


def test_a_scan_without_a_usable_beam_is_integrated_and_changes_nothing(sound):
    before, image = sound.status(), sound.http.get("/map.png").content
    for ranges in ([NAN] * 360, [-INF], [0.0, -1.0, NAN], [np.float32(0.049)]):
        sound.scan(ranges, pose=HERE, range_min=0.05)
    sound.scan([NAN] * 5, pose=[1e6, 1e6, 0])
    status = sound.settle(received=8)
    changed(status, before, integrated=5)
    assert sound.http.get("/map.png").content == image


def test_beams_that_leave_a_map_with_bounds(start_mapper, no_errors):
    bounds = {"resolution": 0.5, "bounds": [-2.0, -2.0, 2.0, 2.0]}
    for outside, dropped in (("drop", 2), ("clip", 0)):
        with start_mapper(map={**bounds, "outside": outside}) as mapper:
            mapper.scan([5.0, INF], pose=HERE)
            mapper.scan([1.0], pose=[1e6, 0, 0])
            mapper.scan([1.0, 5.0], pose=HERE)
            scans = mapper.settle(received=3)["scans"]
            assert (scans["dropped"]["outside"], scans["integrated"]) == (dropped, 3 - dropped)


def test_a_scan_whose_pose_never_comes(sound):
    before = sound.status()
    sound.scan([1.0])
    sound.pose(at=0, robot="s")
    sound.scan([1.0], at=1, robot="s")
    changed(sound.settle(received=5), before, no_pose=2)


def test_waiting_scans_are_given_up_while_other_robots_keep_the_mapper_busy(sound, eventually):
    sound.scan([1.0], robot="silent")
    stamps = iter(range(10**9))

    def given_up():
        sound.pose(robot="busy", at=next(stamps))
        return sound.status()["scans"]["dropped"]["no_pose"] == 1

    eventually(given_up)


def test_scans_wait_as_long_as_pose_wait_says(start_mapper, no_errors, eventually):
    with start_mapper(mapper={"pose_wait": 70.0}) as mapper:
        mapper.pose(at=0)
        for seq, second in enumerate((1, 2, 61, 62)):
            mapper.scan([1.0], at=second * SECOND, seq=seq)
        # The newest is 60 s newer than the two first ones.
        eventually(lambda: mapper.status()["scans"]["dropped"]["no_pose"] == 1)
        assert mapper.status()["scans"]["pending"] == 3
        mapper.pose(at=62 * SECOND)
        status = mapper.settle(received=4)
        assert status["scans"]["integrated"] == 3


def test_time_and_order(sound):
    ms = 1_000_000
    before = sound.status()
    for at in (1000, 1100, 1075, 1100):
        sound.pose(at=at * ms, robot="t")
    sound.scan([1.0], robot="t", sensor="old", at=999 * ms)  # stale
    sound.scan([1.0], robot="t", at=1099 * ms, run="a", seq=5)
    sound.scan([1.0], robot="t", at=1051 * ms, run="a", seq=6)  # older, but later in seq: fine
    sound.scan([1.0], robot="t", at=1099 * ms, run="a", seq=6)  # twice
    sound.scan([1.0], robot="t", at=1099 * ms, run="a", seq=4)  # overtaken
    sound.scan([1.0], robot="t", sensor="s2", at=1099 * ms)  # without a run there is no duplicate
    sound.scan([1.0], robot="t", sensor="s2", at=1099 * ms)
    sound.pose(at=1700 * ms, robot="t", x=1.0)
    sound.scan([1.0], robot="t", sensor="s3", at=1400 * ms)  # in a gap of more than 0.5 s
    status = sound.settle(received=11)
    changed(status, before, integrated=5, stale=1, duplicate=1, no_pose=1)
    assert status["poses"] == NO_POSES | {"received": 5, "malformed": 0, "late": 2}


def test_the_largest_seq_and_stamp(sound):
    before = sound.status()
    sound.scan([1.0], robot="t", pose=HERE, stamp=LAST, seq=LAST, run="a", time_increment=1e9)
    sound.scan([1.0], robot="t", pose=HERE, stamp=0, seq=LAST, run="a")
    sound.scan([1.0, 1.0], robot="t", stamp=LAST, seq=0, run="b", time_increment=1e290)
    sound.put("robots/t/pose", msgpack.packb({"stamp": LAST, "seq": LAST, "x": 0, "y": 0, "theta": 0}))
    sound.pose(robot="t", at=0)  # its clock has gone back
    sound.scan([1.0], robot="t", stamp=LAST)
    status = sound.settle(received=7)
    changed(status, before, integrated=1, duplicate=1, no_pose=2)
    assert status["poses"]["restarted"] == 1
    assert (status["stamp"], status["robots"]["t"]["stamp"]) == (LAST, 1_700_000_000_000_000_000)
    sound.pose(robot="t", at=0, run="new")  # a new run is a new history
    sound.scan([1.0], robot="t", sensor="new", at=0, run="new")
    assert sound.settle(received=8)["revision"] == status["revision"] + 1


def test_poses_that_are_too_far_apart_for_float64(start_mapper, no_errors):
    with start_mapper(mapper={"max_speed": "inf", "max_turn_rate": "inf"}) as mapper:
        for at, x in ((0, -1.7e308), (100, 1.7e308)):
            mapper.pose(x, x, x, at=at, robot="t")
        mapper.scan([1.0], robot="t", at=50)
        assert mapper.settle(received=1)["scans"]["dropped"]["limit"] == 1
