"""The books: every scan received is integrated, pending or dropped for one reason."""

import threading

import pytest

from ogm_core.placing.receipts import DROP_REASONS, Receipts
from ogm_core.placing.rules import FORGOTTEN_AFTER
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.status import SourceStatus
from ogm_core.types import Pose
from status_json import NO_POSES, as_json

NOTHING_DROPPED = dict.fromkeys(DROP_REASONS, 0)
NOWHERE = {"pose": None, "stamp": None, "alive": False, "age_s": None, "sources": {}}
QUIET = {"dropped": {}, "hints": [], "lost": 0, "beams_on_robots": 0}
NOTHING_BESIDE = {"lost": 0, "replayed": 0, "beams_on_robots": 0}


def test_an_empty_ledger_has_every_name_of_the_status():
    assert as_json(Receipts().status()) == {
        "scans": {"received": 0, "integrated": 0, "pending": 0, "dropped": NOTHING_DROPPED} | NOTHING_BESIDE,
        "poses": NO_POSES,
        "other": {"ignored": 0},
        "robots": {},
    }
    assert (
        *("malformed", "no_pose", "duplicate", "stale", "overload", "limit", "outside", "superseded"),
        *("failed", "refused"),
    ) == DROP_REASONS


def test_scans_are_counted_by_source_and_in_total():
    receipts = Receipts()
    for robot, sensor in (("a", "s"), ("a", "s"), ("a", "t"), ("b", "s"), ("b", "s")):
        receipts.scan_received(robot, sensor)
    receipts.scan_taken("a", "s", "run1", 4)
    receipts.scan_integrated("a", "s", 7)
    receipts.scan_taken("b", "s", "run2", 9)
    receipts.scan_dropped("b", "s", "stale")
    receipts.scan_dropped("b", "s", "malformed")
    status = as_json(receipts.status())
    assert status["scans"] == {
        "received": 5,
        "integrated": 1,
        "pending": 2,
        "dropped": {**NOTHING_DROPPED, "stale": 1, "malformed": 1},
        **NOTHING_BESIDE,
        "beams_on_robots": 7,
    }
    assert status["robots"]["a"]["sources"] == {
        "s": {"run": "run1", "last_seq": 4, "received": 2, "pending": 1, "integrated": 1}
        | QUIET
        | {"beams_on_robots": 7},
        "t": {"run": "", "last_seq": None, "received": 1, "pending": 1, "integrated": 0} | QUIET,
    }
    dropped = {"dropped": {"stale": 1, "malformed": 1}, "hints": [], "lost": 0, "beams_on_robots": 0}
    assert status["robots"]["b"]["sources"] == {
        "s": {"run": "run2", "last_seq": 9, "received": 2, "pending": 0, "integrated": 0} | dropped
    }


def test_what_is_lost_or_comes_again_is_not_received():
    receipts = Receipts()
    receipts.scan_received("a", "s")
    receipts.pose_received("a")
    receipts.scan_lost("a", "s", 3)
    receipts.scan_lost("a", "s", 1)
    receipts.scan_lost("a", "never heard", 5)
    receipts.scan_lost("nobody", "s", 7)
    receipts.pose_lost(11)
    receipts.pose_lost(1)
    for again in (receipts.scan_replayed, receipts.pose_replayed, receipts.pose_replayed):
        again()
    status = receipts.status()
    scans, poses = status.scans, status.poses
    assert (scans.received, scans.pending, scans.lost, scans.replayed) == (1, 1, 16, 1)
    assert (poses.received, poses.lost, poses.replayed, poses.odd) == (1, 12, 2, {})
    assert {name: robot.sources for name, robot in status.robots.items()} == {
        "a": {"s": SourceStatus("", None, 1, 1, 0, lost=4)}
    }


@pytest.mark.parametrize("reason", DROP_REASONS)
def test_a_dropped_scan_is_not_pending(reason):
    receipts = Receipts()
    receipts.scan_received("a", "s")
    assert receipts.status().scans.pending == 1
    receipts.scan_dropped("a", "s", reason)
    assert as_json(receipts.status())["scans"] == {
        "received": 1,
        "integrated": 0,
        "pending": 0,
        "dropped": {**NOTHING_DROPPED, reason: 1},
        **NOTHING_BESIDE,
    }


def test_the_last_seq_is_that_of_the_scan_taken_last():
    receipts = Receipts()
    receipts.scan_received("a", "s")
    for run, seq in (("x", 5), ("x", 7), ("y", 0)):
        receipts.scan_taken("a", "s", run, seq)
    source = as_json(receipts.status())["robots"]["a"]["sources"]["s"]
    assert (source["run"], source["last_seq"]) == ("y", 0)


def test_poses_and_other_messages():
    receipts = Receipts()
    for _ in range(4):
        receipts.pose_received("a")
    receipts.pose_noted("late")
    receipts.pose_noted("malformed")
    receipts.pose_noted("late")
    receipts.ignored()
    status = as_json(receipts.status())
    assert status["poses"] == NO_POSES | {"received": 4, "malformed": 1, "late": 2}
    assert status["other"] == {"ignored": 1}
    assert status["robots"] == {"a": NOWHERE}


