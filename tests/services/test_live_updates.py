"""What a live client is told of its view: all of it, once, however much comes at a time."""

import io
import math

import msgpack
import numpy as np
import pytest
from PIL import Image

from ogm_core.errors import BadMessage
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.placing.receipts import Receipts
from ogm_core.status import GONE_AFTER
from ogm_core.tiles.pyramid import Square
from ogm_core.types import Pose, Scan
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.newest_scans import MAX_SOURCES, NewestScans
from ogm_services.mapper.serving import live_updates
from ogm_services.mapper.serving.live_updates import LiveUpdates
from ogm_services.mapper.serving.live_view import Seen, View, decode_view
from ogm_services.mapper.serving.map_tiles import MapTiles
from ogm_services.replies.answer import Busy

ALL = [-2, -2, 1, 1]
"""Tiles in which all that is driven here lies, at z = 16."""


def view(tiles=ALL, z=16, **fields):
    return View(type="view", z=z, tiles=tiles, **fields)


class Desk:
    """A live map, and what a client of it has been told."""

    def __init__(self, instant=-1.0):
        self.live = LiveMap(OccupancyGrid(GridSettings(0.1), "first", "run"))
        self.receipts = Receipts()
        self.scans = NewestScans(lambda: self.live.now.epoch)
        self.tiles = MapTiles(self.live)
        self.updates = LiveUpdates("hall", self.live, self.tiles, self.receipts, self.scans, instant)
        self.seen = Seen(self.live.now.life)
        self.held = {}
        self.rng = np.random.default_rng(3)

    def drive(self, times=1):
        for _ in range(times):
            ranges = self.rng.uniform(0.3, 7.0, 30).astype(np.float32)
            at = Pose(*self.rng.uniform(-40.0, 40.0, 2).tolist(), 0.0)
            self.live.integrate(Scan(10**9, 0.0, math.tau / 30, 0.0, 8.0, ranges), at)

    def look(self, wanted):
        """The next update, its tiles noted."""
        made = self.updates.update(wanted, self.seen)
        self.seen = made.seen
        message = msgpack.unpackb(made.body)
        for z, x, y, revision, png in message["tiles"]:
            assert self.held.get((z, x, y), (-1,))[0] < revision <= message["revision"]
            self.held[z, x, y] = revision, png
        return message

    def check(self, wanted):
        """What is held is what is there, and nothing of it is empty."""
        z, (x0, y0, x1, y1) = wanted.z, wanted.tiles
        for x in range(x0, x1 + 1):
            for y in range(y0, y1 + 1):
                tile = self.tiles.tile(Square(z, x, y), wanted.palette)
                known = None if tile.revision is None else (tile.revision, tile.png)
                assert self.held.get((z, x, y)) == known, (x, y)


@pytest.mark.parametrize("z", [16, 15, 10])
def test_after_a_stall_of_200_scans_one_update_brings_all(z):
    desk, wanted = Desk(), view(z=z)
    desk.drive()
    assert len(desk.look(wanted)["tiles"]) > 0
    desk.check(wanted)
    desk.drive(200)
    message = desk.look(wanted)
    assert (message["revision"], message["more"]) == (201, False)
    desk.check(wanted)
    assert desk.look(wanted)["tiles"] == []


def test_only_what_has_changed_is_sent_again():
    desk, wanted = Desk(), view()
    desk.drive(100)
    desk.look(wanted)
    for _ in range(30):
        desk.drive()
        message = desk.look(wanted)
        assert 0 < len(message["tiles"]) < 16
        assert {revision for *_, revision, _ in message["tiles"]} == {message["revision"]}
        desk.check(wanted)


def test_for_an_instant_all_are_told_of_the_same_copy():
    desk, wanted = Desk(instant=3600.0), view()
    desk.drive(9)
    assert desk.look(wanted)["revision"] == 9
    desk.drive()
    made = desk.updates.update(wanted, desk.seen)
    assert msgpack.unpackb(made.body)["revision"] == 9
    assert made.moment != desk.updates.now()  # so that it is told of the rest when the instant has passed
    desk.live.snapshot()  # somebody else has taken a newer one
    message = desk.look(wanted)
    assert (message["revision"], desk.updates.update(wanted, desk.seen).moment) == (10, desk.updates.now())
    desk.live.reset("second")
    desk.seen = Seen(desk.live.now.life)
    assert desk.look(wanted)["epoch"] == "second"


