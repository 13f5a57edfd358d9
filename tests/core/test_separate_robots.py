"""Maps that keep robots apart: the sum is the map of all scans, and less a robot that of all others'."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadSetting, LimitReached, NoRoom, UnknownRobot
from ogm_core.files.map_files import PALETTES, VALUES, encode_json, encode_npz, encode_pgm, encode_png
from ogm_core.grid import OccupancyGrid
from ogm_core.lattice import Region
from ogm_core.separate_grid import SeparateGrid, grid_of
from ogm_core.shares import Cuts, Share
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.tiles.checkpoint import NOBODY
from ogm_core.tiles.halved import tiled
from ogm_core.tiles.polygon import Polygon
from ogm_core.tiles.pyramid import Square, TilePyramid
from separate_maps import (
    WHERE,
    assert_same_cells,
    in_some_order,
    mapped,
    plain,
    planes_of,
    scans_of,
    settings_with,
)

BOUNDS = Region(-6.4, -3.2, 9.6, 6.4)
KINDS = {
    "unbounded": {},
    "clipped": {"bounds": BOUNDS},
    "dropped": {"bounds": BOUNDS, "outside": "drop"},
}
EVERYWHERE = pytest.mark.parametrize("changes", KINDS.values(), ids=KINDS)


def bodies(grid):
    """What routes answer with, but for the map's identity."""
    whole = replace(grid.snapshot(), epoch="", run="", revision=0, stamp=None, erasures=0)
    for snapshot in (whole, whole.finest()):
        yield encode_npz(snapshot)
        yield from (encode_png(snapshot, palette) for palette in PALETTES)
        yield from (encode_json(snapshot, "hall", values) for values in VALUES)
        yield encode_pgm(snapshot)
        yield snapshot.known_cells
    fine = whole.finest()
    for z, x, y in itertools.product((14, 16), range(-3, 3), range(-3, 3)):
        yield TilePyramid().pixels(tiled(fine.stored), fine.model, Square(z, x, y)).tobytes()


def test_settings_choose_the_kind_of_map():
    assert type(grid_of(settings_with())) is SeparateGrid
    assert type(grid_of(plain(settings_with()))) is OccupancyGrid


@EVERYWHERE
def test_the_sum_is_the_map_of_all_scans_in_whatever_order(changes):
    settings = settings_with(**changes)
    whole = mapped(plain(settings), *WHERE)
    for seed in (1, 2, 3):
        grid = mapped(settings, *WHERE, seed=seed)
        assert grid.robots == (("a", "b") if "bounds" in changes else ("a", "b", "c"))
        assert_same_cells(grid, whole)
        assert (grid.revision, grid.cell_updates) == (whole.revision, whole.cell_updates)
    assert list(bodies(grid)) == list(bodies(whole))


@EVERYWHERE
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("gone", ["a", "b", "c"])
def test_less_a_robot_it_is_the_map_of_the_others_byte_for_byte(changes, gone, seed):
    settings = settings_with(**changes)
    grid = mapped(settings, *WHERE, seed=seed)
    if gone not in grid.robots:
        return
    revision = grid.revision
    grid.forget(gone)
    others = sorted(WHERE.keys() - {gone})
    assert (grid.revision, grid.erasures) == (revision + 1, 1)
    assert gone not in grid.robots
    for expected in (mapped(settings, *others), mapped(plain(settings), *others)):
        assert_same_cells(grid, expected)
        assert list(bodies(grid)) == list(bodies(expected))


def test_less_every_robot_there_is_nothing_but_what_the_map_began_with():
    empty = mapped(settings_with(), "a", "b")
    begun = begun_with(settings_with())
    mapped(begun.settings, "a", "b", grid=begun)
    for robot in ("a", "b"):
        empty.forget(robot)
        begun.forget(robot)
    assert empty.rect.cells == 0
    assert empty.snapshot().empty
    assert_same_cells(begun, begun_with(plain(settings_with())))
    assert begun.rect.cells > 1000


