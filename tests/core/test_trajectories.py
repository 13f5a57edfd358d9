import math

import pytest

from ogm_core.errors import BadWorld
from ogm_core.simulation.trajectories import MAX_POSES, MAX_TURN, CirclePath, WaypointPath
from ogm_core.types import Pose

SQUARE = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0))


def apart(a, b):
    return math.hypot(b.x - a.x, b.y - a.y), abs(math.remainder(b.theta - a.theta, math.tau))


@pytest.mark.parametrize("i", [0, 1, 54, 55, 110, 219])
def test_circle_is_the_formula_bit_for_bit(i):
    path = CirclePath(1.0, -2.0, 6.0, 220)
    a = 2 * math.pi * i / 220
    assert path.pose(i) == Pose(1.0 + 6.0 * math.cos(a), -2.0 + 6.0 * math.sin(a), a + math.pi / 2)


@pytest.mark.parametrize("path", [CirclePath(1.0, -2.0, 6.0, 7), WaypointPath(SQUARE, 0.3)])
def test_goes_round_and_round(path):
    first = [path.pose(i) for i in range(path.count)]
    assert [path.pose(i) for i in range(5 * path.count, 6 * path.count)] == first
    assert len(set(first)) == path.count


def test_circle_goes_counter_clockwise():
    start, quarter = CirclePath(0.0, 0.0, 2.0, 4).pose(0), CirclePath(0.0, 0.0, 2.0, 4).pose(1)
    assert start == Pose(2.0, 0.0, math.pi / 2)
    assert quarter == pytest.approx(Pose(0.0, 2.0, math.pi), abs=1e-12)


def test_waypoints_are_cut_evenly_and_turned_at():
    path = WaypointPath(SQUARE, 0.5)
    turns = math.ceil(math.pi / 2 / MAX_TURN)
    assert path.count == 4 + 2 + 4 + 2 + 4 * turns
    legs = [path.pose(i) for i in range(4)]
    assert legs == [Pose(0.0, 0.0, 0.0), Pose(0.5, 0.0, 0.0), Pose(1.0, 0.0, 0.0), Pose(1.5, 0.0, 0.0)]
    corner = [path.pose(4 + i) for i in range(turns + 1)]
    assert {(pose.x, pose.y) for pose in corner} == {(2.0, 0.0)}
    thetas = [pose.theta for pose in corner]
    assert thetas == pytest.approx([math.pi / 2 * j / turns for j in range(turns + 1)])
    assert path.pose(4 + turns + 1) == Pose(2.0, 0.5, math.pi / 2)


@pytest.mark.parametrize(
    "points",
    [
        SQUARE,
        SQUARE[::-1],
        ((0.0, 0.0), (3.0, 0.0)),
        ((0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (1.0, 4.0)),
        ((-1.0, -1.0), (-1.0, 1.0), (-3.0, 1.01), (-1.5, -0.2), (4.0, 0.0)),
    ],
)
@pytest.mark.parametrize("spacing", [0.1, 0.37, 10.0])
def test_no_step_is_large(points, spacing):
    path = WaypointPath(points, spacing)
    poses = [path.pose(i) for i in range(path.count)]
    for a, b in zip(poses, [*poses[1:], poses[0]], strict=True):
        step, turn = apart(a, b)
        assert step <= spacing + 1e-9
        assert turn <= MAX_TURN + 1e-9
        assert step == 0.0 or turn < 1e-9, "drives or turns, never both"
        if step:
            assert math.atan2(b.y - a.y, b.x - a.x) == pytest.approx(math.remainder(a.theta, math.tau))
    assert {(x, y) for x, y in points} <= {(pose.x, pose.y) for pose in poses}


def test_turns_the_short_way_across_pi():
    """From heading 170 degrees to -170 degrees is a left turn of 20 degrees."""
    out, back = math.radians(170), math.radians(-170)
    corner = (3 * math.cos(out), 3 * math.sin(out))
    end = (corner[0] + 3 * math.cos(back), corner[1] + 3 * math.sin(back))
    path = WaypointPath(((0.0, 0.0), corner, end), 1.0)
    turning = [pose.theta for i in range(path.count) if (pose := path.pose(i))[:2] == corner]
    assert turning == pytest.approx([out, out + math.radians(10), back])


def test_decimal_spacing_makes_no_extra_step():
    """2.1 / 0.7 is 3.0000000000000004."""
    path = WaypointPath(((0.0, 0.0), (2.1, 0.0)), 0.7)
    xs = [path.pose(i).x for i in range(4)]
    assert xs == pytest.approx([0.0, 0.7, 1.4, 2.1])


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: CirclePath(0.0, 0.0, 0.0, 10), "circle: a radius above 0"),
        (lambda: CirclePath(0.0, 0.0, math.nan, 10), "circle: a radius above 0"),
        (lambda: CirclePath(0.0, 0.0, 1.0, 0), "poses: 1 to 100000"),
        (lambda: CirclePath(0.0, 0.0, 1.0, MAX_POSES + 1), "poses: 1 to 100000"),
        (lambda: WaypointPath((), 0.1), "waypoints: at least 2 are needed, got 0"),
        (lambda: WaypointPath(((0.0, 0.0),), 0.1), "waypoints: at least 2 are needed, got 1"),
        (lambda: WaypointPath((*SQUARE, SQUARE[-1]), 0.1), "waypoints: entries 3 and 4 are the same point$"),
        (
            lambda: WaypointPath((*SQUARE, SQUARE[0]), 0.1),
            "waypoints: entries 4 and 0 .* back to the first by itself",
        ),
        (lambda: WaypointPath(SQUARE, 0.0), "spacing: more than 0 m"),
        (lambda: WaypointPath(SQUARE, math.inf), "spacing: more than 0 m"),
        (lambda: WaypointPath(SQUARE, math.nan), "spacing: more than 0 m"),
        (lambda: WaypointPath(SQUARE, 1e-9), "spacing: 1e-09 m cuts 6 m into more than 100000 poses"),
    ],
)
def test_refusals(make, text):
    with pytest.raises(BadWorld, match=f"^path: {text}"):
        make()
