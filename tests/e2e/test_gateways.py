"""Gateways over shares that are killed, frozen and started again: what they answer meanwhile, and afterwards.

All of them, and the router between them, are processes, which takes its time to start; the map is held
against one grid's.
"""

import signal
from contextlib import ExitStack, contextmanager

import httpx
import numpy as np
import pytest

from benchmarks.running import line_after
from benchmarks.workloads import lab_exercise
from ogm_client import MapClient, RobotPublisher
from ogm_client.session import resolve_listen
from ogm_core.files.map_files import encode_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from tests.soak.services import FLAGS, Mapper, Service

SETTLED = 60.0
CUTS = {"cuts_x": 0, "reach": 10, "resolution": 0.1}
"""Two shares, with a wall and a half of the lab in each."""
SCANS = lab_exercise().scans


class Fleet:
    """Two shares that store their parts, two gateways, and a robot."""

    def __init__(self, folder, opening):
        self.endpoint = resolve_listen("tcp/127.0.0.1:0")
        self._folder = folder
        opening.enter_context(Service("tests.soak.router", self.endpoint))
        self.shares = [opening.enter_context(self.share(k, f"share{k}")) for k in (0, 1)]
        flags = [f"--{name.replace('_', '-')}={value}" for name, value in CUTS.items()]
        self.gateways = [
            opening.enter_context(
                Service("ogm_services", "gateway", "--connect", self.endpoint, "--map=lab", *FLAGS, *flags)
            )
            for _ in range(2)
        ]
        self.http = [
            opening.enter_context(
                httpx.Client(base_url=line_after(gateway.process, "live map "), timeout=SETTLED)
            )
            for gateway in self.gateways
        ]
        for share in self.shares:
            share.wait_until_ready()
        self.robot = opening.enter_context(
            RobotPublisher("robot1", address=self.endpoint, map_name="lab", reliable=True)
        )
        self.robot.wait_for_mapper(SETTLED)
        self.one = OccupancyGrid(GridSettings(resolution=0.1, reach=10.0))

    def share(self, k, store):
        """The mapper of a share, which stores its part there."""
        return Mapper(self.endpoint, self._folder / store, "connect", CUTS | {"share": k, "map": "lab"})

    def drive(self, scans):
        for placed in scans:
            scan = placed.scan
            self.robot.publish_scan(
                scan.ranges,
                angle_min=scan.angle_min,
                angle_increment=scan.angle_increment,
                range_min=scan.range_min,
                range_max=scan.range_max,
                stamp=scan.stamp,
                mount=scan.mount,
                pose=scan.pose,
            )
            self.one.integrate(*placed)

    def has_all(self, http):
        """Whether a gateway's map is that of one mapper, byte for byte."""
        return http.get("/map.npz").content == encode_npz(self.one.snapshot())


@contextmanager
def fleet_in(folder):
    with ExitStack() as opening:
        yield Fleet(folder, opening)


@pytest.fixture
def fleet(tmp_path):
    with fleet_in(tmp_path) as fleet:
        yield fleet


def test_shares_frozen_killed_and_started_again_and_a_gateway_that_is_killed(fleet, eventually):
    first, second = fleet.http
    fleet.drive(SCANS[:100])
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
    fleet.drive(SCANS[100:])
    answer = first.get("/map.json")
    assert [part["share"] for part in answer.json()["missing"]] == [1]
    with MapClient(fleet.endpoint, map_name="lab", timeout=SETTLED) as client:
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

        fleet.gateways[0].end(signal.SIGTERM)
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
    frozen = fleet.shares[0]
    fleet.drive(SCANS[:60])
    eventually(lambda: fleet.has_all(first), SETTLED)
    with fleet.share(0, "twin") as twin:
        with frozen.frozen():
            fleet.drive(SCANS[60:100])
            twin.wait_until_ready()
            assert readyz(twin) == "ok"
            # What the twin has asked the robot for is what the gateway tells.
            eventually(lambda: fleet.has_all(first), SETTLED)
        for share in (frozen, twin):
            eventually(lambda share=share: "another mapper of the map serves, too" in readyz(share), SETTLED)
        fleet.drive(SCANS[100:])
        eventually(lambda: fleet.has_all(first) and fleet.has_all(second), SETTLED)
        eventually(lambda: known_cells(frozen) == known_cells(twin), SETTLED)
        frozen.end(signal.SIGTERM)
        eventually(lambda: readyz(twin) == "ok", SETTLED)
        assert fleet.has_all(first)
        eventually(lambda: first.get("/status").json()["complete"], SETTLED)
