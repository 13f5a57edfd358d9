"""What robots make a mapper keep of their poses and runs is counted, and bounded for all of them together."""

import tracemalloc

import pytest

from mapper_desk import T0, Desk
from ogm_core.placing.held import Held
from ogm_core.placing.kept_poses import POSE_BYTES
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.rules import FORGOTTEN_AFTER
from ogm_core.placing.runs import MAX_RUNS, RUN_BYTES
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.placing.sequence import MAX_SPANS, SPAN_BYTES, Sequence
from ogm_core.placing.source import Source
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_services.runtime.memory import MEBIBYTE

ROBOTS, SPAN = 1000, 33
"""Robots, and the ms between the poses of an honest one."""


def flooded(desk, robots, poses):
    """Robots that send poses 1 ns apart, in turns; the most that is held meanwhile."""
    most = 0
    for k in range(poses):
        for robot in robots:
            desk.placer.add_pose(robot, PoseStamped(T0 + k, Pose(0.0, 0.0, 0.0), k, "a"))
        most = max(most, desk.placer.robots_bytes)
    return most


def test_a_thousand_robots_full_of_poses_stay_within_their_share_and_the_honest_one_is_placed():
    """In small: of each 10 poses are kept at least, 655 at most; they send 60, which would hold 2.5 MiB."""
    limit = MEBIBYTE * 7 // 4
    desk = Desk(robots_limit=limit, fewest_poses=10, most_poses=655)
    robots = [f"hostile-{n}" for n in range(ROBOTS - 1)]
    for k in range(15):
        desk.pose(SPAN * k, robot="honest", run="a")
    most = flooded(desk, robots, 60)
    assert 0.9 * limit < most <= limit
    for k in range(15, 30):
        desk.pose(SPAN * k, robot="honest", run="a")
    said = [(source, text) for source, kind, text in desk.complaints if kind == "holds the most"]
    assert {source for source, _ in said} <= set(robots)
    assert "share of memory, 1.75 MiB, those of this robot the most of it: of its " in said[0][1]
    assert "poses the newest 10 are kept" in said[0][1]
    for k in range(29):
        desk.scan(SPAN * k + 10, seq=k, robot="honest", run="a")
    assert (len(desk.order), desk.dropped) == (29, {})
    assert desk.placer.robots_bytes <= limit


def test_without_a_share_as_in_a_build_every_pose_is_kept():
    desk = Desk(fewest_poses=10, most_poses=655)
    flooded(desk, ["a", "b"], 700)
    assert 2 * 655 * POSE_BYTES <= desk.placer.robots_bytes <= 2 * 655 * POSE_BYTES * 1.25
    assert desk.complaints == []


def test_gaps_and_old_runs_of_the_robot_that_holds_the_most_go_next():
    desk = Desk(robots_limit=20_000).pose(0)
    for k in range(40):
        desk.scan(0, robot="small", run="a", seq=2 * k, pose=Pose(0, 0, 0))
    for run in range(12):
        for k in range(200):
            desk.scan(0, robot="large", run=f"run{run}", seq=2 * k, pose=Pose(0, 0, 0))
            assert desk.placer.robots_bytes <= 20_000
    [source, *others] = {source for source, kind, _ in desk.complaints if kind == "holds the most"}
    assert (source, others) == ("large", [])
    dropped = sum(desk.dropped.values())
    desk.scan(0, robot="small", run="a", seq=3, pose=Pose(0, 0, 0))  # a gap that is still known
    assert sum(desk.dropped.values()) == dropped
    desk.scan(0, robot="large", run="run11", seq=398, pose=Pose(0, 0, 0))
    assert desk.dropped == {"duplicate": dropped + 1}


