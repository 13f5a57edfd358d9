"""A mapper that runs as a service in this process, and a robot and a user on its network."""

import json
import logging
import math
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

import httpx
import msgpack
import numpy as np
import pytest
import zenoh

from described_http import DescribedClient
from fleet_desk import Fleet
from gateway_desk import gateways, sessions
from ogm_client.session import NetworkConfig, open_session
from ogm_core.wire.keys import MapKeys
from ogm_services.mapper.service import MapperService
from ogm_services.settings.settings import Settings

MAP_NAME = "hall"
T0 = 1_700_000_000_000_000_000
SETTLED = 30.0
"""How long an answer and what is to be integrated may take on a busy machine, s."""


@dataclass
class RunningMapper:
    """A mapper with an HTTP client and a Zenoh session of its own; stamps are ns after T0."""

    service: MapperService
    http: httpx.Client
    session: zenoh.Session
    endpoint: str
    keys: MapKeys

    def put(self, key, payload):
        """Put bytes on a key below the map's root, waiting rather than losing any."""
        block = zenoh.CongestionControl.BLOCK
        self.session.put(f"{self.keys.root}/{key}", payload, congestion_control=block)

    def pose(self, x=0.0, y=0.0, theta=0.0, *, robot="r", at=0, **fields):
        """Put a pose message."""
        self.put(f"robots/{robot}/pose", msgpack.packb(pose_fields(x=x, y=y, theta=theta, at=at, **fields)))

    def scan(self, ranges, *, robot="r", sensor="s", **fields):
        """Put a scan message; fields as `scan_fields` takes them."""
        self.put(f"robots/{robot}/scan/{sensor}", msgpack.packb(scan_fields(ranges, **fields)))

    def status(self):
        """The status, after a look whether its books balance."""
        status = json.loads(self.http.get("/status").raise_for_status().content)
        scans = status["scans"]
        assert scans["received"] == scans["integrated"] + scans["pending"] + sum(scans["dropped"].values())
        assert scans["pending"] >= 0
        return status

    def settle(self, received):
        """Wait until so many scans have arrived and none is pending; return the status."""
        deadline = time.monotonic() + SETTLED
        while True:
            status = self.status()
            if status["scans"]["received"] == received and not status["scans"]["pending"]:
                return status
            assert time.monotonic() < deadline, status
            time.sleep(0.002)

    def ask(self, key, parameters="", **options):
        """Every reply to a Zenoh get below the map's root."""
        selector = f"{self.keys.root}/{key}{'?' if parameters else ''}{parameters}"
        return list(self.session.get(selector, timeout=SETTLED, **options))

    def answer(self, key, parameters=""):
        """The one good reply to a Zenoh get: a sample."""
        (reply,) = self.ask(key, parameters)
        assert reply.ok is not None, reply.err.payload.to_string()
        return reply.ok

    def problem(self, key, parameters=""):
        """The one error reply to a Zenoh get, decoded."""
        (reply,) = self.ask(key, parameters)
        assert reply.ok is None
        assert str(reply.err.encoding) == "application/problem+json"
        return json.loads(reply.err.payload.to_bytes())

    def draw_cross(self, revision=0):
        """Three scans from the middle of cell (0, 0) at resolution 0.5 m; return the status.

        East a wall at ix 4, north one at iy 3, west one at ix -2, all seen twice; south nothing up to iy -5,
        seen once.
        """
        place = {"pose": [0.25, 0.25, 0.0], "angle_increment": math.pi / 2, "range_max": 2.5}
        for ranges in ([2.0, 1.5, 1.0, math.nan], [2.0, 1.5, 1.0, math.nan], [math.nan] * 3 + [math.inf]):
            revision += 1
            self.scan(ranges, at=revision, **place)
        return self.settle(received=revision)


def pose_fields(*, x=0.0, y=0.0, theta=0.0, at=0, **fields):
    """Fields of a pose message."""
    return {"stamp": T0 + at, "seq": 0, "x": x, "y": y, "theta": theta, **fields}


def scan_fields(ranges=(1.0,), *, at=0, **fields):
    """Fields of a scan message."""
    message = {"stamp": T0 + at, "seq": 0, "angle_min": 0.0, "angle_increment": 0.1}
    message |= {"range_min": 0.0, "range_max": 8.0, "ranges": np.asarray(ranges, "<f4").tobytes()}
    return message | fields


