"""An honest robot beside one that floods the mapper, over Zenoh: its scans get in."""

import hashlib
import threading
import time
from contextlib import contextmanager

import msgpack
import pytest
import zenoh

from ogm_client.session import NetworkConfig, open_session

RATE = 20.0
LOADED = 60.0
"""How long a busy machine may take to work off what waits, s."""


@contextmanager
def flooding(mapper, put):
    """Call `put(session, k)` as fast as the mapper's link takes it, from a network session of its own."""
    stop = threading.Event()
    with open_session(NetworkConfig(connect=(mapper.endpoint,))) as session:

        def flood():
            k = 0
            while not stop.is_set():
                put(session, k)
                k += 1

        thread = threading.Thread(target=flood)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


def honest_scans(mapper, seconds):
    """Scans of robot `honest` at 20 Hz; how many were sent."""
    count, begun = round(RATE * seconds), time.monotonic()
    for k in range(count):
        time.sleep(max(0.0, begun + k / RATE - time.monotonic()))
        mapper.scan([1.0], pose=[0.0, 0.0, 0.0], robot="honest", run="h", seq=k, at=k)
    return count


def honest_source(mapper):
    robot = mapper.status()["robots"].get("honest")
    return robot["sources"]["s"] if robot else {"received": 0, "pending": 0}


def put_on(session, mapper, key, payload):
    session.put(f"{mapper.keys.root}/{key}", payload, congestion_control=zenoh.CongestionControl.BLOCK)


def compute(seconds):
    """Compute for so long, as a kernel does: without Python's lock."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        hashlib.pbkdf2_hmac("sha256", b"", b"", 500)


@pytest.fixture
def slow(start_mapper, no_errors):
    """A mapper with room for 500 scans that takes 2 ms for each, or what `took` says for its run, s."""
    with start_mapper(map={"resolution": 0.5}, mapper={"queue": 500}) as mapper:
        mapper.took = {}
        integrate = mapper.service.live_map.integrate

        def slowly(scan, *placed):
            compute(mapper.took.get(scan.run, 0.002))
            return integrate(scan, *placed)

        mapper.service.live_map.integrate = slowly
        yield mapper


def check_honest(mapper, sent, eventually):
    eventually(
        lambda: (its := honest_source(mapper))["received"] == sent and not its["pending"], timeout=LOADED
    )
    assert honest_source(mapper)["integrated"] >= 0.95 * sent


def flood_of(kind, mapper, fields):
    scan = msgpack.packb(fields.scan([1.0], pose=[0.0, 0.0, 0.0], run=""))
    pose = msgpack.packb(fields.pose())
    tokens = []

    def put(session, k):
        if kind == "300 sensors":
            put_on(session, mapper, f"robots/flood/scan/s{k % 300}", scan)
        elif kind == "16 sensors":
            put_on(session, mapper, f"robots/flood/scan/s{k % 16}", scan)
        elif kind == "noise":
            put_on(session, mapper, "robots/flood/scan/s", b"\xc1" * 100_000)
        elif kind == "poses":
            put_on(session, mapper, "robots/flood/pose", pose)
        else:
            tokens.append(session.liveliness().declare_token(mapper.keys.alive("robot", "flood", f"r{k}")))
            tokens[-1].undeclare()

    return put


@pytest.mark.parametrize("kind", ["300 sensors", "16 sensors", "noise", "poses", "tokens"])
def test_an_honest_robot_loses_nothing_to_a_flood(slow, fields, eventually, kind):
    slow.took[""] = 0.01  # a flood on a busy machine, of which 16 sensors in 300 are taken, is more than this
    with flooding(slow, flood_of(kind, slow, fields)):
        sent = honest_scans(slow, 3.0)
        if kind.endswith("sensors"):
            eventually(lambda: slow.status()["scans"]["dropped"]["overload"] > 0, timeout=LOADED)
    check_honest(slow, sent, eventually)


def test_an_honest_robot_loses_nothing_to_one_whose_scans_are_a_second_of_work(slow, fields, eventually):
    slow.took["heavy"] = 1.0
    slow.took["h"] = 0.001

    def put(session, k):
        payload = msgpack.packb(fields.scan([1.0], pose=[0.0, 0.0, 0.0], run="heavy", seq=k))
        put_on(session, slow, "robots/heavy/scan/s", payload)
        time.sleep(1.0)

    with flooding(slow, put):
        sent = honest_scans(slow, 6.0)
    check_honest(slow, sent, eventually)
    assert slow.status()["robots"]["heavy"]["sources"]["s"]["integrated"] >= 2
