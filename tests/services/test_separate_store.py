"""Maps on disk that keep robots apart: format 3, robots that go and come again, what damage leaves."""

import shutil
import sqlite3
from contextlib import closing

import pytest

from ogm_core.cells.rate import Rate
from ogm_core.errors import BadSetting, BadStore
from ogm_core.separate_grid import grid_of
from ogm_core.tiles.polygon import Polygon
from ogm_services.commands.repair import report as told
from ogm_services.mapper.storage.map_store import MapStore
from ogm_services.mapper.storage.repair import repair
from separate_maps import assert_same_cells, mapped, plain, planes_of, scans_of, settings_with
from stored_maps import saved

SETTINGS = settings_with()


def commit(store, grid):
    store.commit(grid.checkpoint(), grid.settings, "run1", {})


def stored(folder, *robots, settings=SETTINGS):
    """A map that is stored in a folder, which it returns."""
    grid = mapped(settings, *robots)
    with MapStore(folder) as store:
        commit(store, grid)
    return grid


def restored(folder, settings=SETTINGS):
    with MapStore(folder) as store:
        return store.restore(settings).grid


def version_of(path):
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute("PRAGMA user_version").fetchone()[0]


def change(folder, *statements):
    with closing(sqlite3.connect(folder / "map.sqlite", isolation_level=None)) as connection:
        for statement in statements:
            connection.execute(statement)


def rows_of(folder):
    with closing(sqlite3.connect(folder / "map.sqlite")) as connection:
        return rows_in(connection)


def rows_in(connection):
    return sorted(connection.execute("SELECT robot, tx, ty, revision FROM tiles"))


def assert_equal(found, grid):
    """Equal maps, their robots and all that is told of them."""
    assert_same_cells(found, grid)
    assert found.snapshot().meta() == {**grid.snapshot().meta(), "run": ""}
    assert (found.robots, found.cell_updates) == (grid.robots, grid.cell_updates)


def test_the_map_is_restored_and_goes_on(tmp_path):
    grid = stored(tmp_path, "a", "b")
    found = restored(tmp_path)
    assert_equal(found, grid)
    assert (version_of(tmp_path / "map.sqlite"), found.nbytes) == (3, grid.nbytes)
    for of in (grid, found):
        mapped(SETTINGS, "c", grid=of)
        of.forget("b")
    assert_equal(found, grid)


def test_maps_of_the_other_kinds_are_stored_as_before(tmp_path):
    """Byte for byte: what keeps robots apart is in no other file."""
    stored(tmp_path / "counts", "a", settings=plain(SETTINGS))
    path = tmp_path / "counts" / "map.sqlite"
    assert version_of(path) == 1
    with closing(sqlite3.connect(path)) as connection:
        assert "robot" not in "".join(
            row[0] for row in connection.execute("SELECT sql FROM sqlite_master WHERE sql")
        )
        texts = [
            connection.execute(f"SELECT text FROM {name}").fetchone()[0] for name in ("state", "settings")
        ]
    assert not any("robots" in text for text in texts)


def test_what_a_forgotten_robot_has_written_goes_with_the_next_commit(tmp_path):
    grid = mapped(SETTINGS, "a", "b", "c")
    with MapStore(tmp_path) as store:
        commit(store, grid)
        everything = rows_in(store._connection)
        grid.forget("b")
        writes = []
        store._connection.set_trace_callback(writes.append)
        commit(store, grid)
        assert sum(text == "COMMIT" for text in writes) == 1
        assert store.holds(grid.checkpoint())
    left = {row[:3]: row[3] for row in rows_of(tmp_path)}
    assert left.keys() == {row[:3] for row in everything if row[0] != "b"}
    of_b = {row[1:3] for row in everything if row[0] == "b"}
    # The map's tiles in which b had counted are of the new revision, and so is what they are the sums of.
    assert {name for name, revision in left.items() if revision == 16} == {
        name for name in left if name[1:] in of_b
    }
    assert_equal(restored(tmp_path), grid)
    assert_same_cells(restored(tmp_path), mapped(SETTINGS, "a", "c"))


def test_a_robot_that_has_come_again_between_two_commits_is_the_new_one(tmp_path):
    grid = mapped(SETTINGS, "a", "b")
    with MapStore(tmp_path) as store:
        commit(store, grid)
        grid.forget("b")
        robot, scan, pose = next(scans_of("b"))
        grid.integrate(scan, pose, None, robot)
        commit(store, grid)
    assert_equal(restored(tmp_path), grid)
    expected = mapped(SETTINGS, "a")
    expected.integrate(scan, pose, None, robot)
    assert_same_cells(restored(tmp_path), expected)


def test_a_commit_that_fails_leaves_the_robot_in_and_the_next_one_leaves_it_out(tmp_path):
    grid = mapped(SETTINGS, "a", "b")
    with MapStore(tmp_path) as store:
        commit(store, grid)
        (tmp_path / "map.sqlite").rename(tmp_path / "away")
        grid.forget("b")
        with pytest.raises(Exception, match="moved, deleted or replaced"):
            commit(store, grid)
        (tmp_path / "away").rename(tmp_path / "map.sqlite")
        copy = tmp_path / "copy"
        copy.mkdir()
        for name in ("map.sqlite", "map.sqlite-wal"):
            shutil.copy(tmp_path / name, copy)
        assert_same_cells(restored(copy), mapped(SETTINGS, "a", "b"))
        commit(store, grid)
    assert_same_cells(restored(tmp_path), mapped(SETTINGS, "a"))


