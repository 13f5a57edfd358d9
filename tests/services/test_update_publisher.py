"""The updates that a mapper puts for its followers: what they tell, and that nothing is done without them."""

import math
import threading
import time

import numpy as np
import pytest

from ogm_client import MapClient
from ogm_client.map_copy import MapCopy, Taken
from ogm_core.wire.map_update import decode_updates
from ogm_services.mapper.serving import update_publisher
from ogm_services.mapper.serving.update_publisher import UpdatePublisher

PATIENCE = 30.0


class Listener:
    """A subscriber of a mapper's updates: what it has heard."""

    def __init__(self, mapper):
        self.heard = []
        self._more = threading.Condition()
        self._mapper = mapper
        self._subscriber = mapper.session.declare_subscriber(mapper.keys.updates, self._take)

    def _take(self, sample):
        with self._more:
            self.heard += decode_updates(sample.payload.to_bytes())
            self._more.notify_all()

    def until(self, holds):
        """Wait until that holds of one of the updates; it."""
        deadline = time.monotonic() + PATIENCE
        with self._more:
            while not any(map(holds, self.heard)):
                assert self._more.wait(deadline - time.monotonic()), self.heard
            return next(filter(holds, self.heard))

    def close(self):
        self._subscriber.undeclare()


@pytest.fixture
def mapper(start_mapper):
    with start_mapper(map={"resolution": 0.5}) as mapper:
        yield mapper


@pytest.fixture
def listener(mapper):
    listener = Listener(mapper)
    yield listener
    listener.close()


@pytest.fixture
def eventually_true():
    def wait(holds):
        deadline = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < deadline
            time.sleep(0.01)

    return wait


def is_at(revision):
    return lambda update: update.revision == revision


def test_whoever_listens_hears_first_where_the_map_is_and_then_what_changes(mapper, listener):
    first = listener.until(lambda _: True)
    assert (first.prev, first.revision, first.whole, len(first.tiles)) == (0, 0, False, 0)
    mapper.draw_cross()
    listener.until(is_at(3))
    mapper.scan([1.0], at=9, pose=[300.25, 0.25, 0.0], range_max=2.5)
    last = listener.until(is_at(4))
    assert (last.prev, last.whole) == (3, False)
    assert [tuple(place) for place in last.tiles.tolist()] == [(9, 0)]
    for before, after in zip(listener.heard, listener.heard[1:], strict=False):
        assert after.prev in (before.revision, after.revision)


def test_a_copy_that_hears_all_is_the_map_after_every_scan(mapper, listener):
    with MapClient(mapper.endpoint, map_name="hall", timeout=PATIENCE) as client:
        listener.until(lambda _: True)
        copy, rng = MapCopy(2**24), np.random.default_rng(1)
        for update in decode_updates(client.fetch("map.tiles")):
            copy.take(update)
        for revision in range(1, 9):
            x, y = rng.normal(0, 30, 2).tolist()
            ranges = rng.uniform(1.0, 7.0, 30)
            mapper.scan(ranges, at=revision, pose=[x, y, 0.0], angle_increment=math.tau / 30)
            listener.until(is_at(revision))
            for update in listener.heard:
                assert copy.take(update) in (Taken.APPLIED, Taken.KNOWN)
            served, grid = client.get_map(), copy.grid()
            assert (grid.revision, grid.offset) == (served.revision, served.offset)
            assert np.array_equal(grid.log_odds, served.log_odds, equal_nan=True)


def test_a_map_that_does_not_change_is_told_again_and_again(mapper, listener):
    mapper.draw_cross()
    listener.until(is_at(3))
    listener.until(lambda update: update.prev == update.revision == 3 and not len(update.tiles))


def test_a_reset_is_told_whole_and_an_erasure_like_a_scan(mapper, listener):
    mapper.draw_cross()
    before = listener.until(is_at(3))
    mapper.http.post("/erase", params={"region": "0.5,0,3,0.5"}).raise_for_status()
    erased = listener.until(is_at(4))
    assert (erased.prev, erased.epoch) == (3, before.epoch)
    assert [tuple(place) for place in erased.tiles.tolist()] == [(0, 0)]
    mapper.http.post("/reset").raise_for_status()
    after = listener.until(lambda update: update.epoch != before.epoch)
    assert (after.whole, after.prev, after.revision, len(after.tiles)) == (True, 0, 0, 0)
    assert after.run == before.run


def test_of_much_it_is_told_only_that_it_has_changed(mapper, listener, monkeypatch):
    monkeypatch.setattr(update_publisher, "MAX_TOLD", 2 * 8192)
    listener.until(lambda _: True)
    mapper.draw_cross()
    told = listener.until(is_at(3))
    assert (told.prev, told.whole, len(told.tiles)) == (3, False, 0)


def test_while_nobody_listens_the_map_is_not_even_copied(mapper, eventually_true):
    """Others copy it meanwhile, such as who asks for the status."""
    publisher, live_map = mapper.service.updates, mapper.service.live_map
    looks, copied, look, snapshot = [], [], publisher._look, live_map.snapshot
    publisher._look = lambda on: (look(on), looks.append(None))

    def counted():
        copied.append(threading.current_thread().name)
        return snapshot()

    live_map.snapshot = counted
    mapper.draw_cross()
    eventually_true(lambda: len(looks) > 2)
    assert "ogm-updates" not in copied
    listener = Listener(mapper)
    listener.until(is_at(3))
    assert "ogm-updates" in copied
    listener.close()
    eventually_true(lambda: publisher._told is None)
    copied.clear()
    mapper.draw_cross(revision=3)
    seen = len(looks)
    eventually_true(lambda: len(looks) > seen + 2)
    assert "ogm-updates" not in copied
    again = Listener(mapper)  # who comes anew hears where the map is by now, and nothing of between
    first = again.until(lambda _: True)
    assert (first.prev, first.revision, len(first.tiles)) == (6, 6, 0)
    again.close()


def test_what_has_no_memory_is_told_later(mapper, listener, monkeypatch):
    listener.until(lambda _: True)
    in_flight = mapper.service.parts.in_flight
    monkeypatch.setattr(in_flight, "_left", lambda: 0)
    mapper.draw_cross()
    monkeypatch.setattr(update_publisher, "bytes_to_tell", lambda *_: 2**30)
    mapper.scan([1.0], at=9, pose=[0.25, 0.25, 0.0])
    mapper.settle(received=4)
    monkeypatch.undo()
    listener.until(is_at(4))


class Clock:
    """A clock on which nothing passes but what is said, and an event that notes how long it is waited for."""

    def __init__(self, takes):
        self._takes = takes
        self._now = 100.0
        self.pauses = []

    def monotonic(self):
        return self._now

    def wait(self, seconds):
        self.pauses.append(seconds)
        return len(self.pauses) > len(self._takes)

    def work(self, _):
        self._now += self._takes[len(self.pauses) - 1]


class Publisher:
    def undeclare(self):
        pass


def test_messages_begin_a_period_after_each_other_unless_they_take_long(monkeypatch):
    clock = Clock(takes=[0.0, 0.02, 0.05, 0.2, 0.01])
    publisher = UpdatePublisher(None, None)
    monkeypatch.setattr(update_publisher, "time", clock)
    monkeypatch.setattr(publisher, "_stopping", clock)
    monkeypatch.setattr(publisher, "_look", clock.work)
    publisher._run(Publisher())
    assert clock.pauses == pytest.approx([0.1, 0.1, 0.08, 0.05, 0.05, 0.09])