@contextmanager
def running_mapper(**sections):
    """Run a mapper of the map MAP_NAME on free ports of loopback; sections as in the settings' file."""
    network = {"map_name": MAP_NAME, "listen": ["tcp/127.0.0.1:0"], **sections.pop("network", {})}
    http_settings = {"port": 0, **sections.pop("http", {})}
    settings = Settings.model_validate({"network": network, "http": http_settings, **sections})
    with MapperService(settings) as service:
        endpoint, url = (line.split()[-1] for line in service.addresses)
        config = NetworkConfig(connect=(endpoint,))
        under = http_settings.get("root_path", "")
        with (
            open_session(config) as session,
            DescribedClient(base_url=url, timeout=SETTLED, under=under) as http,
        ):
            mapper = RunningMapper(service, http, session, endpoint, MapKeys(network["map_name"]))
            _wait_for_subscriber(mapper)
            yield mapper


def _wait_for_subscriber(mapper):
    """What is put before the subscriber is known to the session may be lost."""
    publisher = mapper.session.declare_publisher(mapper.keys.pose("r"))
    deadline = time.monotonic() + SETTLED
    while not publisher.matching_status.matching:
        assert time.monotonic() < deadline
        time.sleep(0.002)
    publisher.undeclare()


@pytest.fixture(scope="session")
def start_mapper():
    """`with start_mapper(map={...}, ...) as mapper`: a RunningMapper with such settings."""
    return running_mapper


@pytest.fixture(scope="session")
def fields():
    """The functions that make the fields of a message: `fields.pose(...)`, `fields.scan(...)`."""

    class Fields:
        pose = staticmethod(pose_fields)
        scan = staticmethod(scan_fields)

    return Fields


@pytest.fixture
def in_background():
    """`in_background(function, *args)` runs it in a thread and returns a Future."""
    with ThreadPoolExecutor(16) as pool:
        yield pool.submit


@pytest.fixture
def no_errors(caplog):
    """Fails if anything was logged as an error: an error is a bug, whatever came in."""
    yield caplog
    records = [record for phase in ("setup", "call", "teardown") for record in caplog.get_records(phase)]
    assert [record.getMessage() for record in records if record.levelno >= logging.ERROR] == []


@pytest.fixture
def mapper(start_mapper, no_errors):
    """A fresh mapper with cells of 0.5 m that waits 0.2 s for poses."""
    with start_mapper(map={"resolution": 0.5}, mapper={"pose_wait": 0.2}) as mapper:
        yield mapper


@pytest.fixture
def sound(mapper):
    """A mapper with the cross; afterwards it must still integrate a scan that is good."""
    mapper.draw_cross()
    yield mapper
    before = mapper.status()
    mapper.scan([1.0], pose=[0.0, 0.0, 0.0], robot="good", run="sound", seq=0)
    mapper.pose(robot="better", at=1000)
    mapper.scan([1.0], robot="better", at=1000)
    after = mapper.settle(received=before["scans"]["received"] + 2)
    assert after["scans"]["integrated"] == before["scans"]["integrated"] + 2
    assert after["revision"] == before["revision"] + 2


@pytest.fixture(scope="module")
def cross(start_mapper):
    """A mapper whose map is `draw_cross`'s; tests only read it."""
    with start_mapper(map={"resolution": 0.5}) as mapper:
        mapper.draw_cross()
        yield mapper


@pytest.fixture
def network(endpoint, listener):
    """`network()` opens a session on the network of `listener`."""
    with sessions(endpoint) as join:
        yield join


@pytest.fixture
def gateway(listener, network, eventually, monkeypatch):
    """`gateway(...)` makes a gateway of ROS 2's robots; `until(condition)` lets it work until then."""
    monkeypatch.setattr("ogm_services.ros2.gateway.LOOK_EVERY", 0.02)
    with gateways(listener, network, eventually) as gateway:
        yield gateway


@pytest.fixture
def fleet(endpoint):
    """Four fake shares on a router, which gateways can be put over (see `fleet_desk`)."""
    fleet = Fleet(endpoint)
    yield fleet
    fleet.close()
