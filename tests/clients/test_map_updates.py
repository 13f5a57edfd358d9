"""Map updates: a copy that takes them is the map, cell for cell; what is damaged or a lie is refused."""

import math
import random
from dataclasses import replace

import msgpack
import numpy as np
import pytest

from counts_model import Counts
from mutations import mutated
from ogm_client.errors import BadReply
from ogm_client.map_copy import MapCopy, Taken
from ogm_client.map_grid import MapGrid
from ogm_core.cells.classes import trinary
from ogm_core.cells.log_odds import PLANE, LogOdds
from ogm_core.cells.model import Plane
from ogm_core.cells.rate import Rate
from ogm_core.errors import BadMessage
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.tiles.polygon import Polygon
from ogm_core.types import Pose, Scan
from ogm_core.wire import map_update
from ogm_core.wire.map_changes import updates_of
from ogm_core.wire.map_update import decode_updates, encode_update

SECOND = 10**9
MUCH = 2**30
MODELS = pytest.mark.parametrize(
    "model", [LogOdds(), LogOdds("float64"), Counts(), Rate()], ids=["int16", "float64", "counts", "rate"]
)


def scan_at(stamp, rng, beams=24):
    return Scan(stamp, -math.pi, math.tau / beams, 0.1, 9.0, rng.uniform(0.5, 9.5, beams).astype(np.float32))


def message(snapshot, since=None):
    """What a mapper says to a copy that is at `since`, as bytes; None: of the whole map."""
    changed = ChangedTiles.since(snapshot.stored.tiles, since or 0)
    updates = updates_of(snapshot, changed, since or 0, whole=since is None)
    return b"".join(map(encode_update, updates))


def take(copy, payload, **options):
    return [copy.take(update, **options) for update in decode_updates(payload)]


def cells_of(snapshot):
    """The stored planes of the extent, bytes."""
    return {name: plane.tobytes() for name, plane in snapshot.stored.planes().items()}


def laid_out(copy):
    """The same of a copy."""
    newest, found = copy.newest, {}
    extent = newest.extent
    for plane in newest.planes:
        n = plane.side
        dense = np.zeros((extent.height * n, extent.width * n), plane.dtype)
        for (tx, ty), planes in copy.tiles.items():
            tile = planes[plane.name].reshape(64 * n, 64 * n)
            part = CellRect(64 * tx, 64 * ty, 64, 64).intersection(extent)
            x, y = (part.ix - 64 * tx) * n, (part.iy - 64 * ty) * n
            to_x, to_y = (part.ix - extent.ix) * n, (part.iy - extent.iy) * n
            w, h = part.width * n, part.height * n
            dense[to_y : to_y + h, to_x : to_x + w] = tile[y : y + h, x : x + w]
        found[plane.name] = dense.tobytes()
    return found


def assert_same(copy, snapshot):
    assert copy.version == (snapshot.epoch, snapshot.run, snapshot.revision)
    assert laid_out(copy) == cells_of(snapshot)
    assert (copy.newest.extent, copy.newest.stamp) == (snapshot.rect, snapshot.stamp)
    if isinstance(snapshot.model, Counts):
        return
    expected, grid = MapGrid.from_snapshot(snapshot.finest()), copy.grid()
    assert grid.log_odds.dtype == expected.log_odds.dtype
    if isinstance(snapshot.model, Rate):  # another program computes the same exponentials
        assert np.array_equal(grid.known, expected.known)
        classes = [trinary(each.probability, each.known) for each in (grid, expected)]
        assert np.array_equal(*classes)
        assert np.array_equal(classes[0], snapshot.finest().encode(trinary))
        np.testing.assert_allclose(grid.probability, expected.probability, rtol=0, atol=1e-7)
    else:
        assert np.array_equal(grid.log_odds, expected.log_odds, equal_nan=True)
    for name in ("resolution", "anchor", "offset", "epoch", "run", "revision", "stamp"):
        assert getattr(grid, name) == getattr(expected, name)


def new_grid(model, half_life=None, epoch="a"):
    settings = GridSettings(resolution=0.25, cell_model=model, half_life=half_life)
    return OccupancyGrid(settings, epoch, "run1")


