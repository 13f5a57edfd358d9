"""Followers of a map to whom somebody else tells lies come back to the mapper's map, in bounded memory."""

import time
import tracemalloc
from dataclasses import replace

import msgpack
import numpy as np
import pytest

from ogm_client import MapClient
from ogm_client import follower as follower_module
from ogm_core.tiles.store import tile_bytes
from ogm_core.units import MEBIBYTE
from ogm_core.wire import map_update
from ogm_core.wire.map_update import decode_updates, encode_update
from ogm_services.mapper.serving import update_publisher

PATIENCE = 30.0
MAX_BYTES = MEBIBYTE
"""What the follower's copy may take: 124 tiles."""
HUGE = 2**63 - 1


@pytest.fixture(scope="module")
def hall(start_mapper):
    with start_mapper(map={"resolution": 0.5}) as mapper:
        mapper.draw_cross()
        mapper.settle(received=3)
        yield mapper


@pytest.fixture
def truth(hall):
    (update,) = decode_updates(hall.http.get("/map.tiles").content)
    return update


def of_tiles(update, count):
    """The same with so many tiles, far away."""
    tiles = np.stack((np.arange(count), np.full(count, 1000)), axis=1)
    return replace(update, tiles=tiles, cells={"log_odds": np.ones((count, 4096), np.int16)})


def other(update, **fields):
    return encode_update(replace(update, **fields))


LIES = {
    "another life": lambda true: other(true, epoch="theirs", run="theirs"),
    "a life with another lattice": lambda true: other(
        true, run="x", lattice=replace(true.lattice, resolution=1.0)
    ),
    "this life with another lattice": lambda true: other(
        true, revision=true.revision + 1, lattice=replace(true.lattice, resolution=1.0)
    ),
    "a revision that no mapper comes to": lambda true: other(true, revision=HUGE),
    "a name that asks for something else": lambda true: other(true, epoch="e;format=png"),
    "more than the copy may take": lambda true: other(of_tiles(true, 200), revision=true.revision + 1),
    "a life of more than that": lambda true: other(of_tiles(true, 200), epoch="theirs"),
    "one part of many": lambda true: other(true, revision=true.revision + 1, parts=2**20),
    "nothing": lambda true: b"",
    "noise": lambda true: b"\xff" * 999,
}


@pytest.mark.parametrize("lie", LIES)
def test_after_a_lie_the_copy_is_the_mappers_map_again(hall, truth, lie, monkeypatch):
    monkeypatch.setattr(follower_module, "SILENCE", 0.5)
    monkeypatch.setattr(update_publisher, "HEARTBEAT", 0.1)  # the mapper is never silent
    client = MapClient(hall.endpoint, map_name="hall", timeout=PATIENCE, max_bytes=MAX_BYTES)
    with client, client.follow(interval=0.05) as follower:
        heard, take = [], follower._take

        def noted(payload):
            try:
                take(payload)
            finally:
                heard.append(payload)

        monkeypatch.setattr(follower, "_take", noted)
        payload = LIES[lie](truth)
        hall.session.put(hall.keys.updates, payload)
        seen, deadline = None, time.monotonic() + PATIENCE
        while payload not in heard or follower.version != (truth.epoch, truth.run, truth.revision):
            change = follower.wait(after=follower.version, timeout=0.05)
            seen = change or seen
            assert follower._thread.is_alive(), follower._ended
            assert time.monotonic() < deadline
        assert seen is None or seen.whole
        grid = follower.grid()
        assert np.array_equal(grid.log_odds, client.get_map().log_odds, equal_nan=True)
        assert len(follower._copy.tiles) == len(truth.tiles)


def test_a_put_of_many_messages_is_not_unpacked(hall, truth):
    """8 MiB that are sent may be hundreds of messages of 16 MiB each."""
    one = encode_update(of_tiles(truth, 2048))
    client = MapClient(hall.endpoint, map_name="hall", timeout=PATIENCE, max_bytes=MAX_BYTES)
    with client, client.follow(interval=1000.0) as follower:
        tracemalloc.start()
        try:
            follower._take(one * 16)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak < 5 * map_update.MAX_CELL_BYTES
        assert follower.version == (truth.epoch, truth.run, truth.revision)


def test_tiles_that_are_too_many_are_refused_before_they_are_read(truth):
    count = 2**18
    told = msgpack.unpackb(encode_update(truth))
    payload = msgpack.packb(told | {"tiles": bytes(16 * count)})
    tracemalloc.start()
    try:
        with pytest.raises(
            map_update.BadMessage, match=f"{count} take {count * tile_bytes(truth.planes)} bytes"
        ):
            next(decode_updates(payload))
        assert tracemalloc.get_traced_memory()[1] < 4 * len(payload)
    finally:
        tracemalloc.stop()
