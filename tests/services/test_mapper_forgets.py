"""A running mapper that forgets: what it serves of a box that is gone, under which tags, and later on."""

import io

import numpy as np
import pytest
from PIL import Image

from ogm_core.cells.classes import ros_grey

SECOND = 10**9
BOX = "region=2,0,2.5,0.5"
SEEN = 600
WALL, GONE = (100, 0, 0, 0), (-1, 205, 205, 205)
"""Of the box as JSON, PNG, PGM and in a tile: occupied, and undecided."""
TILE = "/tiles/16/0/-1.png"


@pytest.fixture
def started(start_mapper, no_errors, tmp_path):
    """`with started() as mapper`: a mapper of cells of 0.5 m that stores its map; a scan a tick."""

    def start(**changes):
        settings = {"resolution": 0.5, "half_life": 4.0} | changes
        return start_mapper(map=settings, mapper={"data": str(tmp_path / "data"), "pose_wait": 60.0})

    return start


def see_box(mapper):
    """Twenty scans a second for half a minute from one place."""
    for k in range(SEEN):
        mapper.scan([2.0], run="box", seq=k, at=k * SECOND // 20, pose=[0.25, 0.25, 0.0])
    return mapper.settle(received=SEEN)


def look_elsewhere(mapper, ticks, *, since=0, received=SEEN):
    """A scan for each tick, of another room."""
    for k in range(since, ticks):
        at = (SEEN // 20 + k) * SECOND
        mapper.scan([1.0], run="away", seq=k, at=at, pose=[50.25, 0.25, 0.0])
    return mapper.settle(received=received + ticks - since)


def box(mapper):
    """What is served of the box: JSON, PNG, PGM and in its tile."""
    pictures = (mapper.http.get(f"/map.{form}?{BOX}").raise_for_status() for form in ("png", "pgm"))
    pixels = [int(np.asarray(Image.open(io.BytesIO(picture.content))).item()) for picture in pictures]
    (value,) = mapper.http.get(f"/map.json?{BOX}&values=trinary").json()["data"]
    tile = Image.open(io.BytesIO(mapper.http.get(TILE).content)).convert("RGB")
    return value, *pixels, tile.getpixel((4, 255))[0]


def box_known(mapper):
    return mapper.http.get("/cell?x=2.25&y=0.25").json()


@pytest.mark.parametrize("cells", ["int16", "float64"])
def test_a_box_that_is_gone_unseen_fades_in_map_and_pictures_under_tags_of_their_own(started, cells):
    with started(cells=cells) as mapper:
        see_box(mapper)
        assert box(mapper) == WALL
        assert box_known(mapper)["log_odds"] == pytest.approx(8.0)
        tags = set()
        for ticks in range(1, 17):
            before = mapper.http.get("/map.png")
            look_elsewhere(mapper, ticks, since=ticks - 1, received=SEEN + ticks - 1)
            tag = {"If-None-Match": before.headers["etag"]}
            after = mapper.http.get("/map.png", headers=tag)
            assert after.status_code == 200
            assert after.headers["ogm-revision"] == str(SEEN + ticks)
            assert (
                mapper.http.get("/map.png", headers={"If-None-Match": after.headers["etag"]}).status_code
                == 304
            )
            assert mapper.http.head(TILE).headers["etag"] == after.headers["etag"]
            tags.add(after.headers["etag"])
            whole = mapper.service.live_map.snapshot().encode(ros_grey)[::-1]
            assert np.array_equal(np.asarray(Image.open(io.BytesIO(after.content))), whole)
            assert box_known(mapper)["log_odds"] == pytest.approx(8.0 * 2 ** (-ticks / 4), abs=0.008)
            assert box(mapper) == (WALL if ticks < 15 else GONE)
        assert len(tags) == 16
        assert box_known(mapper)["known"] is True


def test_while_no_scan_comes_nothing_is_forgotten(started, eventually):
    """Poses and questions are no time, however late their stamps."""
    with started() as mapper:
        see_box(mapper)
        before = mapper.http.get("/map.npz")
        for hour in range(1, 20):
            mapper.pose(at=3600 * hour * SECOND, seq=hour)
        eventually(lambda: mapper.status()["poses"]["received"] == 19)
        after = mapper.http.get("/map.npz", headers={"If-None-Match": before.headers["etag"]})
        assert after.status_code == 304
        assert mapper.http.get("/map.npz").content == before.content


def test_a_mapper_that_is_started_again_goes_on_with_its_maps_time(started):
    """However long it was away: the next scans move the time on, each by a second at most."""
    with started() as mapper:
        see_box(mapper)
        look_elsewhere(mapper, 5)
        before = mapper.http.get("/map.npz").content
    with started() as mapper:
        assert mapper.http.get("/map.npz").content == before
        look_elsewhere(mapper, 3605, since=3600, received=SEEN + 5)
        assert box_known(mapper)["log_odds"] == pytest.approx(8.0 * 2 ** (-10 / 4), abs=0.008)


def test_a_snapshot_is_restored_with_its_time(started):
    with started() as mapper:
        see_box(mapper)
        look_elsewhere(mapper, 4)
        mapper.http.post("/save?name=then").raise_for_status()
        then = mapper.http.get("/map.npz").content
        look_elsewhere(mapper, 20, since=4, received=SEEN + 4)
        assert box(mapper) == GONE
        assert mapper.http.get("/map.npz?at=then").content == then
        mapper.http.post("/restore?name=then").raise_for_status()
        assert mapper.http.get("/map.npz").content == then
        assert box(mapper) == WALL
        look_elsewhere(mapper, 21, since=20, received=SEEN + 20)
        assert box_known(mapper)["log_odds"] == pytest.approx(8.0 * 2 ** (-5 / 4), abs=0.008)


def test_what_is_erased_between_two_ticks_leaves_the_rest_of_its_tile_as_old_as_it_was(started):
    with started() as mapper:
        see_box(mapper)
        look_elsewhere(mapper, 3)
        erased = mapper.http.post("/erase?region=1,0,1.5,0.5").raise_for_status().json()
        assert erased["cells"] == 1
        assert box_known(mapper)["log_odds"] == pytest.approx(8.0 * 2 ** (-3 / 4), abs=0.008)
        look_elsewhere(mapper, 6, since=3, received=SEEN + 3)
        assert box_known(mapper)["log_odds"] == pytest.approx(8.0 * 2 ** (-6 / 4), abs=0.008)
        assert mapper.http.get("/cell?x=1.25&y=0.25").json()["known"] is False
    with started() as mapper:
        assert box_known(mapper)["log_odds"] == pytest.approx(8.0 * 2 ** (-6 / 4), abs=0.008)


def test_a_reset_map_begins_a_time_of_its_own(started):
    with started() as mapper:
        see_box(mapper)
        look_elsewhere(mapper, 3)
        mapper.http.post("/reset").raise_for_status()
        mapper.scan([2.0], run="again", seq=0, at=0, pose=[0.25, 0.25, 0.0])  # long before
        mapper.settle(received=SEEN + 4)
        mapper.scan([1.0], run="again", seq=1, at=SECOND, pose=[50.25, 0.25, 0.0])
        mapper.settle(received=SEEN + 5)
        seen_once = 0.8473
        assert box_known(mapper)["log_odds"] == pytest.approx(seen_once * 2 ** (-1 / 4), abs=0.002)


def test_a_robot_whose_clock_is_far_from_the_maps_time_is_hinted_at(started):
    """A year ahead: for less a map may have rested."""
    days, received = {"honest": 0, "monday": 6, "wrong": 365}, 0
    with started() as mapper:
        for name, late in days.items():
            for k in range(10):
                at = late * 86_400 * SECOND + k * SECOND // 20
                mapper.scan([2.0], robot=name, run=name, seq=k, at=at, pose=[0.25, 0.25, 0.0])
            received += 10
            robots = mapper.settle(received=received)["robots"]
    hints = {name: robots[name]["sources"]["s"]["hints"] for name in days}
    assert hints == {"honest": [], "monday": [], "wrong": ["map_clock"]}
