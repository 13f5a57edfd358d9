"""Tiles over HTTP: their pixels, their tags, and what is answered to those who know them already."""

import io
import itertools
import math
import threading
import zlib

import numpy as np
import pytest
from PIL import Image

from ogm_core.cells.value_bytes import COLOURS
from ogm_core.files.ros_map_writer import write_pgm, write_yaml
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Lattice, Region
from ogm_core.pictures.tile_png import EMPTY_TILE
from ogm_core.tiles.polygon import Polygon
from ogm_core.tiles.pyramid import Square, TilePyramid
from ogm_core.types import Pose, Scan
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.serving.map_tiles import MapTiles
from ogm_services.replies.answer import Busy, Starting
from ogm_services.replies.in_flight import InFlight

CORNERS = list(itertools.product((-1, 0), repeat=2))
"""The four tiles around the anchor."""
FOR_GOOD = "public, max-age=31536000, immutable"


def tile(mapper, z, x, y, headers=None, **query):
    return mapper.http.get(f"/tiles/{z}/{x}/{y}.png", params=query, headers=headers)


def problem(response):
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["cache-control"] == "no-store"
    return response.status_code, response.json()["type"]


def rgba(png):
    with Image.open(io.BytesIO(png)) as picture:
        picture.verify()
    with Image.open(io.BytesIO(png)) as picture:
        return np.asarray(picture.convert("RGBA")).astype(int)


def around_the_anchor(mapper, z=16, **query):
    """The four tiles there as one picture; its middle is the anchor."""
    west, east = ([rgba(tile(mapper, z, x, y, **query).content) for y in (-1, 0)] for x in (-1, 0))
    return np.concatenate([np.concatenate(column) for column in (west, east)], axis=1)


def stream_of(png):
    """The pixels' stream as it is in the file."""
    at = png.index(b"IDAT")
    return png[at + 4 : at + 4 + int.from_bytes(png[at - 4 : at])]


# What is to be seen.


@pytest.mark.parametrize("palette", COLOURS)
def test_tiles_show_what_the_map_shows(cross, palette):
    whole = rgba(cross.http.get("/map.png", params={"palette": palette, "transparent": 1}).content)
    # The map has columns -2 to 4 and rows -5 to 3 of cells; north is up.
    expected = np.zeros((512, 512, 4), int)
    expected[256 - 4 : 256 + 5, 256 - 2 : 256 + 5] = whole
    found = around_the_anchor(cross, palette=palette)
    drawn = expected[..., 3] == 255
    assert drawn.sum() == 14  # the known cells
    assert np.array_equal(found[..., 3], expected[..., 3])
    assert np.array_equal(found[drawn], expected[drawn])


def test_tiles_of_ros_have_its_greys(cross):
    grey = rgba(cross.http.get("/map.png").content)
    found = around_the_anchor(cross)[256 - 4 : 256 + 5, 256 - 2 : 256 + 5]
    known = found[..., 3] == 255
    assert np.array_equal(found[known], grey[known])
    assert set(grey[~known].ravel().tolist()) == {205, 255}
    east = around_the_anchor(cross)[255, 256:262, [0, 3]].T.tolist()
    # The robot's own cell is unknown; then three free ones, and the wall.
    assert east == [[205, 0], *[[254, 255]] * 3, [0, 255], [205, 0]]


def test_a_tile_of_half_the_resolution_joins_four_cells(cross):
    fine = around_the_anchor(cross)
    coarse = around_the_anchor(cross, z=15)
    for row, column in itertools.product(range(128 - 3, 128 + 3), repeat=2):
        y, x = 2 * row, 2 * column
        four = fine[y : y + 2, x : x + 2].reshape(4, 4).tolist()
        known = [pixel[0] for pixel in four if pixel[3]]
        expected = 0 if 0 in known else max(known, default=None)
        found = coarse[row + 128, column + 128]
        assert (found[0] if found[3] else None) == expected
    assert (coarse[..., 3] == 255).sum() == 8


def test_palettes_share_the_pixels(cross):
    streams = {stream_of(tile(cross, 16, 0, -1, palette=palette).content) for palette in COLOURS}
    assert len(streams) == 1
    rows = zlib.decompress(streams.pop())
    assert len(rows) == 256 * 257


