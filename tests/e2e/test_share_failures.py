"""What becomes of shares when something fails: rows of the table in docs/guarantees.md, with real processes.

Two shares with their stores, a gateway and a router serve one test after the other. What is killed at random
moments is in test_shares.py, gateways that are killed in test_gateways.py.
"""

import errno
import shutil
import signal
from contextlib import ExitStack

import pytest

from ogm_client import ClientError, MapClient
from ogm_client.session import NetworkConfig, open_session
from ogm_core.files.map_files import encode_npz
from ogm_core.wire.keys import MapKeys
from tests.gathering import parts, tiles_of, tiles_of_grid
from tests.share_processes import SCANS, SETTLED, ShareProcesses, knows_east
from tests.soak.services import Robots

WEST = [placed for placed in SCANS if placed.pose.x < -1.0]
"""Scans at home in share 0."""


@pytest.fixture(scope="module")
def processes(tmp_path_factory):
    with ExitStack() as opening:
        yield ShareProcesses(tmp_path_factory.mktemp("fleet"), opening)


@pytest.fixture
def fleet(processes, eventually):
    processes.start_over(eventually)
    return processes


@pytest.fixture
def whole(fleet, eventually):
    """`whole()` waits until the gateway has the map that one mapper would have."""
    return lambda: eventually(lambda: fleet.has_all(fleet.http[0]), SETTLED)


def token_is_gone(fleet, share, eventually):
    """Wait until no process of a share is alive."""
    with open_session(NetworkConfig(connect=(fleet.endpoint,))) as session:
        key = f"ogm/v1/default/alive/mapper/{share}/*"
        eventually(lambda: not list(session.liveliness().get(key, timeout=10.0)), SETTLED)


def test_what_no_cache_keeps_any_more_is_lost_and_all_the_rest_is_in_the_map(fleet, whole, eventually):
    """The first share, whose counts of what came and what did not are the gateway's."""
    before = fleet.shares[0].status()["scans"]
    with fleet.robot("forgetful", cache_samples=20) as robot:
        fleet.drive(robot, WEST[:40])
        whole()
        with fleet.shares[0].frozen():
            token_is_gone(fleet, 0, eventually)
            for placed in WEST[:80]:
                fleet.publish(robot, placed)
            fleet.drive(robot, WEST[40:60])
        eventually(lambda: west_of_share_0(fleet) == west_of_one(fleet), SETTLED)
        scans = fleet.shares[0].status()["scans"]
        integrated, lost = (scans[name] - before[name] for name in ("integrated", "lost"))
        assert (integrated, lost) == (60, 80)
        assert fleet.http[0].get("/status").json()["robots"]["forgetful"]["sources"]["laser"]["lost"] == 80


def west_of_share_0(fleet):
    """Tiles that share 0 tells; None while it is missing."""
    with open_session(NetworkConfig(connect=(fleet.endpoint,))) as session:
        found = parts(session, MapKeys("default"))
    return tiles_of(found[0][0]) if 0 in found else None


def west_of_one(fleet):
    """The same of the one map."""
    return {place: tile for place, tile in tiles_of_grid(fleet.one).items() if place[0] < 0}


def test_a_robot_that_is_frozen_while_a_share_starts_holds_up_no_other_and_loses_nothing(fleet, eventually):
    share = fleet.shares[0]
    with fleet.robot() as robot, Robots(fleet.endpoint, [0], 20.0) as others:
        fleet.drive(robot, WEST[:10])
        eventually(lambda: last_seq(share, "robot1") == 9 and last_seq(share, "robot0"), SETTLED)
        share.end(signal.SIGKILL)
        before = others.sent()[0]
        eventually(lambda: others.sent()[0] > before + 10, SETTLED)
        with others.frozen():
            fleet.drive(robot, WEST[10:20])
            share.start()
            share.wait_until_ready()
            eventually(lambda: last_seq(share, "robot1") == 19, SETTLED)
            assert last_seq(share, "robot0") < before + 10, "only its cache has them"
        sent = others.stop()[0]
        for each in fleet.shares:
            eventually(lambda each=each: last_seq(each, "robot0") == sent - 1, SETTLED)
            status = eventually(lambda each=each: settled(each), SETTLED)
            assert status["revision"] == 20 + sent, status
            assert [lost(each, robot) for robot in ("robot0", "robot1")] == [0, 0]


def lost(share, robot):
    """How many scans of a robot a share has counted lost."""
    return share.status()["robots"][robot]["sources"]["laser"]["lost"]


def settled(share):
    """A share's status once no scan waits in it."""
    status = share.status()
    return status if not status["scans"]["pending"] else None


def last_seq(share, robot):
    """Number of a robot's last scan that a share has taken, -1 if none."""
    known = share.status()["robots"].get(robot, {"sources": {}})["sources"].get("laser")
    return -1 if known is None or known["last_seq"] is None else known["last_seq"]


