"""A map that is stored: it goes on where it was after its mapper was killed, or stopped."""

import signal
import sqlite3
from contextlib import closing

import httpx
import pytest

from ogm_client import RobotPublisher

SWEEP = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 9.0}
STAMP = 10**18


@pytest.fixture
def data(tmp_path):
    return tmp_path / "data"


def started(ogm, data, *flags):
    return ogm.ready(ogm.mapper("--data", data, *flags))


def drive(mapper, eventually, first, last, sweep=0):
    """Scans first to last, each with a pose at its stamp in a message of its own."""
    before = mapper.status()["scans"]["integrated"]
    with RobotPublisher("r1", address=mapper.endpoint, run=f"drive{sweep}") as robot:
        robot.wait_for_mapper(30.0)
        for k in range(first, last):
            robot.publish_pose(0.05 * k, 0.0, 0.1 * k, stamp=STAMP + k * 10**8)
            robot.publish_scan([2.0 + 0.01 * k] * 20, **SWEEP, stamp=STAMP + k * 10**8)
        eventually(lambda: mapper.status()["scans"]["integrated"] == before + last - first)


def served(mapper):
    """What stays the same when a map is stored and restored: its identity but for the run, and its cells."""
    answer = httpx.get(f"{mapper.url}map.npz", timeout=30.0).raise_for_status()
    names = ("epoch", "revision", "stamp", "resolution", "origin")
    return {name: answer.headers[f"ogm-{name}"] for name in names}, answer.content


def metrics(mapper):
    return httpx.get(f"{mapper.url}metrics", timeout=30.0).text


def stored(mapper, revision):
    """Whether so much of the map is stored, as its metrics say."""
    return f'ogm_stored_revision{{map="default"}} {revision}.0' in metrics(mapper)


def counted(mapper):
    """Scans of the robot's one sensor: received, integrated, and the last seq."""
    (source,) = mapper.status()["robots"]["r1"]["sources"].values()
    return source["received"], source["integrated"], source["last_seq"]


@pytest.mark.parametrize(
    "flags",
    [(), ("--half-life", "1"), ("--cell-model", "rate", "--half-life", "1")],
    ids=["", "forgetting", "counting, forgetting"],
)
def test_after_a_kill_the_map_goes_on_where_it_was_stored_and_after_a_stop_where_it_ended(
    ogm, eventually, data, flags
):
    mapper = started(ogm, data, *flags)
    drive(mapper, eventually, 0, 20)
    eventually(lambda: stored(mapper, 20))
    before, run = served(mapper), mapper.status()["run"]
    mapper.command.process.send_signal(signal.SIGKILL)
    mapper.command.process.wait()

    again = started(ogm, data, *flags)
    assert again.status()["run"] != run
    assert served(again) == before
    assert counted(again) == (20, 20, 19)
    assert 'ogm_scans_integrated_total{map="default"} 0.0' in metrics(again), "counters begin anew"
    assert httpx.get(f"{again.url}readyz").status_code == 200
    drive(again, eventually, 20, 25, sweep=1)
    assert counted(again) == (25, 25, 4)
    assert 'ogm_scans_integrated_total{map="default"} 5.0' in metrics(again)
    last = served(again)
    assert (last[0]["revision"], last[0]["epoch"]) == ("25", before[0]["epoch"])
    assert again.command.stop().code == 0
    assert served(started(ogm, data, *flags)) == last


def test_what_a_stopped_mapper_knew_of_a_robot_the_next_one_knows(ogm, eventually, data):
    mapper = started(ogm, data)
    drive(mapper, eventually, 0, 10)
    assert mapper.command.stop().code == 0
    again = started(ogm, data)
    with RobotPublisher("r1", address=again.endpoint, run="drive0") as robot:
        robot.wait_for_mapper(30.0)
        # It numbers anew, so its first scan is one that is in the map already.
        robot.publish_scan([2.0] * 20, **SWEEP, stamp=STAMP)
        eventually(lambda: again.status()["scans"]["dropped"]["duplicate"] == 1)
    assert again.status()["revision"] == 10


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--resolution", "0.1"], ["resolution", "0.05", "0.1"]),
        (["--p-occ", "0.9"], ["p_occ", "0.7", "0.9"]),
    ],
)
def test_settings_that_contradict_the_stored_map_are_refused_by_name(ogm, eventually, data, flags, said):
    mapper = started(ogm, data)
    drive(mapper, eventually, 0, 2)
    mapper.command.stop()
    complaint = ogm.mapper("--data", data, *flags).wait().complaint(2)
    assert all(word in complaint for word in said), complaint


def test_a_start_map_takes_no_stored_maps_place(ogm, eventually, data, tmp_path):
    mapper = started(ogm, data)
    drive(mapper, eventually, 0, 2)
    (tmp_path / "start.npz").write_bytes(served(mapper)[1])
    mapper.command.stop()
    command = ogm.mapper("--data", data, "--start-map", tmp_path / "start.npz")
    assert "mapper.start_map" in command.wait().complaint(2)
    assert started(ogm, data).status()["revision"] == 2


def test_a_folder_has_one_mapper(ogm, data):
    first = started(ogm, data)
    complaint = ogm.mapper("--data", data).wait().complaint(1)
    assert str(data) in complaint
    assert str(first.command.process.pid) in complaint


def test_a_damaged_store_is_refused_and_repair_is_named(ogm, eventually, data):
    mapper = started(ogm, data)
    drive(mapper, eventually, 0, 2)
    mapper.command.stop()
    with closing(sqlite3.connect(data / "map.sqlite")) as connection, connection:
        connection.execute("UPDATE tiles SET record = zeroblob(length(record)) WHERE rowid = 1")
        assert connection.total_changes == 1
    assert f"ogm repair {data} --out" in ogm.mapper("--data", data).wait().complaint(2)