@pytest.mark.parametrize(("z", "metres"), [(16, 0.5), (15, 1.0), (10, 32.0)])
def test_headers(cross, z, metres):
    status = cross.status()
    found = tile(cross, z, 0, 0)  # the third scan went south, alone
    assert tile(cross, z, 0, -1).headers["ogm-revision"] == "2"
    assert found.status_code == 200
    identity = status["epoch"], status["run"], str(status["revision"])
    assert {name: found.headers[name] for name in ("content-type", "cache-control", "ogm-resolution")} == {
        "content-type": "image/png",
        "cache-control": "no-cache",
        "ogm-resolution": repr(metres),
    }
    assert tuple(found.headers[name] for name in ("ogm-epoch", "ogm-run", "ogm-revision")) == identity
    assert found.headers["etag"] == f'"{"-".join(identity)}"'


# Where nothing was written.


@pytest.mark.parametrize(("z", "x", "y"), [(16, 1, -1), (16, -2, 0), (15, 1, 0), (10, -2, 7)])
@pytest.mark.parametrize("palette", [{}, {"palette": "dark"}])
def test_a_tile_that_was_never_written(cross, z, x, y, palette):
    found = tile(cross, z, x, y, **palette)
    epoch = cross.status()["epoch"]
    assert (found.status_code, found.content) == (200, EMPTY_TILE)
    assert found.headers["etag"] == f'"{epoch}-empty"'
    assert found.headers["ogm-epoch"] == epoch
    assert "ogm-revision" not in found.headers
    assert tile(cross, z, x, y, {"If-None-Match": found.headers["etag"]}).status_code == 304


def test_an_empty_tile_is_small_and_transparent():
    assert len(EMPTY_TILE) <= 116
    assert rgba(EMPTY_TILE).shape == (256, 256, 4)
    assert not rgba(EMPTY_TILE)[..., 3].any()


def test_a_map_without_a_scan_has_empty_tiles_everywhere(mapper):
    assert {tile(mapper, z, 0, 0).content for z in range(10, 17)} == {EMPTY_TILE}
    told = mapper.http.get("/tiles.json").json()
    assert (told["ogm"]["extent"], told["ogm"]["revision"]) == (None, 0)
    assert problem(mapper.http.get("/map.pgw")) == (404, "map-empty")


# What is known already.


def test_a_tile_that_has_not_changed(cross):
    whole = tile(cross, 16, 0, -1, palette="dark")
    for sent, status in (
        ("{etag}", 304),
        ("W/{etag}", 304),
        ("*", 304),
        ('"other"', 200),
        ('"x", {etag}', 304),
    ):
        for _ in range(3):  # the first answer is made by the route, those after it are ready
            headers = {"If-None-Match": sent.format(etag=whole.headers["etag"])}
            answer = tile(cross, 16, 0, -1, headers, palette="dark")
            assert (answer.status_code, answer.content) == (status, whole.content if status == 200 else b"")
            for name in ("etag", "cache-control", "ogm-epoch", "ogm-revision", "ogm-resolution"):
                assert answer.headers[name] == whole.headers[name]
    assert problem(tile(cross, 16, 0, -1, {"If-Match": '"other"'})) == (412, "map-changed")
    assert tile(cross, 16, 0, -1, {"If-Match": whole.headers["etag"]}).status_code == 200


def test_a_revision_that_is_asked_for_by_name_may_be_kept_for_good(cross):
    plain = tile(cross, 16, 0, -1)
    tag = plain.headers["etag"].strip('"')
    epoch, run, revision = tag.split("-")
    for rev in (
        tag,
        f"{epoch}-{run}-{int(revision) - 1}",
        f"{epoch}-{run}-{int(revision) + 1}",
        revision,
        "",
    ):
        for _ in range(2):
            found = tile(cross, 16, 0, -1, rev=rev)
            assert found.content == plain.content
            assert found.headers["cache-control"] == (FOR_GOOD if rev == tag else "no-cache")
            assert found.headers["etag"] == plain.headers["etag"]
    assert tile(cross, 16, 0, -1, {"If-None-Match": f'"{tag}"'}, rev=tag).headers["cache-control"] == FOR_GOOD
    empty = tile(cross, 16, 5, 5, rev=f"{epoch}-empty")
    assert (empty.content, empty.headers["cache-control"]) == (EMPTY_TILE, FOR_GOOD)
    assert tile(cross, 16, 5, 5, rev=tag).headers["cache-control"] == "no-cache"