def test_while_the_router_is_away_clients_are_told_and_then_nothing_is_missing(fleet, whole, eventually):
    with fleet.robot() as robot, MapClient(fleet.endpoint, timeout=2.0) as client:
        fleet.drive(robot, SCANS[:50])
        whole()
        fleet.router.end(signal.SIGKILL)
        fleet.drive(robot, SCANS[50:100])
        with pytest.raises(ClientError):
            client.get_map()
        eventually(lambda: fleet.http[0].get("/readyz").status_code == 503)
        fleet.router.start()
        whole()
        known = fleet.one.snapshot().known_cells
        eventually(lambda: asked(client) == known, SETTLED)
        assert [lost(share, "robot1") for share in fleet.shares] == [0, 0]


def asked(client):
    """How many cells are known, or None if nobody answers yet."""
    try:
        return client.status().map_info.known_cells
    except ClientError:
        return None


def test_a_share_whose_store_is_lost_begins_empty_and_the_map_has_another_epoch(fleet, whole, eventually):
    http = fleet.http[0]
    with fleet.robot() as robot:
        fleet.drive(robot, SCANS)
        whole()
        before = http.get("/map.json").json()
    fleet.shares[1].end(signal.SIGKILL)
    shutil.rmtree(fleet.folders[1])
    fleet.shares[1].start()
    fleet.shares[1].wait_until_ready()
    eventually(lambda: not http.get("/status").json()["missing"], SETTLED)
    after = http.get("/map.json").json()
    assert after["epoch"] != before["epoch"]
    assert fleet.status(1)["revision"] == 0
    assert http.get("/status").json()["shares"][1]["restored"] is fleet.status(1)["restored"] is False
    assert knows_east(encode_npz(fleet.one.snapshot()))
    assert not knows_east(http.get("/map.npz").content)
    assert 0 < http.get("/status").json()["map_info"]["known_cells"] < fleet.one.snapshot().known_cells


def test_what_was_reset_does_not_come_back_with_a_share_that_is_killed_right_then(fleet, whole, eventually):
    http, share = fleet.http[0], fleet.shares[1]
    with fleet.robot() as robot:
        fleet.drive(robot, SCANS)
        whole()
        eventually(lambda: share.status()["store"]["revision"] == len(SCANS), SETTLED)
    http.post("/reset").raise_for_status()
    epoch = fleet.status(1)["epoch"]
    share.end(signal.SIGKILL)
    share.start()
    share.wait_until_ready()
    eventually(lambda: not http.get("/status").json()["missing"], SETTLED)
    assert (fleet.status(1)["epoch"], fleet.status(1)["revision"]) == (epoch, 0)
    assert http.get("/status").json()["shares"][1]["restored"] is fleet.status(1)["restored"] is True
    assert http.get("/status").json()["map_info"]["known_cells"] == 0


def test_a_share_whose_disk_is_full_goes_on_in_memory_and_the_gateway_says_so(
    fleet, whole, eventually, failing_disk, tmp_path
):
    control, share = tmp_path / "control", fleet.shares[1]
    share.end(signal.SIGKILL)
    share.environ = {"LD_PRELOAD": str(failing_disk), "FAILING_DISK": str(control)}
    share.start()
    share.environ = {}
    share.wait_until_ready()
    control.write_text(f"write {errno.ENOSPC} 0")
    with fleet.robot() as robot:
        fleet.drive(robot, SCANS[:50])
        told = eventually(lambda: (found := fleet.status(1))["state"] == "not storing" and found, SETTLED)
        assert told["detail"].endswith("map.sqlite: cannot be written: database or disk is full")
        assert fleet.status(0)["state"] == "up"
        assert fleet.http[0].get("/readyz").status_code == 200
        fleet.drive(robot, SCANS[50:])
        whole()
        control.write_text("")
        eventually(lambda: fleet.status(1)["state"] == "up", SETTLED)
        share.end(signal.SIGKILL)
        share.start()
        share.wait_until_ready()
        whole()


def test_a_second_process_of_a_share_ends_and_so_does_one_of_other_settings(fleet, tmp_path):
    others = [
        (fleet.share(0, tmp_path / "twin"), 1, "another mapper of share 0 of map 'default' is alive"),
        (fleet.share(0), 1, "share0"),
    ]
    for twin, code, said in others:
        with twin:
            assert twin.process.wait(SETTLED) == code
            assert said in twin.log_file.read_text().splitlines()[-1]
    fleet.shares[1].end(signal.SIGKILL)
    for other, said in ((fleet.share(1, reach=8), "map.reach"), (fleet.share(1, cuts_y=0), "shares.cuts_y")):
        with other:
            assert other.process.wait(SETTLED) == 2
            assert said in other.log_file.read_text().splitlines()[-1]
    fleet.shares[1].start()
    fleet.shares[1].wait_until_ready()
