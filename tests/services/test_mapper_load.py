"""The mapper under load: many readers while it writes, and more scans than it can take."""

import io
import json
import math
import threading

import httpx
import msgpack
import numpy as np
import pytest
from PIL import Image

from ogm_client.session import NetworkConfig, open_session
from ogm_core.cells.log_odds import LogOdds
from status_json import NO_POSES

ENOUGH = 4
"""How many maps a reader must have got of each epoch."""


def expected(revision):
    """Percents of the row that `stream` draws, after so many scans of one epoch, wherever it began."""
    if not revision:
        return []
    model, cell = LogOdds(), np.arange(revision + 3)
    hits = cell >= 3
    frees = sum(((cell - j >= 0) & (cell - j < revision)).astype(int) for j in range(3))
    steps = hits * round(model.d_occ / model.step) + frees * round(model.d_free / model.step)
    return np.floor(100 / (1 + np.exp(-steps * model.step)) + 0.5).astype(int).tolist()


class Reader:
    """What one reader has seen: revisions only grow, and an epoch that is gone never comes back."""

    def __init__(self):
        self.seen = []

    def note(self, epoch, revision):
        if self.seen and self.seen[-1][0] == epoch:
            assert revision >= self.seen[-1][1]
        else:
            assert epoch not in {seen for seen, _ in self.seen}
        self.seen.append((epoch, revision))

    def has_seen(self, epoch):
        """Whether it has got enough maps of an epoch, and one with a scan in it."""
        found = {revision for its, revision in list(self.seen) if its == epoch}
        return len(found) >= ENOUGH and max(found) > 0

    def note_map(self, meta, data):
        assert data == expected(meta["revision"])
        assert meta["width"] * meta["height"] == len(data)
        self.note(meta["epoch"], meta["revision"])


def stream(mapper, stop):
    """Put scans of a wall 2 m ahead, each from the middle of the next cell of 0.5 m."""
    sent = 0
    while not stop.wait(0.001):
        if sent % 100 == 0:  # no more than the queue takes, however slow the machine is
            while mapper.status()["scans"]["pending"] > 100 and not stop.wait(0.01):
                pass
        mapper.scan([2.0], pose=[0.25 + 0.5 * sent, 0.25, 0.0], run="stream", seq=sent, at=sent)
        sent += 1
    return sent


def read_json(mapper, stop, reader):
    etag = ""
    with httpx.Client(base_url=mapper.http.base_url) as http:
        while not stop.is_set():
            response = http.get("/map.json", headers={"If-None-Match": etag})
            if response.status_code == 304:
                assert response.headers["etag"] == etag
                continue
            body = response.raise_for_status().json()
            assert response.headers["etag"] == f'"{body["epoch"]}-{body["run"]}-{body["revision"]}"' != etag
            assert response.headers["ogm-revision"] == str(body["revision"])
            assert response.headers["ogm-stamp"] == json.dumps(body["stamp"])
            etag = response.headers["etag"]
            reader.note_map(body, body["data"])


def read_pictures(mapper, stop, reader):
    with httpx.Client(base_url=mapper.http.base_url) as http:
        while not stop.is_set():
            response = http.get("/map.png?palette=probability")
            revision = int(response.headers.get("ogm-revision", 0))
            if response.status_code == 404:  # just reset
                assert response.json()["type"] == "map-empty"
                continue
            pixels = np.asarray(Image.open(io.BytesIO(response.content)))
            np.testing.assert_allclose(pixels[0] / 2.55, expected(revision), atol=0.8)
            reader.note(response.headers["ogm-epoch"], revision)


def read_zenoh(mapper, stop, reader):
    with open_session(NetworkConfig(connect=(mapper.endpoint,))) as session:
        while not stop.is_set():
            (reply,) = session.get(f"{mapper.keys.root}/map", timeout=30.0)
            body = json.loads(reply.ok.payload.to_bytes())
            meta = msgpack.unpackb(reply.ok.attachment.to_bytes())
            assert {name: body[name] for name in meta} == meta
            reader.note_map(meta, body["data"])


def read_books(mapper, stop, reader):
    received = 0
    while not stop.is_set():
        status = mapper.status()  # checks that received = integrated + pending + dropped
        assert status["scans"]["received"] >= received
        received = status["scans"]["received"]
        reader.note(status["epoch"], status["revision"])
        mapper.http.get("/quality").raise_for_status()
        mapper.http.get("/metrics").raise_for_status()