def test_head_is_get_without_a_body(cross):
    for path in ("/tiles/16/0/-1.png", "/tiles/16/9/9.png", "/tiles.json", "/map.pgw"):
        for _ in range(2):
            got, head = cross.http.get(path), cross.http.head(path)
            assert (head.status_code, head.content) == (200, b"")
            assert {**head.headers, "date": ""} == {**got.headers, "date": ""}


# What is refused.


@pytest.mark.parametrize(
    ("path", "refused"),
    [
        ("17/0/0", (404, "not-found")),
        ("9/0/0", (404, "not-found")),
        ("-1/0/0", (404, "not-found")),
        (f"16/{2**26}/0", (404, "not-found")),
        (f"10/0/{-(2**26)}", (404, "not-found")),
        (f"16/{'9' * 5000}/0", (404, "not-found")),
        ("16/0.5/0", (400, "bad-parameter")),
        ("16/a/0", (400, "bad-parameter")),
        ("z/0/0", (400, "bad-parameter")),
        ("16/0/1e3", (400, "bad-parameter")),
        ("16/+1/0", (400, "bad-parameter")),
        ("16/1_0/0", (400, "bad-parameter")),
        ("16/%D9%A1/0", (400, "bad-parameter")),
        ("16/ 1/0", (400, "bad-parameter")),
        ("16/--1/0", (400, "bad-parameter")),
        ("16/-/0", (400, "bad-parameter")),
        ("16/0/0/0", (404, "not-found")),
        ("16/0", (404, "not-found")),
    ],
)
def test_a_place_without_tiles(cross, path, refused):
    assert problem(cross.http.get(f"/tiles/{path}.png")) == refused


@pytest.mark.parametrize(("x", "y"), [(2**26 - 1, 1 - 2**26), (1 - 2**26, 2**26 - 1)])
@pytest.mark.parametrize("z", [16, 10])
def test_the_last_tiles_there_are(cross, z, x, y):
    assert tile(cross, z, x, y).content == EMPTY_TILE


@pytest.mark.parametrize(
    "query",
    ["palette=viridis", "palette=", "palette=ros&palette=ros", "transparent=1", "region=0,0,1,1", "no=1"],
)
def test_a_bad_parameter(cross, query):
    assert problem(cross.http.get(f"/tiles/16/0/0.png?{query}")) == (400, "bad-parameter")
    assert problem(cross.http.get("/tiles.json?no=1")) == (400, "bad-parameter")


def test_tiles_are_of_the_map_of_now_and_say_so(cross):
    said = cross.http.get("/tiles/16/0/0.png?at=monday").json()["detail"]
    assert said == "at: unknown parameter here, where all is of the map of now; there are: palette, rev"


def test_a_wrong_method_or_ending(cross):
    assert problem(cross.http.post("/tiles/16/0/0.png")) == (405, "method-not-allowed")
    assert problem(cross.http.get("/tiles/16/0/0.jpg")) == (404, "not-found")
    assert cross.http.get("/tiles/16/0/0.png?t=17").status_code == 200


# Whole pictures in colours.


@pytest.mark.parametrize("palette", COLOURS)
def test_a_whole_picture_in_colours(cross, palette):
    query = {"palette": palette}
    opaque = cross.http.get("/map.png", params=query)
    shown = rgba(opaque.content)
    assert (shown[..., 3] == 255).all()
    with Image.open(io.BytesIO(opaque.content)) as picture:
        assert picture.mode == ("L" if palette in ("ros", "probability") else "P")
    clear = rgba(cross.http.get("/map.png", params={**query, "transparent": "1"}).content)
    known = clear[..., 3] == 255
    assert known.sum() == 14
    assert np.abs(clear[known] - shown[known]).max() <= (palette == "probability")
    assert np.abs(shown[~known][:, :3] - COLOURS[palette][0]).max() == 0
    # By region and size it is encoded anew; from the whole it is kept up to date.
    again = cross.http.get("/map.png", params={**query, "region": "-9,-9,9,9", "transparent": "1"})
    assert np.array_equal(rgba(again.content), clear)
    assert cross.http.get("/map.png", params={**query, "transparent": "0"}).content == opaque.content


@pytest.mark.parametrize(
    ("path", "query"),
    [
        ("/map.png", "palette=viridis"),
        ("/map.png", "transparent=2"),
        ("/map.png", "transparent="),
        ("/map.png", "transparent=true"),
        ("/map.pgm", "palette=cividis"),
        ("/map.pgm", "transparent=1"),
        ("/map.pgw", "palette=ros"),
    ],
)
def test_what_a_picture_does_not_take(cross, path, query):
    assert problem(cross.http.get(f"{path}?{query}")) == (400, "bad-parameter")


