"""Gateways over shares that are killed, frozen and started again: what they answer meanwhile, and afterwards.

All of them, and the router between them, are processes, which takes its time to start; the map is held
against one grid's.
"""

import signal
from contextlib import ExitStack

import httpx
import numpy as np
import pytest

from ogm_client import MapClient
from tests.share_processes import SCANS, SETTLED, ShareProcesses


@pytest.fixture
def fleet(tmp_path):
    with ExitStack() as opening:
        yield ShareProcesses(tmp_path, opening, gateways=2)


def test_shares_frozen_killed_and_started_again_and_a_gateway_that_is_killed(fleet, eventually):
    first, second = fleet.http
    robot = fleet.robot()
    fleet.drive(robot, SCANS[:100])
    eventually(lambda: fleet.has_all(first) and fleet.has_all(second), SETTLED)
    answers = [http.get("/map.png") for http in fleet.http]
    assert answers[0].headers["ETag"] == answers[1].headers["ETag"]
    assert answers[0].content == answers[1].content
    status = eventually(lambda: (told := first.get("/status").json())["complete"] and told, SETTLED)
    assert status["scans"]["integrated"] == status["scans"]["received"] == 100  # each is its home's to count

    with fleet.shares[0].frozen():
        answer = first.get("/map.npz")
        assert answer.headers["OGM-Missing"].startswith("0;")
        assert first.get("/map.pgm").status_code == 503
        assert second.get("/readyz").status_code == 200
        eventually(
            lambda: [part["share"] for part in second.get("/status").json()["missing"]] == [0], SETTLED
        )
    eventually(lambda: fleet.has_all(first), SETTLED)

    fleet.shares[1].end(signal.SIGKILL)
    fleet.drive(robot, SCANS[100:])
    answer = first.get("/map.json")
    assert [part["share"] for part in answer.json()["missing"]] == [1]
    with MapClient(fleet.endpoint, timeout=SETTLED) as client:
        part = client.get_map(partial=True)
        assert [each.share for each in part.missing] == [1]
        x = part.origin[0] + np.flatnonzero(part.known.any(axis=0)) * part.resolution
        assert x.max() < 0.0  # nothing of what lies beyond the cut
        fleet.shares[1].start()
        fleet.shares[1].wait_until_ready()
        eventually(lambda: fleet.has_all(first) and fleet.has_all(second), SETTLED)
        # What the share that was killed has counted goes on with its map: the sums are those of all scans.
        status = eventually(lambda: (told := first.get("/status").json())["complete"] and told, SETTLED)
        assert status["scans"]["integrated"] == status["scans"]["received"] == len(SCANS)
        assert (status["scans"]["lost"], status["scans"]["pending"]) == (0, 0)
        (source,) = status["robots"]["robot1"]["sources"].values()
        assert (source["received"], source["integrated"]) == (len(SCANS), len(SCANS))

        fleet.gateways[0].end(signal.SIGKILL)
        assert client.get_map().missing == ()  # by the other gateway
        client.reset()
        assert client.get_map().width == 0


def readyz(share):
    """Whether a share is ready, "ok", or why not."""
    return httpx.get(f"{share.url}readyz", timeout=SETTLED).text


def known_cells(share):
    return share.status()["map_info"]["known_cells"]


def test_a_share_that_was_frozen_meets_its_twin_and_does_no_harm_to_cells(fleet, eventually):
    first, second = fleet.http
    robot, frozen = fleet.robot(), fleet.shares[0]
    fleet.drive(robot, SCANS[:60])
    eventually(lambda: fleet.has_all(first), SETTLED)
    with fleet.share(0, fleet.folders[0].with_name("twin")) as twin:
        with frozen.frozen():
            fleet.drive(robot, SCANS[60:100])
            twin.wait_until_ready()
            assert readyz(twin) == "ok"
            # What the twin has asked the robot for is what the gateway tells.
            eventually(lambda: fleet.has_all(first), SETTLED)
        for share in (frozen, twin):
            eventually(lambda share=share: "another mapper of the map serves, too" in readyz(share), SETTLED)
        fleet.drive(robot, SCANS[100:])
        eventually(lambda: fleet.has_all(first) and fleet.has_all(second), SETTLED)
        eventually(lambda: known_cells(frozen) == known_cells(twin), SETTLED)
        frozen.end(signal.SIGTERM)
        eventually(lambda: readyz(twin) == "ok", SETTLED)
        assert fleet.has_all(first)
        eventually(lambda: first.get("/status").json()["complete"], SETTLED)