def test_a_robot_is_where_it_was_last_said_to_be():
    receipts = Receipts()
    receipts.pose_received("a")
    receipts.located("a", 5, Pose(1.0, 2.0, 3.0))
    receipts.located("a", 7, Pose(4.0, 5.0, 6.0))
    assert as_json(receipts.status())["robots"]["a"] == NOWHERE | {"pose": [4.0, 5.0, 6.0], "stamp": 7}


def test_a_robot_is_alive_while_one_of_its_runs_is_and_as_old_as_its_last_message():
    receipts = Receipts()
    for run, alive in (("x", True), ("y", True), ("x", False), ("x", False)):
        receipts.robot_alive("a", run, alive)
    receipts.pose_received("a", 12.5)
    receipts.pose_received("b", 15.0)
    robots = receipts.status(now=14.0).robots
    assert [(robots[name].alive, robots[name].age_s) for name in "ab"] == [(True, 1.5), (False, 0.0)]
    receipts.robot_alive("a", "y", False)
    assert not receipts.status().robots["a"].alive


def test_a_hint_is_noted_once():
    receipts = Receipts()
    receipts.scan_received("a", "s")
    for slug in ("range_max", "turns", "range_max"):
        receipts.hint("a", "s", slug)
    assert receipts.status().robots["a"].sources["s"].hints == ["range_max", "turns"]


def test_a_status_is_a_copy():
    receipts = Receipts()
    receipts.scan_received("a", "s")
    before = receipts.status()
    before.scans.dropped.clear()
    before.robots["a"].sources.clear()
    before.robots.clear()
    assert as_json(receipts.status())["scans"]["dropped"] == NOTHING_DROPPED
    assert list(receipts.status().robots["a"].sources) == ["s"]


def test_a_message_that_is_handled_late_does_not_make_a_robot_heard_longer_ago():
    receipts = Receipts()
    receipts.scan_received("r", "s", 100.0)
    receipts.scan_received("r", "s", 103.0)
    receipts.pose_received("r", 100.0)  # the worker has come to the first one
    receipts.robot_alive("r", "run", False, 101.0)
    assert receipts.status(104.0).robots["r"].age_s == 1.0
    assert receipts.gone(103.0 + FORGOTTEN_AFTER) == []
    assert receipts.gone(103.5 + FORGOTTEN_AFTER) == ["r"]


def test_a_token_that_goes_makes_no_robot_known():
    receipts = Receipts()
    placer = ScanPlacer(None, receipts, print)
    placer.robot_gone("r", "run", 1.0)
    receipts.robot_alive("r", "run", False, 1.0)
    assert receipts.status(1.0).robots == {}
    placer.robot_here("r", "run", 2.0)
    placer.robot_gone("r", "run", 3.0)
    assert receipts.status(3.0).robots["r"].alive is False


def test_the_books_balance_at_every_moment_whatever_other_threads_do():
    receipts, rounds = Receipts(), 2000
    done = threading.Event()

    def work(robot):
        for k in range(rounds):
            receipts.scan_received(robot, f"s{k % 3}")
            if k % 2:
                receipts.scan_integrated(robot, f"s{k % 3}")
            else:
                receipts.scan_dropped(robot, f"s{k % 3}", "no_pose")

    def watch():
        while not done.is_set():
            scans = as_json(receipts.status())["scans"]
            total = scans["integrated"] + scans["pending"] + sum(scans["dropped"].values())
            if scans["received"] != total or scans["pending"] not in (0, 1, 2, 3):
                unbalanced.append(scans)

    unbalanced = []
    threads = [threading.Thread(target=work, args=(robot,)) for robot in "abc"]
    watcher = threading.Thread(target=watch)
    for thread in [watcher, *threads]:
        thread.start()
    for thread in threads:
        thread.join(20)
    done.set()
    watcher.join(20)
    assert unbalanced == []
    scans = as_json(receipts.status())["scans"]
    assert (scans["received"], scans["integrated"], scans["pending"]) == (3 * rounds, 3 * rounds // 2, 0)


def test_a_sensors_status_is_new_after_every_change():
    receipts = Receipts()
    changes = [
        (lambda: receipts.scan_received("r", "s"), "received", 2),
        (lambda: receipts.scan_taken("r", "s", "run", 7), "last_seq", 7),
        (lambda: receipts.scan_integrated("r", "s"), "integrated", 1),
        (lambda: receipts.scan_dropped("r", "s", "stale"), "dropped", {"stale": 1}),
        (lambda: receipts.hint("r", "s", "odd"), "hints", ["odd"]),
        (lambda: receipts.scan_lost("r", "s", 3), "lost", 3),
    ]
    receipts.scan_received("r", "s")
    for change, field, value in changes:
        before = receipts.status().robots["r"].sources["s"]
        assert receipts.status().robots["r"].sources["s"] is before, "made once"
        change()
        assert getattr(before, field) != value
        assert getattr(receipts.status().robots["r"].sources["s"], field) == value