def life(model, rng, half_life):
    """A map's changes, a snapshot after each: scans all around, erasures, resets, starts from cells."""
    grid, x, y, stamp = new_grid(model, half_life), 0.013, 0.007, 10**18
    for k in range(60):
        choice = rng.random()
        if choice < 0.06 and grid.rect.cells:
            left, low = x + rng.uniform(-9, 3), y + rng.uniform(-9, 3)
            area = Polygon([(left, low), (left + 6, low), (left + 3, low + 7)], grid.lattice)
            if grid.rect.intersection(area.rect).cells:
                grid.erase(area)
        elif choice < 0.1:
            grid.reset(f"epoch{k}")
            if isinstance(model, LogOdds) and rng.random() < 0.5:  # a map that begins with cells
                cells = rng.integers(-9, 9, (90, 70)) * 2 + 1
                stored = model.store(cells * 0.1, rng.random((90, 70)) < 0.5)
                grid.begin_with({PLANE: stored}, (-40, 5))
        else:
            x, y, stamp = x + rng.normal(0, 5), y + rng.normal(0, 5), stamp + SECOND
            grid.integrate(scan_at(stamp, rng), Pose(x, y, rng.uniform(-4, 4)))
        yield grid.snapshot()


@MODELS
@pytest.mark.parametrize("half_life", [None, 8.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_copy_is_the_map_at_every_revision_whatever_becomes_of_messages(model, half_life, seed):
    """Messages that are lost, repeated, and late; after a gap the copy asks, as a follower does."""
    if half_life is not None and not model.ticks_a_half_life:
        pytest.skip("this model does not forget")
    rng = np.random.default_rng(seed)
    copy, sent, seen, gaps, resets = MapCopy(MUCH), None, [], 0, 0
    truth = {}
    for snapshot in life(model, rng, half_life):
        truth[snapshot.epoch, snapshot.revision] = cells_of(snapshot)
        same = sent is not None and sent.epoch == snapshot.epoch
        resets += sent is not None and not same
        seen.append(message(snapshot, sent.revision if same else None))
        sent = snapshot
        now = [seen[-1]] if rng.random() > 0.2 else []
        if rng.random() < 0.3:
            now.append(seen[int(rng.integers(len(seen)))])
        rng.shuffle(now)
        for payload in now:
            for taken in take(copy, payload):
                assert taken is not Taken.PART
                if taken is Taken.GAP:
                    gaps += 1
                    mine = copy.version
                    since = mine.revision if mine is not None and mine.epoch == snapshot.epoch else None
                    assert take(copy, message(snapshot, since), asked=True) == [Taken.APPLIED]
            if copy.version is not None:
                assert laid_out(copy) == truth[copy.version.epoch, copy.version.revision]
        if copy.version is not None and copy.version[2] == snapshot.revision and same:
            assert_same(copy, snapshot)
    assert gaps
    assert resets
    take(copy, message(snapshot), asked=True)
    assert_same(copy, snapshot)


def test_an_update_holds_just_the_tiles_that_were_written_since(monkeypatch):
    grid, rng = new_grid(LogOdds()), np.random.default_rng(1)
    versions = []
    for k in range(12):
        grid.integrate(scan_at(10**18 + k, rng), Pose(40.0 * (k % 3), -40.0 * (k % 2), 0.0))
        versions.append(grid.snapshot())
    newest, older = versions[-1], versions[-2]
    (update,) = decode_updates(message(newest, older.revision))
    changed = {tuple(place) for place in update.tiles.tolist()}
    frame = older.rect.union(newest.rect)
    before, after = (v.stored.window(frame)[PLANE] for v in (older, newest))
    rows, columns = np.nonzero(before != after)
    differ = {((c + frame.ix) // 64, (r + frame.iy) // 64) for r, c in zip(rows, columns, strict=True)}
    assert differ <= changed
    assert len(changed) <= 9 < len(newest.stored.tiles.numbers.nonzero()[0])
    assert any(min(place) < 0 for place in changed)
    assert [len(u.tiles) for u in decode_updates(message(newest, newest.revision))] == [0]


def test_a_tick_changes_every_known_tile_and_only_those():
    grid, rng = new_grid(LogOdds(), half_life=4.0), np.random.default_rng(2)
    for k in range(5):
        grid.integrate(scan_at(10**18 + k, rng), Pose(30.0 * k, 0.0, 0.0))
    whole = grid.snapshot()
    grid.integrate(scan_at(10**18 + SECOND + 9, rng), Pose(0.0, 0.0, 0.0))
    assert grid.time.ticks == (6,)
    (all_of, since) = (next(decode_updates(message(grid.snapshot(), since))) for since in (None, 5))
    assert {*map(tuple, all_of.tiles.tolist())} == {*map(tuple, since.tiles.tolist())}
    assert len(since.tiles) > 9
    copy = MapCopy(MUCH)
    take(copy, message(whole))
    take(copy, message(grid.snapshot(), 5))
    assert_same(copy, grid.snapshot())


def test_what_is_large_comes_in_parts_which_count_together(monkeypatch):
    monkeypatch.setattr(map_update, "MAX_CELL_BYTES", 3 * 8192)
    grid, rng = new_grid(LogOdds()), np.random.default_rng(1)
    for k in range(5):
        grid.integrate(scan_at(10**18 + k, rng), Pose(30.0 * k, 0.0, 0.0))
    snapshot, copy = grid.snapshot(), MapCopy(MUCH)
    parts = list(decode_updates(message(snapshot)))
    assert len(parts) > 3
    assert {len(part.tiles) for part in parts[:-1]} == {3}
    for part in parts[:-1]:
        assert copy.take(part) is Taken.PART
        assert copy.version is None
    assert copy.take(parts[-1]) is Taken.APPLIED
    assert_same(copy, snapshot)
    other = MapCopy(MUCH)  # one of them is lost, or late
    for lost in ([0, 2], [1], [0, 2, 1, 3]):
        taken = [other.take(parts[k]) for k in lost]
        assert Taken.GAP in taken
        assert Taken.APPLIED not in taken
    assert other.version is None
    assert take(other, message(snapshot))[-1] is Taken.APPLIED


def test_parts_of_one_change_have_the_same_planes():
    """Else the first one says what the copy takes, and the others take more."""
    grid, copy = new_grid(LogOdds()), MapCopy(MUCH)
    grid.integrate(scan_at(10**18, np.random.default_rng(1)), Pose(0.5, 0.5, 0.0))
    (update,) = decode_updates(message(grid.snapshot()))
    wide = (Plane(PLANE, np.dtype("float64"), 2),)
    cells = {PLANE: np.zeros((len(update.tiles), 4 * 4096))}
    assert copy.take(replace(update, parts=2)) is Taken.PART
    assert copy.take(replace(update, parts=2, part=1, planes=wide, cells=cells)) is Taken.GAP
    assert copy.version is None


def test_a_life_that_was_left_is_not_taken_again_unless_asked_for():
    rng, copy = np.random.default_rng(3), MapCopy(MUCH)
    first, second = new_grid(LogOdds(), epoch="a"), new_grid(LogOdds(), epoch="b")
    for grid in (first, second):
        grid.integrate(scan_at(10**18, rng), Pose(0.0, 0.0, 0.0))
    late, now = message(first.snapshot()), message(second.snapshot())
    assert [take(copy, payload) for payload in (late, now, late)] == [
        [Taken.APPLIED],
        [Taken.APPLIED],
        [Taken.KNOWN],
    ]
    assert copy.version.epoch == "b"
    assert take(copy, late, asked=True) == [Taken.APPLIED]


def test_the_tiles_that_changed_are_told():
    grid, rng, copy = new_grid(LogOdds()), np.random.default_rng(3), MapCopy(MUCH)
    grid.integrate(scan_at(10**18, rng), Pose(0.5, 0.5, 0.0))
    take(copy, message(grid.snapshot()))
    seen = copy.version
    assert sorted(copy.changed_since(None)) == sorted(copy.tiles)
    assert copy.changed_since(seen) == []
    grid.integrate(scan_at(10**18, rng), Pose(200.5, 0.5, 0.0))
    take(copy, message(grid.snapshot(), 1))
    changed = copy.changed_since(seen)
    assert changed
    assert all(tx > 9 for tx, _ in changed)
    assert sorted(copy.changed_since(seen._replace(epoch="other"))) == sorted(copy.tiles)


def test_a_grid_that_is_written_over_leaves_the_copy_as_it_is():
    grid, rng, copy = new_grid(LogOdds()), np.random.default_rng(3), MapCopy(MUCH)
    grid.integrate(scan_at(10**18, rng), Pose(0.5, 0.5, 0.0))
    take(copy, message(grid.snapshot()))
    copy.grid().log_odds[:] = 7.0
    assert_same(copy, grid.snapshot())


def test_a_copy_is_bounded():
    grid, rng = new_grid(LogOdds()), np.random.default_rng(3)
    grid.integrate(scan_at(10**18, rng), Pose(0.5, 0.5, 0.0))
    payload = message(grid.snapshot())
    (update,) = decode_updates(payload)
    needed = len(update.tiles) * (8192 + 256)
    take(MapCopy(needed), payload)
    with pytest.raises(BadReply, match=f"takes {needed} bytes, at most {needed - 1} are allowed"):
        take(MapCopy(needed - 1), payload)
    copy = MapCopy(needed)
    copy.take(replace(update, extent=CellRect(0, 0, 10**6, 10**6)))
    with pytest.raises(BadReply, match="4000000000000 bytes"):
        copy.grid()


def test_counts_in_other_planes_are_refused():
    grid, rng, copy = new_grid(Rate()), np.random.default_rng(3), MapCopy(MUCH)
    grid.integrate(scan_at(10**18, rng), Pose(0.5, 0.5, 0.0))
    (update,) = decode_updates(message(grid.snapshot()))
    copy.take(replace(update, planes=update.planes[:3]))
    with pytest.raises(BadReply, match="in other planes than known here: N, C, F"):
        copy.grid()


def test_what_a_client_cannot_read_it_says():
    grid, rng, copy = new_grid(Counts()), np.random.default_rng(3), MapCopy(MUCH)
    grid.integrate(scan_at(10**18, rng), Pose(0.5, 0.5, 0.0))
    take(copy, message(grid.snapshot()))
    with pytest.raises(BadReply, match="can be read, not cells of 'Counts'"):
        copy.grid()


def fields():
    grid, rng = new_grid(LogOdds()), np.random.default_rng(3)
    grid.integrate(scan_at(10**18, rng), Pose(0.5, 0.5, 0.0))
    return msgpack.unpackb(message(grid.snapshot()))


PLANE_TOLD = {"name": PLANE, "dtype": "int16", "per_side": 1}
LIES = {
    "epoch": [None, 5, "a\n", "é"],
    "run": [None],
    "prev": [-1, 1.5, True, None, 2**63, 2],
    "revision": [-1, None, "1"],
    "whole": [None, 1],
    "part": [-1, 1, None],
    "parts": [0, 2**21, None],
    "stamp": ["now", -1],
    "resolution": [0.0, math.nan, math.inf, "0.05", True, None, -1.0],
    "anchor": [None, [0.0], [0.0, math.nan], ["a", "b"]],
    "tile": [32, None],
    "planes": [
        [],
        None,
        [PLANE_TOLD] * 2,
        [PLANE_TOLD | {"dtype": "object"}],
        [PLANE_TOLD | {"per_side": True}],
        [PLANE_TOLD | {"per_side": 3}],
        [PLANE_TOLD | {"dtype": "int64"}],
        [{"name": PLANE}],
        ["a"],
    ],
    "model": [None, {}, {"name": 3}, {"name": PLANE, "l0": math.nan}, {"name": PLANE, "l0": [1]}],
    "extent_cells": [None, [0, 0, 1], [0, 0, -1, 1], [0, 0, 2**60, 1], [0.0, 0, 1, 1]],
    "tiles": [None, b"1", b"", bytes(32), (2**50).to_bytes(8, "little") * 2],
    "data": [None, b"", b"x", "text"],
}


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, values in LIES.items() for value in values]
)
def test_a_field_that_is_wrong_is_named(name, value):
    told = fields()
    said = {"tiles": "tiles|data", "planes": "planes|data", "parts": "part"}.get(name, f"^{name}")
    with pytest.raises(BadMessage, match=said):
        list(decode_updates(msgpack.packb(told | {name: value})))


def test_nothing_is_inflated_beyond_what_the_tiles_take():
    told = fields()
    bomb = map_update.isal_zlib.compress(bytes(2**26), 1)
    with pytest.raises(BadMessage, match="data: it is not"):
        list(decode_updates(msgpack.packb(told | {"data": bomb})))
    many = np.arange(2 * 2049, dtype="<i8").tobytes()
    with pytest.raises(BadMessage, match="more than the 16777216 of a message"):
        list(decode_updates(msgpack.packb(told | {"tiles": many})))


def test_damaged_bytes_are_refused_and_nothing_else_happens():
    payload, rng = message_of_one_scan(), random.Random(1)
    for _ in range(1500):
        damaged = mutated(rng, payload)
        try:
            updates = list(decode_updates(damaged))
        except BadMessage:
            continue
        for update in updates:
            assert update.cells.keys() == {plane.name for plane in update.planes}


def message_of_one_scan():
    return msgpack.packb(fields())


@pytest.mark.parametrize("cut", [1, 40, -1])
def test_a_message_that_is_cut_short_is_refused(cut):
    payload = message_of_one_scan()
    with pytest.raises(BadMessage, match="not MessagePack"):
        list(decode_updates(payload + payload[:cut]))
    assert list(decode_updates(b"")) == []