def test_tiles_are_of_the_palette_that_is_asked_for():
    desk = Desk()
    desk.drive(20)
    for palette in ("ros", "dark"):
        desk.seen, desk.held = Seen(desk.live.now.life), {}
        desk.look(view(palette=palette))
        desk.check(view(palette=palette))


def test_much_comes_in_parts_the_inmost_first(monkeypatch):
    monkeypatch.setattr(live_updates, "MAX_TILES", 5)
    desk, wanted = Desk(), view()
    desk.drive(100)
    first = desk.look(wanted)
    assert [(x, y) for _, x, y, *_ in first["tiles"]][:4] == [(-1, -1), (-1, 0), (0, -1), (0, 0)]
    counts = [(len(first["tiles"]), first["more"])]
    while counts[-1][1]:
        message = desk.look(wanted)
        counts.append((len(message["tiles"]), message["more"]))
    assert counts == [(5, True), (5, True), (5, True), (1, False)]
    desk.check(wanted)
    assert desk.seen == Seen(desk.live.now.life, 100)


def test_what_changes_all_the_time_keeps_nothing_else_waiting(monkeypatch):
    """More changes between two updates than one holds: each tile has its turn all the same."""
    monkeypatch.setattr(live_updates, "MAX_TILES", 3)
    desk, wanted = Desk(), view()
    desk.drive(100)
    for _ in range(8):
        assert desk.look(wanted)["more"]
        desk.drive(20)
    assert len(desk.held) == 16


def test_an_update_has_4_mib_of_tiles_at_most_but_one_of_any_size(monkeypatch):
    desk, wanted = Desk(), view()
    desk.drive(100)
    desk.look(wanted)
    sizes = sorted(len(png) for _, png in desk.held.values())
    for most, count in ((sizes[0] - 1, 1), (sum(sizes) - 1, 15), (sum(sizes), 16)):
        monkeypatch.setattr(live_updates, "MAX_TILE_BYTES", most)
        desk.seen, desk.held = Seen(desk.live.now.life), {}
        message = desk.look(wanted)
        assert (len(message["tiles"]), message["more"]) == (count, count < 16)


def test_without_memory_for_tiles_they_come_later(monkeypatch):
    desk, wanted = Desk(), view()
    desk.drive(100)
    tile_of, left = desk.tiles.tile_of, [4]

    def short(*arguments):
        left[0] -= 1
        if left[0] < 0:
            raise Busy("no memory")
        return tile_of(*arguments)

    monkeypatch.setattr(desk.tiles, "tile_of", short)
    assert [len(desk.look(wanted)["tiles"]) for _ in range(2)] == [4, 0]
    left[0] = 100
    message = desk.look(wanted)
    assert (len(message["tiles"]), message["more"]) == (12, False)


def test_a_reset_is_told_first_and_alone():
    desk, wanted = Desk(), view()
    desk.drive(20)
    desk.look(wanted)
    desk.live.reset("second")
    desk.drive(3)
    message = desk.look(wanted)
    assert [message[name] for name in ("epoch", "run", "revision", "tiles", "more")] == [
        *("second", "run", 0, []),
        False,
    ]
    desk.held = {}
    assert desk.look(wanted)["revision"] == 3
    desk.check(wanted)


def test_cells_that_the_map_begins_with_are_sent():
    desk = Desk()
    grid = OccupancyGrid(GridSettings(0.1), "third", "run")
    grid.begin_with({"log_odds": np.full((300, 300), 900, np.int16)}, (-100, -100))
    desk.live.become(grid)
    desk.seen = Seen(desk.live.now.life)
    assert {revision for *_, revision, _ in desk.look(view())["tiles"]} == {0}
    desk.check(view())


