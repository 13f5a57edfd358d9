"""Decided messages: all that a placer has had, but scans that wait; and those that it will never have."""

import threading

import pytest

from mapper_desk import Desk
from ogm_core.placing.state import StateParts, state_of
from ogm_core.types import Pose


def restarted(desk):
    """Another life, that goes on from the state of this one."""
    after = Desk()
    after.placer.restore(state_of(StateParts().changes(desk.placer.state())))
    return after


def seqs_of(desk, sensor, run="a", robot="r"):
    """What is decided of the seqs below 12, and up to which all are."""
    decided, key = desk.placer.decided, (robot, sensor, run)
    return {n for n in range(12) if decided.is_decided(*key, n)}, decided.last(*key)


@pytest.fixture(params=["this life", "another life"])
def then(request):
    """What to look at: the desk, or one that goes on from its state."""
    return restarted if request.param == "another life" else lambda desk: desk


def test_a_scan_that_waits_is_not_decided(then):
    desk = Desk()
    for k in range(3):
        desk.pose(100 * k, run="a", seq=k)
    for seq, at in ((0, 50), (1, 150), (2, 210), (3, 205), (5, 180)):
        desk.scan(at, run="a", seq=seq)
    assert desk.order == [0, 1, 5]
    assert seqs_of(then(desk), "s") == ({0, 1, 5}, 1)
    assert seqs_of(then(desk), None) == ({0, 1, 2}, 2)
    desk.pose(300, run="a", seq=3)
    assert seqs_of(then(desk), "s") == ({0, 1, 2, 3, 5}, 3)


def test_the_first_scan_of_a_run_waits(then):
    desk = Desk().scan(0, run="a", seq=4).scan(10, run="a", seq=5, pose=Pose(0, 0, 0))
    assert seqs_of(then(desk), "s") == ({5}, None)


def test_a_pose_is_decided_whatever_is_believed(then):
    desk = Desk().pose(0, run="a", seq=1).pose(100, run="a", seq=2).pose(90, run="a", seq=3)
    desk.pose(100, Pose(9, 9, 9), run="a", seq=4).pose(110, run="b", seq=7).pose(120, run="a", seq=5)
    assert desk.receipts.status().poses.superseded == 1
    assert seqs_of(then(desk), None) == ({1, 2, 3, 4, 5}, 5)
    assert seqs_of(then(desk), None, run="b") == ({7}, 7)


def test_scans_are_decided_by_every_reason(then):
    desk = Desk().pose(0, run="a").pose(1000, run="a", seq=1)
    desk.scan(-5, run="a", seq=0).scan(500, run="a", seq=1).scan(500, run="a", seq=1)
    desk.scan(9000, run="a", seq=2)
    assert desk.dropped == {"stale": 1, "no_pose": 2, "duplicate": 1}
    assert seqs_of(then(desk), "s") == ({0, 1, 2}, 2)


def test_run_nothing_is_never_decided(then):
    desk = Desk().pose(0).pose(100, seq=1).scan(50, seq=0)
    for sensor in (None, "s"):
        assert seqs_of(then(desk), sensor, run="") == (set(), None)
    assert seqs_of(then(desk), "t") == seqs_of(then(desk), None, robot="q") == (set(), None)


def test_what_will_never_come_is_decided(then):
    desk = Desk().pose(0, run="a").pose(100, run="a", seq=3).scan(50, run="a", seq=4)
    decided = desk.placer.decided
    decided.skip("r", None, "a", 1, 2)
    decided.skip("r", "s", "a", 2)
    decided.skip("r", "s", "a", 0, 1)
    desk.receipts.pose_received("new", 0.0)
    decided.skip("new", "s", "a", 6)
    desk.placer.expire(0.0)
    assert seqs_of(then(desk), None) == ({0, 1, 2, 3}, 3)
    assert seqs_of(then(desk), "s") == ({0, 1, 2, 4}, 2)
    assert seqs_of(then(desk), "s", robot="new") == ({6}, 6)
    desk.scan(50, run="a", seq=2)  # it does come: nobody can tell it from one that was
    desk.scan(60, run="a", seq=5)
    assert (desk.order, desk.dropped) == ([4, 5], {"duplicate": 1})


def test_skipped_scans_change_no_rule_of_their_source():
    plain, desk = Desk(), Desk()
    for each in (plain, desk):
        each.pose(0, run="a").pose(400, run="a", seq=1).scan(300, run="a", seq=0)
        if each is desk:
            desk.placer.decided.skip("r", "s", "a", 7, 9)
            desk.placer.decided.skip("r", "s", "b", 0, 3)
        each.scan(200, run="a", seq=4)  # a step back: 4 is above 0, the last that came
        each.scan(210, run="b", seq=4)  # the first of its run: it waits for the next pose
        assert each.order == [0]
        each.pose(220, run="a", seq=2)
    assert (desk.order, desk.dropped) == (plain.order, plain.dropped)


def test_scans_that_are_expected_and_lost_are_decided():
    desk = restarted(Desk().scan(0, run="a", seq=0).scan(1, run="a", seq=1).scan(2, run="a", seq=2))
    assert seqs_of(desk, "s") == (set(), None)
    desk.placer.decided.skip("r", "s", "a", 0, 1)
    desk.placer.expire(0.0)
    assert seqs_of(desk, "s") == ({0, 1}, 1)
    assert seqs_of(restarted(desk), "s") == ({0, 1}, 1)
    desk.scan(2, run="a", seq=2).scan(1, run="a", seq=1)
    desk.pose(0, run="a").pose(5, run="a", seq=1)
    assert (desk.order, desk.dropped) == ([2], {"duplicate": 1})


def test_any_thread_may_ask_while_the_placer_works():
    desk, done, odd = Desk(), threading.Event(), []

    def ask():
        while not done.is_set():
            last = desk.placer.decided.last("r", None, "a")
            if last is not None and not desk.placer.decided.is_decided("r", None, "a", last):
                odd.append(last)
            desk.placer.decided.is_decided("r", "s", "a", 3)

    threads = [threading.Thread(target=ask) for _ in range(3)]
    for thread in threads:
        thread.start()
    for k in range(1500):
        desk.pose(k, run="a", seq=3 * (k // 2) + k % 2)  # every third one is missing
        if k % 50 == 0:
            desk.placer.state()
            desk.scan(k + 1, run="a", seq=k)
    done.set()
    for thread in threads:
        thread.join(20)
    assert odd == []
    assert desk.placer.decided.last("r", None, "a") == 1
