"""tf trees: every edge at its time, in 3D; what is missing is named, and never taken for the identity."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import naive_tf
from ogm_core.errors import BadMessage, NoTransform, NoTransformYet
from ogm_core.ros2.cdr import StampedTransform
from ogm_core.ros2.tf_history import MAX_SAMPLES, SPAN_NS
from ogm_core.ros2.tf_tree import MAX_FRAMES, TfTree
from ogm_core.ros2.transform import IDENTITY, Transform, level, unit
from ogm_core.types import Pose

S = 10**9
MS = 10**6
SMALL = st.floats(-5.0, 5.0)
TRANSFORMS = st.builds(
    lambda x, y, z, rotation: Transform(x, y, z, *(part / math.hypot(*rotation) for part in rotation)),
    *(SMALL, SMALL, SMALL),
    st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda rotation: math.hypot(*rotation) > 0.1),
)


def at(x=0.0, y=0.0, yaw=0.0, z=0.0):
    return Transform(x, y, z, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def edge(stamp, parent, child, transform=None):
    return StampedTransform(stamp, parent, child, at() if transform is None else transform)


def tree_of(*edges, static=(), **rules):
    tree = TfTree(**rules)
    tree.add(static, static=True)
    tree.add(edges)
    return tree


def driven(**rules):
    """map -> odom at 0 and 1 s; odom -> base every 100 ms up to 2 s, 1 m/s; base -> laser fixed, at 0.5 m."""
    return tree_of(
        *(edge(n * S, "map", "odom", at(y=n)) for n in range(2)),
        *(edge(n * 100 * MS, "odom", "base", at(x=n / 10)) for n in range(21)),
        static=[edge(0, "base", "laser", at(x=0.5))],
        **rules,
    )


def missing(tree, *args, later, **kwargs):
    with pytest.raises(NoTransform) as caught:
        tree.lookup(*args, **kwargs)
    assert (type(caught.value) is NoTransformYet) is later
    assert caught.value.slug == "no_pose"
    return str(caught.value)


def assert_same(found, expected):
    np.testing.assert_allclose(naive_tf.matrix(found), expected, atol=1e-7)


@given(st.lists(TRANSFORMS, min_size=1, max_size=6))
def test_static_edges_are_composed_as_matrices_are(chain):
    samples = {f"f{n + 1}": (f"f{n}", [(0, transform)]) for n, transform in enumerate(chain)}
    tree = tree_of(static=[edge(0, parent, child, one) for child, (parent, [(_, one)]) in samples.items()])
    found = tree.lookup("f0", f"f{len(chain)}", 123)
    assert_same(found, naive_tf.lookup(samples, "f0", f"f{len(chain)}", 123))
    assert found.planar()[:2] == pytest.approx(
        naive_tf.planar(naive_tf.lookup(samples, "f0", f"f{len(chain)}", 1))[:2]
    )


@given(st.lists(st.tuples(TRANSFORMS, TRANSFORMS), min_size=1, max_size=4), st.integers(0, 400 * MS))
def test_moving_edges_are_interpolated_as_rotations_about_one_axis(chain, stamp):
    samples = {
        f"f{n + 1}": (f"f{n}", [(0, one), (400 * MS, other)])
        for n, (one, other) in enumerate(chain)
        if abs(sum(a * b for a, b in zip(one[3:], other[3:], strict=True))) > 1e-3  # else there are two ways
    }
    if len(samples) < len(chain):
        return
    tree = tree_of(*(edge(t, p, child, one) for child, (p, both) in samples.items() for t, one in both))
    last = f"f{len(chain)}"
    found = tree.lookup("f0", last, stamp)
    assert_same(found, naive_tf.lookup(samples, "f0", last, stamp))
    assert math.hypot(*found[3:]) == pytest.approx(1.0)


def test_a_quarter_of_a_turn_in_the_middle_is_an_eighth():
    tree = tree_of(edge(0, "odom", "base", at(1, 2, 3.0)), edge(400 * MS, "odom", "base", at(3, 2, -3.0)))
    x, y, theta = tree.lookup("odom", "base", 100 * MS).planar()
    turn = 2 * math.pi - 6.0  # by the shorter way, through pi
    assert (x, y) == (1.5, 2.0)
    assert math.remainder(theta - (3.0 + turn / 4), math.tau) == pytest.approx(0.0, abs=1e-12)


def test_the_time_of_a_sample_gives_that_sample():
    one = Transform(0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5)
    tree = tree_of(edge(0, "odom", "base"), edge(100, "odom", "base", one), edge(200, "odom", "base"))
    assert tree.lookup("odom", "base", 100) == one


def test_a_robot_is_followed_up_to_the_map():
    found = driven().lookup("map", "laser", 750 * MS, anchor="base")
    assert found.planar() == pytest.approx((1.25, 0.75, 0.0))


def test_a_frame_with_two_children_is_walked_from_below():
    tree = driven()
    tree.add([edge(100 * MS, "odom", "footprint", at(x=9)), edge(200 * MS, "odom", "footprint", at(x=9))])
    assert tree.path("laser") == ("laser", "base", "odom", "map")
    assert tree.lookup("odom", "laser", 150 * MS).planar() == pytest.approx((0.65, 0.0, 0.0))
    assert tree.lookup("odom", "footprint", 150 * MS).x == 9.0


def test_only_edges_above_the_anchor_are_held():
    tree = driven()
    assert tree.lookup("map", "laser", 1900 * MS, anchor="base").planar() == pytest.approx((2.4, 1.0, 0.0))
    text = missing(tree, "map", "laser", 1900 * MS, later=True)
    assert text == "no transform from laser to map: map -> odom: its newest sample is 0.900 s older"
    text = missing(tree, "map", "laser", 2001 * MS, anchor="base", later=True)
    assert text == "no transform from laser to map: odom -> base: its newest sample is 0.001 s older"


@pytest.mark.parametrize(("tf_hold", "held"), [(0.0, 0), (0.25, 250), (1.0, 1000)])
def test_an_edge_is_held_for_tf_hold(tf_hold, held):
    tree = driven(tf_hold=tf_hold)
    tree.lookup("map", "base", S + held * MS, anchor="base")
    if held < 1000:
        missing(tree, "map", "base", S + held * MS + 1, anchor="base", later=True)


def test_post_dated_samples_as_a_localizer_sends_them():
    # Each holds for a time that is still to come, and is sent at 2 Hz.
    tree = driven()
    tree.add(edge(n * S // 2 + S, "map", "odom", at(y=n)) for n in range(1, 3))
    assert tree.lookup("map", "base", 1250 * MS, anchor="base").planar() == pytest.approx((1.25, 1.0, 0))
    assert tree.lookup("map", "base", 1750 * MS, anchor="base").planar() == pytest.approx((1.75, 1.5, 0))


def test_a_slow_edge_between_two_samples_is_interpolated_up_to_tf_hold_then_held():
    slow = [edge(t * 100 * MS, "odom", "base") for t in range(61)]
    tree = tree_of(*slow, edge(0, "map", "odom"), edge(S, "map", "odom", at(x=1)), edge(6 * S, "map", "odom"))
    assert tree.lookup("map", "base", S // 2, anchor="base").x == pytest.approx(0.5)
    assert tree.lookup("map", "base", 2 * S, anchor="base").x == 1.0
    text = missing(tree, "map", "base", 2 * S + 1, anchor="base", later=False)
    assert (
        text == "no transform from base to map: map -> odom: it has a gap of 5.000 s then (pose_gap: 0.5 s)"
    )


def test_nothing_is_said_of_a_gap_unless_the_robot_stood():
    tree = tree_of(
        edge(0, "odom", "base"), edge(600 * MS, "odom", "base", at(x=0.02)), edge(9 * S, "odom", "base")
    )
    assert "gap of 0.600 s" in missing(tree, "odom", "base", MS, later=False)
    stood = tree_of(edge(0, "odom", "base"), edge(9 * S, "odom", "base", at(0.005, 0.005, math.radians(0.4))))
    assert stood.lookup("odom", "base", 4500 * MS).x == pytest.approx(0.0025)
    turned = tree_of(edge(0, "odom", "base"), edge(9 * S, "odom", "base", at(yaw=math.radians(0.6))))
    missing(turned, "odom", "base", S, later=False)
    wide = tree_of(edge(0, "odom", "base"), edge(600 * MS, "odom", "base", at(x=1)), pose_gap=0.6)
    assert wide.lookup("odom", "base", 300 * MS).x == pytest.approx(0.5)


def test_nothing_is_said_of_the_time_before_the_oldest():
    text = missing(driven(), "map", "laser", -10 * MS, anchor="base", later=False)
    assert text == "no transform from laser to map: odom -> base: its oldest sample is 0.010 s newer"


def test_what_is_missing_is_named_with_the_frames_that_there_are():
    assert missing(TfTree(), "map", "laser", 0, later=True) == (
        "no transform from laser to map: no tf says where laser is; no tf has come yet"
    )
    tree = driven()
    assert missing(tree, "map", "lidar", 0, later=True) == (
        "no transform from lidar to map: no tf says where lidar is; there are base, laser, map, odom"
    )
    assert missing(tree, "world", "laser", 0, later=True) == (
        "no transform from laser to world: tf leads up from it to map only; there are base, laser, map, odom"
    )
    # Never downward: the map is not below the laser.
    missing(tree, "laser", "map", 0, later=True)
    assert tree.lookup("map", "map", 0) == IDENTITY


def test_an_error_shows_some_of_many_frames_and_no_control_characters():
    tree = tree_of(static=[edge(0, "a", f"child{n:03}") for n in range(100)])
    text = missing(tree, "map", "las\ner" + "r" * 1000, 0, later=True)
    assert "child018 and 81 more" in text
    assert "child019" not in text
    assert "\n" not in text
    assert len(text) < 700


def test_of_static_edges_the_newest_that_came_holds_and_publishers_merge():
    tree = tree_of(static=[edge(5, "base", "laser", at(x=1)), edge(5, "base", "imu")])
    tree.add([edge(3, "base", "laser", at(x=2)), edge(3, "base", "camera")], static=True)
    assert tree.lookup("base", "laser", -7).x == 2.0
    assert tree.frames == ["base", "camera", "imu", "laser"]


def test_a_late_static_edge_completes_the_way():
    tree = tree_of(*(edge(n * 100 * MS, "odom", "base") for n in range(5)))
    missing(tree, "odom", "laser", 100 * MS, later=True)
    tree.add([edge(0, "base", "mast", at(x=1))], static=True)
    missing(tree, "odom", "laser", 100 * MS, later=True)
    tree.add([edge(0, "mast", "laser", at(x=1))], static=True)
    assert tree.lookup("odom", "laser", 100 * MS).x == 2.0


def test_a_frame_whose_parent_changes_forgets_where_it_was():
    tree = driven()
    tree.add([edge(2050 * MS, "odom2", "base", at(x=7)), edge(2150 * MS, "odom2", "base", at(x=7))])
    assert tree.counts == {"reparented": 1}
    missing(tree, "odom", "base", 100 * MS, later=True)
    missing(tree, "odom2", "base", 1950 * MS, later=False)
    assert tree.lookup("odom2", "laser", 2100 * MS).x == pytest.approx(7.5)


def test_a_frame_that_becomes_static_or_moves_after_all():
    tree = tree_of(edge(100, "base", "laser", at(x=1)))
    tree.add([edge(0, "base", "laser", at(x=2))], static=True)
    assert tree.lookup("base", "laser", 5000).x == 2.0
    tree.add([edge(200, "base", "laser", at(x=3))])
    assert tree.lookup("base", "laser", 200).x == 3.0
    missing(tree, "base", "laser", 100, later=False)


def test_a_loop_is_named_not_followed_and_can_be_undone():
    tree = tree_of(static=[edge(0, "a", "b"), edge(0, "b", "c"), edge(0, "c", "a"), edge(0, "b", "laser")])
    assert missing(tree, "map", "laser", 0, later=False) == "tf goes round in a loop: b -> a -> c -> b"
    tree.add([edge(0, "map", "a", at(x=1))], static=True)
    assert tree.lookup("map", "laser", 0).x == 1.0


def test_samples_come_in_any_order():
    tree = tree_of(*(edge(n * 100 * MS, "odom", "base", at(x=n / 10)) for n in (0, 3, 1, 2, 4)))
    assert tree.counts == {"reordered": 2}
    for tenth in range(9):
        assert tree.lookup("odom", "base", tenth * 50 * MS).x == pytest.approx(tenth / 20)


def test_of_two_samples_of_one_stamp_the_first_stays():
    tree = tree_of(*(edge(100, "odom", "base", at(x=x)) for x in (1, 2)))
    assert tree.lookup("odom", "base", 100).x == 1.0
    assert tree.counts == {"repeated": 1}


def test_a_clock_that_is_set_back_begins_anew():
    late = 10**18
    tree = tree_of(edge(late, "odom", "base", at(x=1)), edge(5, "odom", "base", at(x=2)))
    assert tree.counts == {"restarted": 1}
    assert tree.lookup("odom", "base", 5).x == 2.0
    missing(tree, "odom", "base", late, later=True)


def test_a_clock_that_is_set_back_by_seconds_begins_anew_with_the_fifth_late_sample():
    """As where a simulator or a recording begins again: the same stamps, another way."""
    moving = [edge(n * 100 * MS, "odom", "base", at(x=n)) for n in range(50)]
    tree = tree_of(edge(4 * S, "map", "odom", at(y=1)), *moving)
    tree.add([edge(n * 100 * MS, "odom", "base", at(x=-n)) for n in range(4)])
    assert tree.lookup("odom", "base", 200 * MS).x == 2.0
    tree.add([edge(400 * MS, "odom", "base", at(x=-4))])
    assert tree.counts == {"repeated": 4, "restarted": 1}
    assert tree.lookup("odom", "base", 250 * MS).x == -2.5
    missing(tree, "odom", "base", 4 * S, later=True)
    # What is above was told by the clock of before.
    assert missing(tree, "map", "base", 200 * MS, later=True).endswith("since the clock went back")
    tree.add([edge(0, "map", "odom", at(y=2)), edge(S, "map", "odom", at(y=2))])
    assert tree.lookup("map", "base", 200 * MS).y == 2.0


@pytest.mark.parametrize("stamps", [(45, 45, 44, 43, 44, 45, 46, 47), (10, 11, 12, 13, 50, 14, 15, 16)])
def test_a_few_late_samples_are_no_clock_that_went_back(stamps):
    tree = tree_of(*(edge(n * 100 * MS, "odom", "base", at(x=n)) for n in range(50)))
    tree.add([edge(n * 100 * MS, "odom", "base", at(x=-n)) for n in stamps])
    assert tree.counts["restarted"] == 0
    assert tree.lookup("odom", "base", 49 * 100 * MS).x == 49.0


@pytest.mark.parametrize(
    ("what", "given"),
    [
        ("no_name", edge(0, "", "base")),
        ("no_name", edge(0, "odom", "")),
        ("no_name", edge(0, "odom", "b" * 257)),
        ("own_parent", edge(0, "base", "base")),
        ("bad_transform", edge(0, "elsewhere", "base", Transform(0, 0, 0, 0, 0, 0, 0))),
        ("bad_transform", edge(0, "elsewhere", "base", Transform(math.nan, 0, 0, 0, 0, 0, 1))),
        ("bad_transform", edge(0, "odom", "base", Transform(0, math.inf, 0, 0, 0, 0, 1))),
        ("bad_transform", edge(0, "odom", "base", Transform(0, 0, 0, 0, 0, 0, math.nan))),
        ("bad_transform", edge(0, "odom", "base", Transform(0, 0, 2e9, 0, 0, 0, 1))),
        ("bad_transform", edge(0, "odom", "base", Transform(0, 0, 0, 0, 0, 0, 1.1))),
        ("bad_transform", edge(0, "odom", "base", Transform(0, 0, 0, 1e300, 0, 0, 1))),
    ],
)
@pytest.mark.parametrize("static", [False, True])
def test_what_is_no_transform_is_counted_and_changes_nothing(what, given, static):
    tree = driven()
    [complaint] = tree.add([given], static=static)
    assert complaint.what == what
    assert tree.counts == {what: 1}
    assert tree.lookup("odom", "base", 150 * MS).x == pytest.approx(0.15)
    assert tree.frames == ["base", "laser", "map", "odom"]


def test_a_quaternion_rounded_to_float32_is_made_a_unit_again():
    rough = Transform(1, 2, 3, *(float(np.float32(part)) for part in (0.1, 0.2, 0.3, math.sqrt(0.86))))
    assert math.hypot(*unit(rough)[3:]) == pytest.approx(1.0, abs=1e-15)
    with pytest.raises(BadMessage, match=r"got \(0, 0, 0, 0\); none is \(0, 0, 0, 1\)"):
        unit(Transform(0, 0, 0, 0, 0, 0, 0))


def test_histories_are_bounded_in_time_and_number():
    tree = tree_of(*(edge(n * S, "odom", "base") for n in range(1000)))
    kept = tree.edge("base").stamps_after(None)
    assert (kept[0], kept[-1]) == (999 * S - SPAN_NS, 999 * S)
    tree = tree_of(*(edge(n * 1000, "odom", "base") for n in range(3 * MAX_SAMPLES)))
    history = tree.edge("base")
    assert len(history) == len(history.stamps_after(None)) == MAX_SAMPLES
    assert history.newest == (3 * MAX_SAMPLES - 1) * 1000
    missing(tree, "odom", "base", 0, later=False)


def test_frames_are_bounded():
    tree = tree_of(*(edge(0, "odom", f"f{n}") for n in range(MAX_FRAMES + 7)))
    assert tree.counts == {"too_many_frames": 7}
    assert len(tree.frames) == MAX_FRAMES + 1
    tree.add([edge(9, "odom", "f0", at(x=1))])  # those that are there go on
    assert tree.lookup("odom", "f0", 9).x == 1.0


def test_an_inverse_undoes_its_transform_and_a_level_pose_is_itself():
    there = unit(Transform(1.0, -2.0, 0.5, 0.1, 0.2, 0.3, math.sqrt(1 - 0.14)))
    assert there.compose(there.inverse()) == pytest.approx(IDENTITY, abs=1e-12)
    assert there.inverse().compose(there) == pytest.approx(IDENTITY, abs=1e-12)
    assert level(Pose(1.0, 2.0, -2.5)).planar() == pytest.approx(Pose(1.0, 2.0, -2.5))