class TestWhatAClientHas:
    """Of another view, or after it was away."""

    def test_since_it_was_away_it_gets_what_has_changed(self):
        desk = Desk()
        desk.drive(100)
        desk.look(view())
        desk.drive()
        back = view(since=100)
        desk.seen = Seen(desk.live.now.life).after_move(None, back, -1)
        assert 0 < len(desk.look(back)["tiles"]) < 16
        desk.check(view())

    @pytest.mark.parametrize("since", [0, 101, 2**62])
    def test_since_nothing_or_what_is_not_yet_it_gets_all(self, since):
        desk = Desk()
        desk.drive(100)
        desk.seen = Seen(desk.live.now.life).after_move(None, view(since=since), -1)
        desk.look(view(since=since))
        desk.check(view())

    def test_what_it_still_sees_is_not_sent_again(self):
        before, after = view([0, 0, 3, 1]), view([2, 1, 5, 4])
        seen = Seen(("e", "r"), 7, {Square(16, 2, 1): 9, Square(16, 0, 0): 9}).after_move(before, after, 4)
        assert [seen.revision_of(Square(16, *at)) for at in ((2, 1), (3, 1), (2, 2), (5, 4), (0, 0))] == [
            *(9, 7, 4, 4, 4),
        ]

    def test_of_another_level_or_palette_it_has_asked_for_all_itself(self):
        before = view([0, 0, 1, 1])
        for after in (view([0, 0, 1, 1], z=15), view([0, 0, 1, 1], palette="dark")):
            seen = Seen(("e", "r"), 7, {Square(16, 0, 0): 9}).after_move(before, after, 4)
            assert seen == Seen(("e", "r"), 4)

    def test_who_has_nothing_yet_gets_all_of_the_next_view(self):
        seen = Seen(("e", "r")).after_move(view([0, 0, 1, 1]), view([5, 5, 6, 6]), -1)
        assert seen == Seen(("e", "r"), -1)


class TestRobots:
    def test_where_they_are(self):
        desk = Desk()
        for robot in ("a", "b"):
            desk.receipts.scan_received(robot, "s", 0.0)
        desk.receipts.located("a", 17, Pose(1.0, 2.0, 3.0))
        desk.receipts.robot_alive("a", "1", True)
        assert desk.look(view())["robots"] == {"a": {"pose": [1.0, 2.0, 3.0], "stamp": 17, "alive": True}}
        desk.receipts.robot_alive("a", "1", False)
        desk.receipts.located("b", 18, Pose(0.0, 0.0, 0.0))
        assert [(name, robot["alive"]) for name, robot in desk.look(view())["robots"].items()] == []

    def test_who_is_gone_is_not_shown(self):
        receipts = Receipts()
        receipts.pose_received("a", 100.0)
        receipts.located("a", 17, Pose(1.0, 2.0, 3.0))
        assert list(receipts.places(100.0 + GONE_AFTER)) == ["a"]
        assert list(receipts.places(101.0 + GONE_AFTER)) == []


class TestScans:
    def note(self, desk, sensor="s", beams=3, **fields):
        ranges = np.arange(1, beams + 1, dtype=np.float32)
        desk.scans.note("r", sensor, Scan(5, -1.0, 0.25, 0.0, 9.0, ranges, **fields), Pose(1.0, 2.0, 0.5))

    def test_the_newest_of_every_sensor_for_who_wants_them(self):
        desk = Desk()
        self.note(desk, beams=7)
        self.note(desk)
        self.note(desk, "t")
        assert "scans" not in desk.look(view())
        scans = desk.look(view(scans=True))["scans"]
        assert list(scans) == ["r/s", "r/t"]
        assert scans["r/s"].pop("ranges") == np.array([1, 2, 3], "<f4").tobytes()
        assert scans["r/s"] == {
            "stamp": 5,
            "pose": [1.0, 2.0, 0.5],
            "angle_min": -1.0,
            "angle_increment": 0.25,
            "range_max": 9.0,
        }

    @pytest.mark.parametrize(("beams", "kept", "turn"), [(360, 360, 0.25), (361, 181, 0.5), (1081, 271, 1.0)])
    def test_long_ones_are_thinned(self, beams, kept, turn):
        desk = Desk()
        self.note(desk, beams=beams)
        (shown,) = desk.scans.of("first").values()
        assert (len(shown.ranges), shown.angle_increment) == (kept, turn)
        assert shown.ranges[:2].tolist() == [1.0, 1.0 + turn / 0.25]
        assert shown.ranges.base is None

    def test_of_many_sensors_those_heard_last(self):
        desk = Desk()
        for k in range(MAX_SOURCES + 10):
            self.note(desk, f"s{k}")
            self.note(desk, "s0")
        kept = desk.scans.of("first")
        assert len(kept) == MAX_SOURCES
        assert ("r", "s0") in kept
        assert ("r", "s10") not in kept

    def test_those_of_the_map_before_a_reset_are_not_shown(self):
        desk = Desk()
        self.note(desk)
        desk.live.reset("second")
        desk.look(view(scans=True))
        assert desk.look(view(scans=True))["scans"] == {}