def test_erased_cells_and_a_reset_are_stored(tmp_path):
    grid = mapped(SETTINGS, "a", "b")
    with MapStore(tmp_path) as store:
        commit(store, grid)
        grid.erase(Polygon([(-2.0, -2.0), (3.0, -2.0), (3.0, 3.0)], grid.lattice))
        commit(store, grid)
    assert_equal(restored(tmp_path), grid)
    with MapStore(tmp_path) as store:
        store.restore(SETTINGS)
        grid.reset("f")
        mapped(SETTINGS, "c", grid=grid)
        commit(store, grid)
    assert_equal(restored(tmp_path), grid)
    assert {row[0] for row in rows_of(tmp_path)} == {"c"}


def test_snapshots_keep_robots_apart_too(tmp_path):
    grid = mapped(SETTINGS, "a", "b")
    with MapStore(tmp_path) as store:
        commit(store, grid)
        store.save("both")
        grid.forget("b")
        commit(store, grid)
        store.save("one")
        both, one = (saved(store, name, SETTINGS) for name in ("both", "one"))
        with store.snapshots.opened("both") as snapshot:
            assert snapshot.nbytes == 2 * snapshot.state.tiles * 38 * 64 * 64
    assert version_of(tmp_path / "snapshots" / "both.sqlite") == 3
    assert_same_cells(both, mapped(SETTINGS, "a", "b"))
    assert_same_cells(one, mapped(SETTINGS, "a"))
    both.forget("b")
    assert_same_cells(both, one)


def test_what_the_map_began_with_is_stored_as_nobodys(tmp_path):
    whole = mapped(plain(SETTINGS), "c")
    grid = grid_of(SETTINGS, "e", "r")
    grid.begin_with(planes_of(whole), whole.snapshot().offset)
    mapped(SETTINGS, "a", grid=grid)
    with MapStore(tmp_path) as store:
        commit(store, grid)
    found = restored(tmp_path)
    assert_equal(found, grid)
    assert {row[0] for row in rows_of(tmp_path)} == {"", "a"}
    found.forget("a")
    assert_same_cells(found, whole)


@pytest.mark.parametrize("kept_apart", [True, False])
def test_a_store_of_the_other_kind_is_refused_by_the_settings_name(tmp_path, kept_apart):
    kinds = SETTINGS, plain(SETTINGS)
    stored(tmp_path, "a", settings=kinds[not kept_apart])
    with MapStore(tmp_path) as store, pytest.raises(BadSetting) as refused:
        store.restore(kinds[kept_apart])
    now, there = ("false", "true") if kept_apart else ("true", "false")
    assert f"other settings: mapper.separate_robots is {now}, and there {there}: give those" in str(
        refused.value
    )


def test_a_tile_that_is_given_to_another_robot_is_seen(tmp_path):
    stored(tmp_path, "a", "c")
    change(
        tmp_path,
        "UPDATE tiles SET robot = 'a' WHERE rowid = (SELECT max(rowid) FROM tiles WHERE robot = 'c')",
    )
    with (
        MapStore(tmp_path) as store,
        pytest.raises(BadStore, match=r"tile \(.*\) of robot a: its digest is another"),
    ):
        store.restore(SETTINGS)


def test_robots_rows_that_are_missing_are_seen(tmp_path):
    stored(tmp_path, "a", "c")
    change(tmp_path, "DELETE FROM tiles WHERE robot = 'c'")
    with MapStore(tmp_path) as store, pytest.raises(BadStore, match="missing, or older than the rest"):
        store.restore(SETTINGS)


def test_a_whole_store_is_saved_as_it_is(tmp_path):
    grid = stored(tmp_path / "map", "a", "b")
    assert repair(tmp_path / "map", tmp_path / "new").exact
    found = restored(tmp_path / "new")
    assert_same_cells(found, grid)
    assert (found.robots, version_of(tmp_path / "new" / "map.sqlite")) == (("a", "b"), 3)
    found.forget("a")
    assert_same_cells(found, mapped(SETTINGS, "b"))


@pytest.mark.parametrize("without_state", [False, True])
def test_a_damaged_tile_is_lost_of_its_robot_alone(tmp_path, without_state):
    grid = stored(tmp_path / "map", "a", "b")
    rows = rows_of(tmp_path / "map")
    both = {row[1:3] for row in rows if row[0] == "a"} & {row[1:3] for row in rows if row[0] == "b"}
    tx, ty = sorted(both)[0]
    change(tmp_path / "map", f"UPDATE tiles SET record = x'00' WHERE robot = 'b' AND tx = {tx} AND ty = {ty}")
    if without_state:
        change(tmp_path / "map", "UPDATE state SET text = '{}'")
    repaired = repair(tmp_path / "map", tmp_path / "new")
    left, bottom = grid.lattice.corner_of(64 * tx, 64 * ty)
    assert repaired.damaged == (pytest.approx((left, bottom, left + 6.4, bottom + 6.4)),)
    assert "what was known of one robot or more is lost, x and y" in "\n".join(
        told(repaired, tmp_path / "new")
    )
    found = restored(tmp_path / "new")
    assert found.robots == ("a", "b")
    found.forget("b")
    assert_same_cells(found, mapped(SETTINGS, "a"))
    other = restored(tmp_path / "new")
    other.forget("a")
    expected = mapped(SETTINGS, "b")
    x, y = ((at + 0.001, at + 6.399) for at in (left, bottom))
    corners = [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])]
    expected.erase(Polygon(corners, grid.lattice))
    assert_same_cells(other, expected)


def test_rates_alone_do_not_choose_the_format(tmp_path):
    grid = mapped(settings_with(separate_robots=False, cell_model=Rate()), "a")
    with MapStore(tmp_path) as store:
        commit(store, grid)
        grid.erase(Polygon([(-2.0, -2.0), (3.0, -2.0), (3.0, 3.0)], grid.lattice))
        commit(store, grid)
    assert version_of(tmp_path / "map.sqlite") == 2