def test_a_world_file_places_the_picture(cross):
    def lines(**query):
        answer = cross.http.get("/map.pgw", params=query)
        assert answer.headers["content-type"].startswith("text/plain")
        return [float(line) for line in answer.text.splitlines()]

    # Columns -2 to 4, rows -5 to 3 of 0.5 m: the centre of the pixel in the upper left corner.
    assert lines() == [0.5, 0.0, 0.0, -0.5, -0.75, 1.75]
    assert lines(region="0,0,1,1") == [0.5, 0.0, 0.0, -0.5, 0.25, 0.75]
    # 3 x 3 cells a pixel, from the lower left corner (-1, -2.5) on: 3 x 3 pixels of 1.5 m.
    assert lines(max_size="3") == [1.5, 0.0, 0.0, -1.5, -0.25, 1.25]
    etag = cross.http.get("/map.png").headers["etag"]
    assert cross.http.get("/map.pgw", headers={"If-None-Match": etag}).status_code == 304


# What viewers are told.


def test_tilejson(cross):
    status = cross.status()
    answer = cross.http.get("/tiles.json")
    base = str(cross.http.base_url)
    legend = {"occupied": "#000000", "free": "#fefefe", "undecided": "#cdcdcd", "unknown": "#cdcdcd"}
    told = answer.json()
    assert told["ogm"].pop("legend")["ros"] == legend
    assert told == {
        "tilejson": "3.0.0",
        "name": "hall",
        "scheme": "xyz",
        "tiles": [f"{base.rstrip('/')}/tiles/{{z}}/{{x}}/{{y}}.png"],
        "minzoom": 10,
        "maxzoom": 16,
        "tilesize": 256,
        "ogm": {
            **{name: status[name] for name in ("epoch", "run", "revision")},
            "resolution": 0.5,
            "anchor": [0.0, 0.0],
            "extent": [-1.0, -2.5, 2.5, 2.0],
            "palettes": list(COLOURS),
        },
    }
    url = told["tiles"][0].format(z=16, x=0, y=-1)
    assert cross.http.get(url).content == tile(cross, 16, 0, -1).content
    whole = cross.http.get("/map.json")
    for name in ("etag", "cache-control", "ogm-epoch", "ogm-run", "ogm-revision", "ogm-resolution"):
        assert answer.headers[name] == whole.headers[name]
    assert cross.http.get("/tiles.json", headers={"If-None-Match": whole.headers["etag"]}).status_code == 304


def test_the_url_of_the_tiles_is_by_the_name_that_was_asked(cross):
    for host in ("localhost:8123", "127.0.0.1", "x.localhost"):
        for _ in range(2):
            told = cross.http.get("/tiles.json", headers={"Host": host}).json()
            assert told["tiles"] == [f"http://{host}/tiles/{{z}}/{{x}}/{{y}}.png"]


# Tags: another one exactly where something has changed.


PLACES = [(z, x, y) for z in (16, 15, 10) for x, y in itertools.product((-2, -1, 0, 1), repeat=2)]


class Tiles:
    """The tiles of three resolutions around the anchor: their bodies by tag, for good."""

    def __init__(self):
        self.bodies = {}

    def look(self, mapper):
        """By place its tag, after a look that it is no other body's."""
        tags = {}
        for place in PLACES:
            found = tile(mapper, *place).raise_for_status()
            tags[place] = found.headers["etag"]
            body = self.bodies.setdefault((place, found.headers["etag"]), found.content)
            assert body == found.content, place
            again = tile(mapper, *place, {"If-None-Match": found.headers["etag"]})
            assert again.status_code == 304
        return tags


def changed(before, after):
    return {place for place in before if before[place] != after[place]}