def begun_with(settings, scale=1):
    """A map that begins with what robot c has seen, or `scale` times that, up to the most."""
    whole = mapped(plain(settings), "c")
    most = {name: np.iinfo(cells.dtype).max for name, cells in planes_of(whole).items()}
    planes = {
        name: np.minimum(cells.astype(np.int64) * scale, most[name]).astype(cells.dtype)
        for name, cells in planes_of(whole).items()
    }
    grid = grid_of(settings, "e", "r")
    grid.begin_with(planes, whole.snapshot().offset)
    return grid


def test_counts_that_have_stopped_are_right_again_without_a_robot():
    """A start map whose counts are nearly the most that planes hold, where the robots drive as well."""
    settings = settings_with()
    both, one = (begun_with(settings, scale=2 * 10**8) for _ in range(2))
    full = {name: cells == np.iinfo(cells.dtype).max for name, cells in planes_of(both).items()}
    assert all(full[name].any() for name in "FEH")
    mapped(settings, "c", "a", grid=both)
    mapped(settings, "c", grid=one)
    both.forget("a")
    assert_same_cells(both, one)
    both.forget("c")
    assert_same_cells(both, begun_with(plain(settings), scale=2 * 10**8))


def test_only_tiles_of_the_robot_get_the_new_revision():
    grid = mapped(settings_with(), *WHERE)
    whose = {robot: tiles_of(mapped(settings_with(), robot)) for robot in WHERE}
    before = grid.snapshot().stored.tiles
    grid.forget("c")
    after = grid.snapshot().stored.tiles
    changed = ChangedTiles.since(after, before.revision)
    assert set(map(tuple, changed.places.tolist())) == whose["c"]
    assert not whose["c"] & (whose["a"] | whose["b"])
    grid.forget("a")
    changed = ChangedTiles.since(grid.snapshot().stored.tiles, after.revision)
    assert set(map(tuple, changed.places.tolist())) == whose["a"]
    assert whose["a"] & whose["b"]


def tiles_of(grid):
    return {(tile.tx, tile.ty) for tile in grid.checkpoint().tiles_since(0)}


def test_what_a_robot_alone_has_seen_takes_no_memory_without_it():
    """And counts again when it is seen again."""
    settings = settings_with()
    grid, others = mapped(settings, *WHERE), mapped(settings, "a", "b")
    whole = grid.nbytes
    sum_of = OccupancyGrid.nbytes.fget
    tables = sum_of(grid) - grid._store.tiles_used * grid._store.tile_bytes
    grid.forget("c")
    assert grid._store.tiles_used == others._store.tiles_used
    assert sum_of(grid) == tables + others._store.tiles_used * others._store.tile_bytes
    assert np.count_nonzero(grid._store.touched) == grid._store.tiles_used
    assert_same_cells(grid, others)
    mapped(settings, "c", grid=grid)
    assert_same_cells(grid, mapped(settings, *WHERE))
    assert grid.nbytes == whole
    copy = grid.snapshot().stored.tiles
    assert tiles_of(grid) == tiles_of(mapped(settings, *WHERE))
    assert ChangedTiles.since(copy, copy.revision).places.size == 0


def test_a_robot_that_comes_again_is_a_new_one():
    settings = settings_with()
    grid = mapped(settings, "a", "b")
    grid.forget("a")
    mapped(settings, "a", grid=grid)
    assert_same_cells(grid, mapped(settings, "a", "b"))
    since = {state.robot: state.since for state in grid.checkpoint().state.robots}
    assert since == {"b": pytest.approx(1, abs=9), "a": 11}


def test_a_robot_that_is_not_there_is_refused_with_the_names_of_those_that_are():
    grid = mapped(settings_with(), "b", "a")
    for name, said in (
        ("x", "robot x: it is not in the map; there are: a, b"),
        (NOBODY, "robot : it is not in the map; there are: a, b"),
        ("y" * 200, f"robot {'y' * 100}...: it is not in the map; there are: a, b"),
    ):
        with pytest.raises(UnknownRobot) as refused:
            grid.forget(name)
        assert str(refused.value) == said
    assert grid.revision == 10
    with pytest.raises(UnknownRobot, match=r"there are: none$"):
        grid_of(settings_with()).forget("a")


