"""Shares of the lab's map that store their parts, gateways over them, and a router: all of them processes."""

from contextlib import ExitStack
from dataclasses import replace

import httpx
import numpy as np

from benchmarks.running import line_after
from benchmarks.workloads import lab_exercise
from ogm_client import RobotPublisher
from ogm_client.session import resolve_listen
from ogm_core.files.map_files import encode_npz, read_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from tests.soak.services import FLAGS, Mapper, Service

SETTLED = 60.0
CUTS = {"cuts_x": 0, "reach": 10, "resolution": 0.1}
"""Two shares, with a wall and a half of the lab in each."""
SCANS = lab_exercise().scans


class ShareProcesses:
    """Two shares, their gateways, and the one map that all scans make."""

    def __init__(self, folder, opening: ExitStack, gateways=1):
        self._opening = opening
        self._stamp = 10**18
        self.endpoint = resolve_listen("tcp/127.0.0.1:0")
        self.router = opening.enter_context(Service("tests.soak.router", self.endpoint))
        self.folders = [folder / f"share{k}" for k in (0, 1)]
        self.shares = [self.share(k) for k in (0, 1)]
        for share in self.shares:
            opening.enter_context(share)
        self.gateways, self.http = [], []
        for _ in range(gateways):
            self._start_gateway()
        for share in self.shares:
            share.wait_until_ready()
        self.one = OccupancyGrid(GridSettings(resolution=0.1, reach=10.0))

    def share(self, k, folder=None, **flags):
        """The mapper of a share, not yet started."""
        return Mapper(self.endpoint, folder or self.folders[k], "connect", CUTS | {"share": k} | flags)

    def robot(self, name="robot1", **options):
        """A robot that the shares have met."""
        publisher = RobotPublisher(name, address=self.endpoint, reliable=True, **options)
        self._opening.enter_context(publisher).wait_for_mapper(SETTLED)
        return publisher

    def drive(self, robot, scans):
        """Publish scans, and integrate them into the one map."""
        for placed in scans:
            self.one.integrate(*self.publish(robot, placed))

    def publish(self, robot, placed):
        """Publish a scan that carries its pose, with a stamp later than all before; what was published."""
        self._stamp += 10**8
        scan = replace(placed.scan, stamp=self._stamp)
        robot.publish_scan(
            scan.ranges,
            angle_min=scan.angle_min,
            angle_increment=scan.angle_increment,
            range_min=scan.range_min,
            range_max=scan.range_max,
            stamp=scan.stamp,
            mount=scan.mount,
            pose=scan.pose,
        )
        return placed._replace(scan=scan)

    def has_all(self, http):
        """Whether a gateway's map is that of one mapper, byte for byte."""
        return http.get("/map.npz").content == encode_npz(self.one.snapshot())

    def start_over(self, eventually):
        """Have every share empty its part, and begin the one map anew."""
        eventually(lambda: self.http[0].post("/reset").status_code == 200, SETTLED)
        self.one = OccupancyGrid(GridSettings(resolution=0.1, reach=10.0))

    def status(self, k):
        """What the gateway's status says of a share."""
        return self.http[0].get("/status").json()["shares"][k]

    def _start_gateway(self):
        flags = [f"--{name.replace('_', '-')}={value}" for name, value in CUTS.items()]
        gateway = Service("ogm_services", "gateway", "--connect", self.endpoint, *FLAGS, *flags)
        self.gateways.append(self._opening.enter_context(gateway))
        url = line_after(gateway.process, "live map ")
        self.http.append(self._opening.enter_context(httpx.Client(base_url=url, timeout=SETTLED)))


def knows_east(content):
    """Whether a map.npz knows anything beyond the cut."""
    npz = read_npz(content)
    columns = np.flatnonzero(~np.isnan(npz.log_odds).all(axis=0))
    return bool((npz.offset[0] + columns >= 0).any())
