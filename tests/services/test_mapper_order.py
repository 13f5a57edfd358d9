"""Which pose a scan gets, and in which order scans go in."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper_desk import MS, T0, Desk
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.types import Pose, PoseStamped, Scan


def test_a_scan_gets_the_pose_at_its_stamp():
    desk = Desk().pose(0, Pose(0, 0, 3.0)).pose(400, Pose(4, -2, -3.0))
    desk.scan(100).scan(400).scan(0, sensor="other")
    turn = 2 * math.pi - 6.0
    assert desk.sink.placed[0] == (0, pytest.approx((1.0, -0.5, 3.0 + turn / 4)))
    assert desk.sink.placed[1:] == [(1, Pose(4, -2, -3.0)), (2, Pose(0, 0, 3.0))]
    assert desk.dropped == {}


def test_the_sink_gets_the_sensor_pose():
    desk = Desk().pose(0, Pose(1.0, 2.0, math.pi / 2))
    desk.scan(0, mount=Pose(0.5, 0.25, 0.1))
    assert desk.sink.placed[0][1] == pytest.approx((0.75, 2.5, math.pi / 2 + 0.1))


def test_a_scan_waits_until_a_pose_at_or_after_it_has_come():
    desk = Desk().pose(0).scan(50)
    assert (desk.order, desk.pending) == ([], 1)
    desk.pose(49)
    assert (desk.order, desk.pending) == ([], 1)
    desk.pose(50)
    assert (desk.order, desk.xs, desk.pending) == ([0], [0.05], 0)


def test_of_a_scan_that_is_integrated_it_is_known_when_it_came():
    desk = Desk().pose(0)
    desk.now = 1.0
    desk.scan(50)
    desk.now = 2.0
    desk.scan(0).scan(9, pose=Pose(0, 0, 0), sensor="other").scan(-9999, sensor="third")
    desk.now = 3.0
    desk.pose(50)
    assert desk.arrivals == [2.0, 2.0, 1.0]
    assert desk.dropped == {"stale": 1}


def test_the_last_beam_must_be_covered_and_the_pose_is_that_of_the_first():
    desk = Desk().pose(0).scan(10, beams=11, time_increment=0.002)  # until 30 ms
    desk.pose(20)
    assert desk.order == []
    desk.pose(29.999999)
    assert desk.order == []
    desk.pose(30)
    assert (desk.order, desk.xs) == ([0], [pytest.approx(0.01)])


def test_a_sweep_that_runs_backwards_in_time_is_ready_at_its_stamp():
    desk = Desk().pose(0).scan(20, beams=11, time_increment=-0.001)
    desk.pose(19)
    assert desk.order == []
    assert desk.pose(20).order == [0]


def test_scans_go_in_as_they_become_ready_and_in_order_of_arrival_at_one_message():
    desk = Desk().pose(0)
    desk.scan(300, sensor="a").scan(100, sensor="b").scan(200, sensor="b").scan(90, sensor="c")
    desk.pose(150)
    assert desk.order == [1, 3]
    desk.scan(40, sensor="d")
    assert desk.order == [1, 3, 4]
    desk.pose(400)
    assert desk.order == [1, 3, 4, 0, 2]
    assert desk.xs == pytest.approx([0.1, 0.09, 0.04, 0.3, 0.2])


def test_sensors_of_a_robot_share_its_order():
    desk = Desk().pose(0).scan(30, sensor="a").scan(20, sensor="b").scan(10, sensor="a").pose(30)
    assert desk.order == [0, 1, 2]


def test_a_scan_with_its_own_pose_needs_no_history():
    own = Pose(5.0, 6.0, 7.0)
    desk = Desk().scan(100, pose=own)
    desk.pose(0).pose(900)  # a gap, and poses that say otherwise
    desk.scan(450, pose=own).scan(-100, pose=own).scan(5000, pose=own, beams=100, time_increment=1.0)
    desk.scan(6000, pose=own, mount=Pose(1.0, 0.0, 0.0))
    assert [pose for _, pose in desk.sink.placed[:4]] == [own] * 4
    assert desk.sink.placed[4][1] == pytest.approx((5 + math.cos(7), 6 + math.sin(7), 7))
    assert desk.dropped == {}


def test_robots_do_not_share_their_poses():
    desk = Desk().pose(0, robot="a").pose(0, robot="b").scan(10, robot="b").pose(100, robot="a")
    assert (desk.order, desk.pending) == ([], 1)
    desk.pose(10, Pose(0.05, 0.05, 0.1), robot="b")
    assert desk.sink.placed == [(0, Pose(0.05, 0.05, 0.1))]


def test_a_scan_with_its_own_pose_passes_those_that_wait():
    desk = Desk().pose(0).scan(10).scan(20, pose=Pose(0, 0, 0)).pose(100)
    assert desk.order == [1, 0]


MESSAGES = st.lists(
    st.one_of(
        st.tuples(
            st.just("pose"), st.integers(0, 30), st.sampled_from("pqr"), st.sampled_from(["", "a", "b"])
        ),
        st.tuples(
            st.just("scan"), st.integers(0, 30), st.sampled_from("pqr"), st.sampled_from(["", "a", "b"])
        ),
        st.tuples(
            st.just("sweep"), st.integers(0, 30), st.sampled_from("pqr"), st.sampled_from(["", "a", "b"])
        ),
    ),
    max_size=60,
)


def feed(desk, messages):
    """Put messages through a desk: stamps are steps of 50 ms, and seqs the numbers of the messages."""
    for number, (kind, step, robot, run) in enumerate(messages):
        before = len(desk.sink.placed)
        if kind == "pose":
            desk.pose(50 * step, Pose(step, number, 0.3 * step), robot=robot, run=run)
        else:
            sweep = {"beams": 5, "time_increment": 0.05} if kind == "sweep" else {}
            desk.scan(50 * step, seq=number, robot=robot, run=run, **sweep)
        yield number, [seq for seq, _ in desk.sink.placed[before:]]


@given(MESSAGES)
def test_whatever_comes_scans_are_ready_in_time_and_go_in_arrival_order(messages):
    desk, newest, runs = Desk(), {}, {}
    for number, placed in feed(desk, messages):
        kind, step, robot, run = messages[number]
        assert placed == sorted(placed)
        if kind != "pose":
            assert placed in ([], [number])
        elif run not in runs.setdefault(robot, set()):
            runs[robot].add(run)
            newest[robot] = step
        else:
            newest[robot] = max(newest[robot], step)
        for seq in placed:
            what, start, owner, _ = messages[seq]
            assert owner == robot
            assert start + (4 if what == "sweep" else 0) <= newest[robot]
    for seq, pose in desk.sink.placed:
        assert pose.x == pytest.approx(messages[seq][1])
    desk.placer.finish()
    assert desk.pending == 0


@given(MESSAGES)
def test_equal_messages_in_equal_order_give_equal_calls_and_counts(messages):
    first, second = Desk(), Desk()
    assert list(feed(first, messages)) == list(feed(second, messages))
    assert first.sink.placed == second.sink.placed
    assert first.receipts.status() == second.receipts.status()


def test_equal_messages_in_equal_order_give_equal_cells():
    def build():
        rng = np.random.default_rng(1)
        grid, receipts = OccupancyGrid(GridSettings(), "e"), Receipts()
        mapper = ScanPlacer(grid, receipts, lambda *_: None)
        for k in range(60):
            ranges = rng.uniform(0.5, 6.0, 40).astype(np.float32)
            stamp = T0 + k * 50 * MS + int(rng.integers(-60 * MS, 60 * MS))
            receipts.scan_received("r", "s")
            mapper.add_scan("r", "s", Scan(stamp, -2.0, 0.1, 0.0, 8.0, ranges, seq=k, run="a"))
            mapper.add_pose("r", PoseStamped(T0 + k * 50 * MS, Pose(*rng.uniform(-3, 3, 3)), run="a"))
        return grid.snapshot(), receipts.status()

    (first, counts), (second, again) = build(), build()
    assert first.cells.any()
    assert (first.offset, first.revision, counts) == (second.offset, second.revision, again)
    assert np.array_equal(first.cells, second.cells)