def test_readers_see_whole_maps_while_scans_stream_and_the_map_is_reset(mapper, in_background, eventually):
    stop = threading.Event()
    reads = (read_json, read_pictures, read_zenoh, read_json, read_zenoh, read_books)
    readers = [Reader() for _ in reads]
    reading = [in_background(read, mapper, stop, reader) for read, reader in zip(reads, readers, strict=True)]
    sent = in_background(stream, mapper, stop)

    def all_have_seen(epoch):
        return any(each.done() for each in reading) or all(reader.has_seen(epoch) for reader in readers)

    try:
        for _ in range(4):
            epoch = mapper.status()["epoch"]
            eventually(lambda epoch=epoch: all_have_seen(epoch))
            mapper.answer("reset")
    finally:
        stop.set()
    for each in reading:
        each.result(30.0)
    status = mapper.settle(received=sent.result(30.0))
    assert status["scans"]["integrated"] == status["scans"]["received"] > 4 * ENOUGH


@pytest.fixture
def blocked(start_mapper, no_errors, in_background):
    """A mapper with room for 8 scans whose worker waits, and the event that lets it go on."""
    release = threading.Event()
    with start_mapper(map={"resolution": 0.5}, mapper={"queue": 8, "pose_wait": 0.2}) as mapper:
        waits = threading.Event()
        in_background(mapper.service.parts.worker.do, lambda: waits.set() or release.wait(30.0))
        assert waits.wait(30.0)
        try:
            yield mapper, release
        finally:
            release.set()


PERIOD = 100_000_000


def test_overload_takes_the_oldest_scans_of_the_fullest_source_and_no_pose(blocked, eventually):
    mapper, release = blocked
    for at in range(30):
        mapper.pose(x=float(at), at=at * PERIOD, robot="a")
        mapper.scan([1.0], at=at * PERIOD, robot="a", run="1", seq=at)
        if at < 20:
            mapper.pose(y=float(at), at=at * PERIOD, robot="b")
            mapper.scan([1.0], at=at * PERIOD, robot="b", run="1", seq=at)
    full = eventually(lambda: (status := mapper.status())["scans"]["received"] == 50 and status)
    assert full["scans"]["dropped"]["overload"] == 42
    assert (full["scans"]["pending"], full["scans"]["integrated"]) == (8, 0)
    assert full["poses"]["received"] == 50
    pending = {name: robot["sources"]["s"]["pending"] for name, robot in full["robots"].items()}
    assert sum(pending.values()) == 8
    assert min(pending.values()) >= 3
    # It answers as ever, and nothing that waits is in the books as taken.
    assert mapper.http.get("/map.json").json()["revision"] == 0
    assert json.loads(mapper.answer("status").payload.to_bytes())["scans"] == full["scans"]
    assert {robot["sources"]["s"]["last_seq"] for robot in full["robots"].values()} == {None}
    release.set()
    status = mapper.settle(received=50)
    assert status["scans"]["integrated"] == 8  # every one of them had its pose
    assert status["scans"]["dropped"] == full["scans"]["dropped"]
    assert status["poses"] == NO_POSES | {"received": 50, "malformed": 0}
    robots = status["robots"]
    assert robots["a"]["pose"] == [29.0, 0.0, 0.0]
    assert robots["b"]["pose"] == [0.0, 19.0, 0.0]
    assert [robots[name]["sources"]["s"]["last_seq"] for name in "ab"] == [29, 19]
    assert status["map_info"]["width"] * 0.5 > 29


def test_a_quiet_source_loses_nothing_to_a_busy_one(blocked, eventually):
    mapper, release = blocked
    mapper.scan([1.0], pose=[0.0, 0.0, math.pi / 2], robot="quiet")
    for seq in range(100):
        mapper.scan([1.0], pose=[0.0, 0.0, 0.0], robot="busy", run="1", seq=seq)
    eventually(lambda: mapper.status()["scans"]["dropped"]["overload"] == 93)
    release.set()
    robots = mapper.settle(received=101)["robots"]
    assert robots["quiet"]["sources"]["s"]["integrated"] == 1
    assert robots["busy"]["sources"]["s"]["integrated"] == 7
    assert robots["busy"]["sources"]["s"]["last_seq"] == 99


def test_a_scan_whose_pose_is_in_the_queue_is_not_given_up_however_late_the_worker_is(blocked, eventually):
    mapper, release = blocked
    mapper.pose(at=0)
    mapper.scan([1.0], at=50)
    mapper.pose(at=100)
    eventually(lambda: mapper.status()["poses"]["received"] == 2)
    release.wait(0.4)  # twice as long as a scan waits for a robot that is not heard
    release.set()
    assert mapper.settle(received=1)["scans"]["integrated"] == 1