GOOD = {"type": "view", "z": 16, "tiles": [0, 0, 1, 1]}


class TestDecoding:
    def test_what_is_not_said_is_as_usual(self):
        assert decode_view(msgpack.packb(GOOD)) == view([0, 0, 1, 1], palette="ros", rate=10.0, scans=False)
        whole = {**GOOD, "palette": "dark", "rate": 2, "scans": True, "since": 4}
        decoded = decode_view(msgpack.packb(whole))
        assert (decoded.palette, decoded.rate, decoded.scans, decoded.since) == ("dark", 2.0, True, 4)

    @pytest.mark.parametrize(
        ("changed", "said"),
        [
            ({"type": "hello"}, "type: "),
            ({"z": 9}, "z: "),
            ({"z": 17}, "z: "),
            ({"z": 16.0}, "z: "),
            ({"z": True}, "z: "),
            ({"z": None}, "z: "),
            ({"tiles": [0, 0, 1]}, "tiles: "),
            ({"tiles": [0, 0, 1, 1, 1]}, "tiles: "),
            ({"tiles": [0, 0, 1, 1.5]}, "tiles.3: "),
            ({"tiles": [0, 0, 1, "1"]}, "tiles.3: "),
            ({"tiles": [0, 0, 2**26, 0]}, "tiles.2: "),
            ({"tiles": [-(2**26), 0, 0, 0]}, "tiles.0: "),
            ({"tiles": [1, 0, 0, 0]}, "tiles: [x0, y0, x1, y1] with"),
            ({"tiles": [0, 1, 0, 0]}, "tiles: [x0, y0, x1, y1] with"),
            ({"tiles": [0, 0, 15, 16]}, "tiles: 256 at most"),
            ({"tiles": {"a": 1}}, "tiles: "),
            ({"palette": "pink"}, "palette: one of ros, "),
            ({"palette": 7}, "palette: "),
            ({"palette": "p" * 1000}, "palette: "),
            ({"rate": 0.1}, "rate: "),
            ({"rate": 20.5}, "rate: "),
            ({"rate": math.nan}, "rate: "),
            ({"rate": "10"}, "rate: "),
            ({"scans": 1}, "scans: "),
            ({"since": -1}, "since: "),
            ({"since": 2**63}, "since: "),
            ({"since": 1.0}, "since: "),
            ({"more": 1}, "more: "),
            ({"a\nb\x1b\u2028": 1}, "a?b??: "),
        ],
    )
    def test_anything_else_is_refused_and_its_field_named(self, changed, said):
        with pytest.raises(BadMessage) as refused:
            decode_view(msgpack.packb({**GOOD, **changed}))
        assert str(refused.value).startswith(said)
        assert len(str(refused.value)) < 300

    @pytest.mark.parametrize("name", GOOD)
    def test_what_is_missing_is_named(self, name):
        with pytest.raises(BadMessage, match=f"^{name}: "):
            decode_view(msgpack.packb({field: value for field, value in GOOD.items() if field != name}))

    @pytest.mark.parametrize(
        "payload", [b"", b"\xc1", b"\x80\x80", msgpack.packb([1]), b"\x91" * 60000, msgpack.packb({1: 2})]
    )
    def test_what_is_no_map_is_refused(self, payload):
        with pytest.raises(BadMessage):
            decode_view(payload)


def test_a_pushed_tile_is_a_picture():
    desk = Desk()
    desk.drive(5)
    *_, png = desk.look(view())["tiles"][0]
    with Image.open(io.BytesIO(png)) as picture:
        assert picture.size == (256, 256)
