"""Four fake shares on a router, gateways over them, and the one mapper that they stand for."""

import io

import httpx
import numpy as np

from ogm_client.session import NetworkConfig, open_session
from ogm_core.grid import OccupancyGrid
from ogm_services.mapper.gateway.gateway_service import GatewayService
from ogm_services.settings.settings import Settings
from shares_desk import SETTINGS, FakeShare, ServedShare, scan_at

CUTS = {"cuts_x": [0.0], "cuts_y": [0.0]}


class Fleet:
    """Four fake shares on a router, the one mapper that they stand for, and gateways."""

    def __init__(self, endpoint, shares=range(4), **models):
        """`models`: settings of the map as a gateway is given them, other than by default."""
        self.endpoint = endpoint
        self._map = {"reach": SETTINGS.reach, **models}
        settings = Settings.model_validate({"map": self._map}).grid_settings()
        self.one = OccupancyGrid(settings, "one", "run")
        self.rng = np.random.default_rng(5)
        self.router = open_session(NetworkConfig(listen=(endpoint,)))
        self._sessions = [self.router]
        self.shares = [ServedShare(self.join(), FakeShare(k, settings)) for k in shares]
        self._scans = 0
        self._gateways = []

    def join(self):
        self._sessions.append(open_session(NetworkConfig(connect=(self.endpoint,))))
        return self._sessions[-1]

    def integrate(self, count=1):
        for _ in range(count):
            placed = scan_at(self._scans, self.rng)
            self._scans += 1
            self.one.integrate(*placed)
            for served in self.shares:
                served.share.integrate(*placed)

    def gateway(self, *, timeout=5.0, **shares):
        """A gateway of its own, and a client of its HTTP."""
        settings = {
            "map": self._map,
            "network": {"map_name": "m", "connect": [self.endpoint]},
            "http": {"port": 0},
            "shares": {**CUTS, "gather_timeout": timeout, **shares},
        }
        service = GatewayService(Settings.model_validate(settings)).__enter__()
        http = httpx.Client(base_url=service.addresses[1].split()[-1], timeout=30.0)
        self._gateways.append((service, http))
        return service, http

    def close(self):
        for service, http in self._gateways:
            http.close()
            service.__exit__(None, None, None)
        for session in reversed(self._sessions):
            session.close()


def npz(content):
    with np.load(io.BytesIO(content)) as arrays:
        return dict(arrays)