def test_tags_change_exactly_where_a_scan_has_written(mapper):
    """Cells of 0.5 m: a tile has 128 m, and 256 m at half the resolution."""
    rng, seen = np.random.default_rng(3), Tiles()
    tags = seen.look(mapper)
    for received in range(12):
        x, y = (rng.uniform(-110.0, 110.0, 2) // 32 * 32 + 16).tolist()  # middle of a tile of 64 cells
        mapper.scan(rng.uniform(1.0, 7.0, 8), pose=[x, y, 0.0], angle_increment=0.8, at=received)
        mapper.settle(received=received + 1)
        now = seen.look(mapper)
        i, j = math.floor(x / 128), math.floor(y / 128)
        assert changed(tags, now) == {
            (z, place[0], place[1])
            for z, k in ((16, 0), (15, 1), (10, 6))
            if (place := (i >> k, -1 - (j >> k))) and (z, *place) in tags
        }
        tags = now


def test_tags_of_reset_erased_and_restored_maps(start_mapper, no_errors, tmp_path):
    sections = {"map": {"resolution": 0.5}, "mapper": {"data": str(tmp_path / "data")}}
    seen = Tiles()
    with start_mapper(**sections) as mapper:
        mapper.draw_cross()
        drawn = seen.look(mapper)
        mapper.http.post("/save", params={"name": "cross"}).raise_for_status()
        mapper.http.post("/erase", params={"region": "1,-1,3,1"}).raise_for_status()
        erased = seen.look(mapper)
        assert changed(drawn, erased) == {(z, 0, -1) for z in (16, 15, 10)}
        mapper.http.post("/restore", params={"name": "cross"}).raise_for_status()
        restored = seen.look(mapper)
        assert not set(restored.values()) & {*drawn.values(), *erased.values()}
        for place in PLACES:
            assert seen.bodies[place, restored[place]] == seen.bodies[place, drawn[place]]
        mapper.http.post("/reset").raise_for_status()
        assert {seen.bodies[place, tag] for place, tag in seen.look(mapper).items()} == {EMPTY_TILE}
        mapper.scan([1.0, 2.0], pose=[1.0, 1.0, 0.0], at=50)
        mapper.settle(received=4)
        last = seen.look(mapper)
    with start_mapper(**sections) as mapper:
        again = seen.look(mapper)
        for place in PLACES:
            assert seen.bodies[place, again[place]] == seen.bodies[place, last[place]]
            empty = last[place].endswith('-empty"')
            assert (again[place] == last[place]) == empty  # another run may come to other cells


def test_tags_of_a_start_map(start_mapper, no_errors, tmp_path):
    """Its cells and those of the first scan: the store says 1 of both."""
    greys = np.full((40, 40), 254, np.uint8)
    greys[10:14] = 0
    (tmp_path / "floor.pgm").write_bytes(write_pgm(greys))
    floor = tmp_path / "floor.yaml"
    floor.write_text(write_yaml("floor.pgm", 0.5, (-10.0, -10.0)))
    seen = Tiles()
    with start_mapper(mapper={"start_map": str(floor)}) as mapper:
        before = seen.look(mapper)
        assert before[16, 0, -1].endswith('-0"')
        assert mapper.http.get("/tiles.json").json()["ogm"]["anchor"] == [-10.0, -10.0]
        mapper.scan([1.0, 2.0, 3.0], pose=[30.0, 0.0, 0.0], at=1)
        mapper.settle(received=1)
        after = seen.look(mapper)
        written = {(16, 0, -1), (15, 0, -1), (10, 0, -1)}
        assert changed(before, after) == written
        for place in written:
            assert seen.bodies[place, before[place]] != seen.bodies[place, after[place]]


# What is kept.


@pytest.fixture
def live():
    """A live map with one scan in each of the four tiles around the anchor."""
    live = LiveMap(OccupancyGrid(GridSettings(0.1), "epoch", "run"))
    for k, (x, y) in enumerate(CORNERS):
        integrate(live, 8.0 + 16.0 * x, 8.0 + 16.0 * y, k)
    return live


def integrate(live, x, y, stamp=0):
    live.integrate(Scan(stamp, 0.0, 0.5, 0.0, 8.0, np.full(12, 3.0, np.float32)), Pose(x, y, 0.0))


@pytest.fixture
def made(monkeypatch):
    """The squares whose pixels were made."""
    made = []
    pixels = TilePyramid.pixels
    monkeypatch.setattr(
        TilePyramid,
        "pixels",
        lambda pyramid, view, model, square: (made.append(square), pixels(pyramid, view, model, square))[1],
    )
    return made


def test_a_stream_is_made_once_for_all_palettes_and_again_when_its_tile_has_changed(live, made):
    tiles, square, other = MapTiles(live), Square(16, 0, -1), Square(16, -1, 0)
    for palette in (*COLOURS, "ros"):
        assert tiles.tile(square, palette).revision == 4
        assert tiles.tile(other, palette).revision == 1
    assert made == [square, other]
    before = tiles.tile(square, "ros")
    integrate(live, -8.0, -8.0)
    assert tiles.tile(square, "ros").png == before.png
    assert tiles.tile(other, "ros").revision == 5
    assert made == [square, other, other]
    live.reset("f")
    assert tiles.tile(square, "ros").png == EMPTY_TILE
    tiles.let_go()
    assert tiles.nbytes == 0


def test_streams_have_a_room_and_the_one_that_was_not_asked_for_for_longest_goes(live, made):
    squares = [Square(16, x, -1 - y) for x, y in CORNERS]
    tiles = MapTiles(live)
    for square in squares:
        tiles.tile(square, "ros")
    size = tiles.nbytes
    assert size > 4 * 512
    tiles = MapTiles(live, room=size - 1)  # not quite all four
    first, second, third, fourth = squares
    for square in squares:
        tiles.tile(square, "ros")
        assert tiles.nbytes <= size - 1
    made.clear()
    for square in (
        second,
        fourth,
        first,
        second,
        fourth,
    ):  # the first one had gone, and the third goes for it
        tiles.tile(square, "ros")
    assert made == [first]
    tiles.tile(third, "ros")
    assert made == [first, third]
    none = MapTiles(live, room=0)
    assert none.tile(squares[0], "ros").png == none.tile(squares[0], "ros").png
    assert none.nbytes == 0


def test_a_tile_that_there_is_no_memory_for_is_refused_unless_it_is_kept(live):
    in_flight = InFlight()
    tiles = MapTiles(live, in_flight=in_flight)
    kept = tiles.tile(Square(16, 0, 0), "ros")
    with in_flight.making(in_flight.limit):
        assert tiles.tile(Square(16, 0, 0), "dark").tag == kept.tag
        assert tiles.tile(Square(16, 9, 9), "ros").png == EMPTY_TILE
        with pytest.raises(Busy):
            tiles.tile(Square(16, 0, -1), "ros")
    assert tiles.tile(Square(16, 0, -1), "ros").revision == 4


def test_equal_tags_are_equal_pixels_whoever_asks_while_the_map_changes(live, in_background):
    """Readers of a map that grows, is erased and reset under them share one pyramid and its streams."""
    tiles, bodies = MapTiles(live, room=40_000), {}
    done, looked = threading.Event(), threading.Semaphore(0)
    squares = [Square(z, x, -1 - y) for z in (16, 15, 12) for x, y in CORNERS]

    def look(seed):
        rng, looks = np.random.default_rng(seed), 0
        while not done.is_set():
            square = squares[rng.integers(len(squares))]
            tile = tiles.tile(square, "ros")
            assert bodies.setdefault((square, tile.tag), tile.png) == tile.png
            looks += 1
            looked.release()
            if looks % 40 == 0:
                tiles.let_go()

    readers = [in_background(look, seed) for seed in range(4)]
    rng = np.random.default_rng(9)
    try:
        for k in range(150):
            while looked.acquire(blocking=False):
                pass  # looks of before the last scan
            for _ in range(4):
                assert looked.acquire(timeout=60.0)
            x, y = rng.uniform(-30.0, 30.0, 2).tolist()
            integrate(live, x, y, k)
            if k % 25 == 24:
                live.erase(Polygon.of_region(Region(x - 4.0, y - 4.0, x + 9.0, y + 9.0), Lattice(0.1)))
            if k == 90:
                live.reset("another epoch")
    finally:
        done.set()
    for reader in readers:
        reader.result(60.0)
    assert len({tag for _, tag in bodies}) > 20
    quiet = MapTiles(live)
    for square in squares:
        tile, alone = tiles.tile(square, "ros"), quiet.tile(square, "ros")
        assert (tile.tag, tile.png) == (alone.tag, alone.png)


def test_a_mapper_that_starts_has_no_tiles_yet(start_mapper, monkeypatch):
    monkeypatch.setattr("ogm_services.mapper.serving.answers.Answers.check_ready", _starting)
    with start_mapper() as mapper:
        for path in ("/tiles/16/0/0.png", "/tiles.json"):
            answer = mapper.http.get(path)
            assert problem(answer) == (503, "starting")
            assert answer.headers["retry-after"]


def _starting(_):
    raise Starting("not yet")