class Life:
    """A map that keeps robots apart, and what has become of it, event by event."""

    def __init__(self, settings, seed):
        self.grid = grid_of(settings, "e", "r")
        self.settings = settings
        self.rng = np.random.default_rng(seed)
        self.events = []
        self.scans = {robot: itertools.cycle(list(scans_of(robot, 9, 24))) for robot in WHERE}

    def step(self):
        roll = self.rng.random()
        if roll < 0.75:
            event = next(self.scans[self.rng.choice(list(WHERE))])
            self.grid.integrate(*event[1:], None, event[0])
            self.events.append(event)
        elif roll < 0.87 and self.grid.rect.cells:
            x, y = self.rng.uniform(-14.0, 6.0, 2)
            event = Polygon([(x, y), (x + 5.0, y - 1.0), (x + 1.0, y + 6.0)], self.grid.lattice)
            if event.rect.intersection(self.grid.rect).cells:
                self.grid.erase(event)
                self.events.append(event)
        elif self.grid.robots:
            gone = self.rng.choice(self.grid.robots)
            self.grid.forget(gone)
            self.events = [event for event in self.events if isinstance(event, Polygon) or event[0] != gone]

    def stored_and_restored(self):
        checkpoint = self.grid.checkpoint()
        self.grid = grid_of(self.settings, "another")
        self.grid.restore(checkpoint.state, checkpoint.tiles_since(0))

    def expected(self):
        """The map of one process without robots that has seen the same, but for those that are gone."""
        grid = OccupancyGrid(plain(self.settings))
        for event in self.events:
            if not isinstance(event, Polygon):
                grid.integrate(*event[1:])
            elif event.rect.intersection(grid.rect).cells:
                grid.erase(event)
        return grid


@pytest.mark.parametrize("seed", range(6))
def test_whatever_becomes_of_it_the_map_is_that_of_what_is_left(seed):
    life = Life(settings_with(resolution=0.25), seed)
    for n in range(60):
        life.step()
        if n % 7 == 3:
            before = life.grid.snapshot().meta()
            life.stored_and_restored()
            assert life.grid.snapshot().meta() == {**before, "run": ""}
        if n % 10 == 9:
            assert_same_cells(life.grid, life.expected())


@EVERYWHERE
def test_a_checkpoint_is_the_map_and_goes_on_as_the_map(changes):
    settings = settings_with(**changes)
    grid, again = mapped(settings, "a", "b"), grid_of(settings, "another")
    checkpoint = grid.checkpoint()
    again.restore(checkpoint.state, checkpoint.tiles_since(0))
    assert_same_cells(grid, again)
    assert (again.nbytes, again.robots) == (grid.nbytes, grid.robots)
    for of in (grid, again):
        mapped(settings, "c", "a", grid=of)
        of.forget("a")
    assert_same_cells(grid, again)
    assert again.snapshot().meta() == {**grid.snapshot().meta(), "run": ""}


def test_checkpoints_hold_what_has_changed_since_and_come_ahead_of_the_writer():
    settings = settings_with()
    grid = mapped(settings, *WHERE)
    first = grid.checkpoint()
    kept = {(tile.robot, tile.tx, tile.ty): tile for tile in first.tiles_since(0)}
    assert grid.uncopied_bytes == 0
    robot, scan, pose = next(scans_of("a"))
    grid.integrate(scan, pose, None, robot)
    assert grid.uncopied_bytes > 0
    for ahead in grid.copies_ahead():
        grid.take_ahead(ahead, ahead.made())
    assert grid.uncopied_bytes == 0
    second = grid.checkpoint(grid.room_for_checkpoint()())
    changed = {(tile.robot, tile.tx, tile.ty): tile for tile in second.tiles_since(first.state.revision)}
    assert {robot for robot, _, _ in changed} == {"a"}
    assert grid.kept_bytes >= (len(kept) + len(changed)) * 38 * 64 * 64
    grid.forget("b")
    third = grid.checkpoint()
    # Those of others that the robot wrote into, too, are of the new revision: the map's are.
    more = {(tile.robot, tile.tx, tile.ty): tile for tile in third.tiles_since(second.state.revision)}
    of_b = {name[1:] for name in kept if name[0] == "b"}
    assert more.keys() == {name for name in kept | changed if name[0] != "b" and name[1:] in of_b}
    kept = {name: tile for name, tile in (kept | changed | more).items() if name[0] != "b"}
    again = grid_of(settings)
    again.restore(third.state, sorted(kept.values(), key=lambda tile: tile.robot))
    assert_same_cells(grid, again)


