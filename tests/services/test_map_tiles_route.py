"""/map.tiles and the map queryable's format tiles: what has changed since a map, cell for cell."""

import json

import numpy as np
import pytest

from ogm_client import MapClient
from ogm_client.map_copy import MapCopy, Taken
from ogm_core.wire.map_update import MEDIA_TYPE, decode_updates

OVER = pytest.mark.parametrize("over", ["http", "zenoh"])


def asked(mapper, over, **parameters):
    """The messages of an answer, and its tag."""
    if over == "http":
        answer = mapper.http.get("/map.tiles", params=parameters)
        assert (answer.status_code, answer.headers["content-type"]) == (200, MEDIA_TYPE)
        return list(decode_updates(answer.content)), answer.headers["etag"].strip('"')
    given = ";".join(["format=tiles", *(f"{name}={value}" for name, value in parameters.items())])
    sample = mapper.answer("map", given)
    assert str(sample.encoding) == MEDIA_TYPE
    updates = list(decode_updates(sample.payload.to_bytes()))
    newest = updates[-1]
    return updates, f"{newest.epoch}-{newest.run}-{newest.revision}"


def assert_served(copy, mapper):
    with MapClient(str(mapper.http.base_url), timeout=30.0) as client:
        served = client.get_map()
    grid = copy.grid()
    assert np.array_equal(grid.log_odds, served.log_odds, equal_nan=True)
    assert grid.log_odds.dtype == served.log_odds.dtype
    for name in ("resolution", "anchor", "offset", "epoch", "run", "revision", "stamp"):
        assert getattr(grid, name) == getattr(served, name)


@OVER
@pytest.mark.parametrize("settings", [{}, {"cells": "float64"}, {"half_life": 4.0}], ids=str)
def test_a_copy_follows_the_mapper(start_mapper, over, settings):
    with start_mapper(map={"resolution": 0.5, **settings}) as mapper:
        copy = MapCopy(2**20)
        ((empty,), _) = asked(mapper, over)
        assert (empty.whole, empty.revision, len(empty.tiles)) == (True, 0, 0)
        assert copy.take(empty) is Taken.APPLIED
        mapper.draw_cross()
        (update,), tag = asked(mapper, over)
        assert copy.take(update) is Taken.APPLIED
        assert {tuple(place) for place in update.tiles.tolist()} == {(0, 0), (-1, 0), (0, -1)}
        assert_served(copy, mapper)
        # Far away, seconds later: without a half-life just the tiles there have changed.
        place = {"pose": [300.25, 0.25, 0.0], "range_max": 2.5}
        mapper.scan([1.0], at=10**9, **place)
        mapper.settle(received=4)
        (update,), new_tag = asked(mapper, over, since=tag)
        assert (update.prev, update.revision, update.whole) == (3, 4, False)
        assert (9, 0) in map(tuple, update.tiles.tolist())
        assert new_tag.endswith("-4")
        assert (len(update.tiles) > 1) == ("half_life" in settings)
        assert copy.take(update) is Taken.APPLIED
        assert_served(copy, mapper)
        (nothing,), _ = asked(mapper, over, since=new_tag)
        assert (nothing.prev, nothing.revision, len(nothing.tiles)) == (4, 4, 0)
        # Of a map that is not this one, and of one that is still to come, all of it.
        for other in ("a-b-4", f"{tag.rpartition('-')[0]}-5", "-0"):
            (update,), _ = asked(mapper, over, since=other)
            assert update.whole
            assert len(update.tiles) == len(copy.tiles)


@OVER
def test_after_a_reset_all_is_sent(start_mapper, over):
    with start_mapper(map={"resolution": 0.5}) as mapper:
        mapper.draw_cross()
        _, tag = asked(mapper, over)
        mapper.http.post("/reset").raise_for_status()
        (update,), new_tag = asked(mapper, over, since=tag)
    assert (update.whole, update.revision, len(update.tiles), update.prev) == (True, 0, 0, 0)
    assert new_tag != tag


def test_a_map_that_has_not_changed_is_not_sent_again(cross):
    whole = cross.http.get("/map.tiles")
    again = {"If-None-Match": whole.headers["etag"]}
    assert cross.http.get("/map.tiles", headers=again).status_code == 304
    assert whole.headers["etag"] == cross.http.get("/map.npz").headers["etag"]
    since = {"since": whole.headers["etag"].strip('"')}
    assert cross.http.get("/map.tiles", params=since, headers=again).status_code == 304


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"since": "3"}, "since: <epoch>-<run>-<revision> is needed"),
        ({"since": "a-b-x"}, "since"),
        ({"since": "a-b-" + "1" * 19}, "since"),
        ({"region": "0,0,1,1"}, "region: unknown parameter; there are: since"),
        ({"at": "monday"}, "at: unknown parameter here, where all is of the map of now; there are: since"),
    ],
)
def test_what_is_asked_wrongly_is_refused(cross, parameters, said):
    answer = cross.http.get("/map.tiles", params=parameters)
    assert answer.status_code == 400
    assert said in answer.json()["detail"]
    given = ";".join(["format=tiles", *(f"{name}={value}" for name, value in parameters.items())])
    assert said in cross.problem("map", given)["detail"]


def test_a_map_that_starts_with_cells_is_whole_before_the_first_scan(start_mapper, cross, tmp_path):
    start = tmp_path / "start.npz"
    start.write_bytes(cross.http.get("/map.npz").content)
    with start_mapper(map={"resolution": 0.5}, mapper={"start_map": str(start)}) as mapper:
        copy = MapCopy(2**20)
        (update,), tag = asked(mapper, "http")
        assert (update.whole, update.revision, len(update.tiles)) == (True, 0, 3)
        assert copy.take(update) is Taken.APPLIED
        assert_served(copy, mapper)
        mapper.scan([1.0], pose=[0.25, 0.25, 0.0])
        mapper.settle(received=1)
        (update,), _ = asked(mapper, "http", since=tag)
        assert (update.prev, update.whole) == (0, False)
        assert copy.take(update) is Taken.APPLIED
        assert_served(copy, mapper)


def test_it_can_be_fetched_by_name(cross, tmp_path):
    with MapClient(cross.endpoint, map_name="hall", timeout=30.0) as client:
        (update,) = decode_updates(client.fetch("map.tiles"))
        (nothing,) = decode_updates(client.fetch("map.tiles", since=f"{update.epoch}-{update.run}-3"))
    assert update.revision == json.loads(cross.http.get("/status").content)["revision"] == 3
    assert len(nothing.tiles) == 0