def test_where_nothing_can_be_let_go_all_goes_on():
    desk = Desk(robots_limit=1)
    for k in range(50):
        desk.pose(100 * k).scan(100 * k, seq=k, run="a")
    assert (desk.order, desk.dropped) == (list(range(50)), {})
    assert desk.placer.robots_bytes > 1
    desk.scan(0, seq=0, run="b", pose=Pose(0, 0, 0)).scan(0, seq=1, run="c", pose=Pose(0, 0, 0))
    assert [kind for _, kind, _ in desk.complaints] == ["holds the most"] * 2


def test_a_robot_that_is_forgotten_and_a_history_that_ends_hold_nothing():
    desk = Desk().pose(0).pose(10)
    alone = desk.placer.robots_bytes
    for k in range(2000):
        desk.placer.add_pose("q", PoseStamped(T0 + k, Pose(0, 0, 0), k, "a"))
    desk.placer.add_pose("q", PoseStamped(T0, Pose(0, 0, 0), 0, "b"))  # another run: a new history
    both = 2 * alone + RUN_BYTES + 2 * SPAN_BYTES  # of its other run, and its seqs
    assert desk.placer.robots_bytes == both
    desk.scan(0, robot="q", run="b", seq=3)
    assert desk.placer.robots_bytes == both + RUN_BYTES + SPAN_BYTES
    placer = ScanPlacer(desk.sink, receipts := Receipts(), desk.complain)
    receipts.pose_received("r", 0.0)
    placer.add_pose("r", PoseStamped(T0, Pose(0, 0, 0)), 0.0)
    assert placer.robots_bytes > 0
    placer.expire(FORGOTTEN_AFTER + 1.0)
    assert placer.robots_bytes == 0


def test_spans_are_counted_as_they_come_and_join():
    held = Held()
    seqs = Sequence(held)
    for seq, spans in ((5, 1), (6, 1), (8, 2), (10, 3), (9, 2), (7, 1), (7, 1)):
        seqs.note(seq)
        assert held.nbytes == seqs.nbytes == SPAN_BYTES * spans
    for k in range(3000):
        seqs.note(20 + 2 * k)
    assert held.nbytes == SPAN_BYTES * MAX_SPANS
    last = seqs.last
    seqs.close_gaps()
    assert (held.nbytes, seqs.last, last - 1 in seqs, last + 1 in seqs) == (SPAN_BYTES, last, True, False)
    for k in range(5):
        seqs.note(10**9 + 2 * k)  # the numbering begins there
    assert held.nbytes == seqs.nbytes == SPAN_BYTES * 5
    assert last not in seqs


@pytest.mark.parametrize("spans", [1, 100])
def test_what_runs_take_is_about_what_is_counted(spans):
    held = Held()
    scans = [Scan(0, 0.0, 0.1, 0.0, 8.0, None, seq=2 * k, run="") for k in range(spans)]
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        source = Source("r/s", held)
        for n in range(MAX_RUNS + 2):
            run = f"{n:064}"
            for scan in scans:
                object.__setattr__(scan, "run", run)
                source.number(scan)
        del run
        taken = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert held.nbytes == MAX_RUNS * (RUN_BYTES + SPAN_BYTES * spans)
    assert 0.7 < taken / held.nbytes < 1.3
    source.runs.forget_most()
    assert held.nbytes == RUN_BYTES + SPAN_BYTES


def test_it_is_a_kind_of_the_mappers_memory(start_mapper):
    with start_mapper(mapper={"max_memory": 16 * MEBIBYTE}) as mapper:
        mapper.pose()
        mapper.scan([1.0], run="a", seq=0)
        mapper.settle(received=1)
        memory = mapper.service.memory
        assert memory.limits()["robots"] == MEBIBYTE
        assert memory.held()["robots"] == 16 * POSE_BYTES + 2 * RUN_BYTES + SPAN_BYTES
        metrics = mapper.http.get("/metrics").text
        assert 'ogm_memory_kind_limit_bytes{kind="robots",map="hall"} 1.048576e+06' in metrics
        assert f'ogm_memory_bytes{{kind="robots",map="hall"}} {memory.held()["robots"]:.1f}' in metrics