def test_tiles_of_a_robot_that_is_not_in_the_map_are_refused():
    checkpoint = mapped(settings_with(), "a", "b").checkpoint()
    state = checkpoint.state._replace(robots=checkpoint.state.robots[:1])
    with pytest.raises(IndexError, match=f"robot '{checkpoint.state.robots[1].robot}'"):
        grid_of(settings_with()).restore(state, checkpoint.tiles_since(0))


def test_a_reset_forgets_robots():
    grid = mapped(settings_with(), "a")
    grid.reset("f")
    assert (grid.robots, grid.rect.cells, grid.kept_bytes) == ((), 0, 0)
    assert_same_cells(mapped(settings_with(), "b", grid=grid), mapped(settings_with(), "b"))


def test_the_limit_of_bytes_counts_all_planes_and_a_refused_scan_changes_none():
    whole = mapped(settings_with(), *WHERE)
    tile, least = 38 * 64 * 64, mapped(settings_with(), "a").nbytes
    for limit in range(least, whole.nbytes - 9 * tile, 11 * tile + 999):
        grid = grid_of(settings_with(max_bytes=limit), "e", "r")
        taken, refused = [], []
        for robot, scan, pose in in_some_order(*WHERE):
            before = planes_of(grid), grid.robots, grid.revision
            try:
                grid.integrate(scan, pose, None, robot)
                taken.append((robot, scan, pose))
            except NoRoom as refusal:
                refused.append(str(refusal))
                np.testing.assert_equal((planes_of(grid), grid.robots, grid.revision), before)
            assert grid.nbytes <= limit
        assert refused
        assert all(f"mapper.max_bytes = {limit} has no room" in said for said in refused)
        expected = grid_of(settings_with(), "e", "r")
        for robot, scan, pose in taken:
            expected.integrate(scan, pose, None, robot)
        assert_same_cells(grid, expected)
        checkpoint = grid.checkpoint()
        grid_of(settings_with(max_bytes=grid.nbytes)).restore(checkpoint.state, checkpoint.tiles_since(0))
        for less in (grid.nbytes - 1, grid.nbytes // 2):
            with pytest.raises(LimitReached, match=f"bytes are more than max_bytes = {less}"):
                grid_of(settings_with(max_bytes=less)).restore(checkpoint.state, checkpoint.tiles_since(0))


def test_a_map_to_begin_with_counts_twice_in_the_limit():
    begun = begun_with(settings_with())
    assert begun.nbytes > 1.9 * begun_with(plain(settings_with())).nbytes
    with pytest.raises(LimitReached, match="bytes are more than max_bytes"):
        begun_with(settings_with(max_bytes=begun.nbytes - 1))
    assert begun_with(settings_with(max_bytes=begun.nbytes)).robots == ()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"cell_model": LogOdds()},
            r"^mapper\.separate_robots: .* log_odds do not add up.*map\.cell_model rate",
        ),
        ({"half_life": 60.0}, r"^mapper\.separate_robots: with map\.half_life .* leave out one of the two$"),
        ({"share": Share(Cuts((0.0,)), 0)}, r"^mapper\.separate_robots: a map that is cut does not keep"),
    ],
)
def test_what_does_not_go_together_is_refused(changes, said):
    with pytest.raises(BadSetting, match=said):
        settings_with(**changes)
