"""`ogm repair`: what is intact goes into a new store, and what is not is told."""

import errno
import os
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from counts_model import Counts
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.errors import BadInput, BadStore
from ogm_core.lattice import Region
from ogm_services.cli import app
from ogm_services.mapper.storage.folder_lock import StoreInUse
from ogm_services.mapper.storage.map_store import MapStore
from ogm_services.mapper.storage.repair import repair
from stored_maps import Story, fingerprint, grid_of, saved


def stored(folder, model=None, **changes):
    """A store of eight scans, closed; its story."""
    with MapStore(folder) as store:
        story = Story(store, grid_of(model, **changes))
        story.integrate(8)
        story.commit()
        store.save("one")
    return story


@pytest.fixture
def story(tmp_path):
    return stored(tmp_path / "map")


def change(folder, *statements):
    connection = sqlite3.connect(folder / "map.sqlite")
    for statement in statements:
        connection.execute(*statement)
    connection.commit()
    connection.close()


def opened(folder, settings):
    with MapStore(folder) as store:
        return store.restore(settings)


def assert_saved(story, found, lost):
    """The map under a new epoch, but for these tiles' cells, which are unknown."""
    assert found.grid.epoch not in {story.grid.epoch, ""}
    expected = story.grid.snapshot()
    resolution, anchor = expected.lattice.resolution, expected.lattice.anchor
    planes = {name: cells.copy() for name, cells in expected.stored.planes().items()}
    sides = {plane.name: plane.side for plane in story.grid.model.planes}
    for tx, ty in lost:
        x, y = 64 * tx - expected.offset[0], 64 * ty - expected.offset[1]
        for name, cells in planes.items():
            n = sides[name]
            cells[max(y, 0) * n : max(y + 64, 0) * n, max(x, 0) * n : max(x + 64, 0) * n] = 0
    saved = found.grid.snapshot()
    x, y = saved.offset[0] - expected.offset[0], saved.offset[1] - expected.offset[1]
    for name, cells in planes.items():
        n = sides[name]
        part = np.s_[y * n : (y + saved.height) * n, x * n : (x + saved.width) * n]
        assert np.array_equal(
            cells[part].view("u1"), np.ascontiguousarray(saved.stored.planes()[name]).view("u1")
        )
        cells[part] = 0
        assert not cells.any(), "known cells beyond what was saved"
    assert (saved.lattice.resolution, saved.lattice.anchor) == (resolution, anchor)


@pytest.mark.parametrize(
    "model", [LogOdds(), LogOdds("float64"), Counts(), Rate()], ids=["int16", "float64", "counts", "rate"]
)
@pytest.mark.parametrize("bounds", [None, Region(-5.0, -4.0, 12.3, 9.7)], ids=["unbounded", "bounded"])
def test_damaged_tiles_become_unknown_and_are_told_in_metres(tmp_path, model, bounds):
    folder, out = tmp_path / "map", tmp_path / "new"
    story = stored(folder, model, resolution=0.1, bounds=bounds)
    tiles = {tile[:2] for tile in story.grid.checkpoint().tiles_since(0)}
    (x, y), *_ = sorted(name for name in tiles if (name[0] + 1, name[1]) in tiles)
    lost = [(x, y), (x + 1, y)]
    change(folder, ("UPDATE tiles SET record = x'00' WHERE tx IN (?, ?) AND ty = ?", (x, x + 1, y)))
    with (
        MapStore(folder) as store,
        pytest.raises(BadStore, match=rf"tile \({x}.*ogm repair {folder} --out NEW"),
    ):
        store.restore(story.grid.settings)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    report = repair(folder, out)
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before
    left, bottom = story.grid.lattice.corner_of(64 * x, 64 * y)
    assert report.damaged == (pytest.approx((left, bottom, left + 12.8, bottom + 6.4)),)
    assert (report.tiles, report.nameless, report.exact, report.robots) == (len(tiles) - 2, 0, False, ())
    found = opened(out, story.grid.settings)
    assert_saved(story, found, lost)
    assert found.placing == story.placing
    assert found.state.map.revision == story.grid.revision
    assert found.grid.cell_updates == story.grid.cell_updates
    again = Story.going_on(None, found)
    again.integrate(2)


def test_a_store_that_is_whole_is_saved_as_it_is(tmp_path, story):
    report = repair(tmp_path / "map", tmp_path / "new")
    assert (report.exact, report.damaged, report.nameless) == (True, (), 0)
    found = opened(tmp_path / "new", story.grid.settings)
    assert found.grid.epoch != story.grid.epoch
    assert fingerprint(found.grid, found.placing, epoch=False) == fingerprint(
        story.grid, story.placing, epoch=False
    )
    with MapStore(tmp_path / "new") as store:
        assert fingerprint(saved(store, "one", story.grid.settings)) == fingerprint(story.grid)


def test_rows_that_are_missing_are_counted(tmp_path, story):
    change(tmp_path / "map", ("DELETE FROM tiles WHERE rowid IN (2, 3, 5)",))
    report = repair(tmp_path / "map", tmp_path / "new")
    assert (report.nameless, report.damaged, report.exact) == (3, (), False)
    assert opened(tmp_path / "new", story.grid.settings).grid.revision == 8


def test_without_its_state_the_map_is_what_the_tiles_say(tmp_path, story):
    change(tmp_path / "map", ("UPDATE state SET text = '{}'",))
    report = repair(tmp_path / "map", tmp_path / "new")
    assert (report.exact, report.revision) == (False, 8)
    found = opened(tmp_path / "new", story.grid.settings)
    assert_saved(story, found, [])
    assert (found.grid.stamp, found.grid.cell_updates) == (None, 0)


def test_what_was_known_of_a_robot_is_lost_alone(tmp_path, story):
    change(tmp_path / "map", ("UPDATE placing SET value = x'00' WHERE key = 'robot1'",))
    report = repair(tmp_path / "map", tmp_path / "new")
    assert report.robots == ("robot1",)
    assert sorted(opened(tmp_path / "new", story.grid.settings).placing) == ["robot0", "robot2"]


def test_pages_that_cannot_be_read_cost_their_tiles_only(tmp_path):
    """Half of the pages are zeros, from one place on or another: whatever is saved is right."""
    story = stored(tmp_path / "map")
    content = (tmp_path / "map" / "map.sqlite").read_bytes()
    saved = []
    for first in range(5, len(content) // 4096):
        folder, out = tmp_path / f"map{first}", tmp_path / f"new{first}"
        shutil.copytree(tmp_path / "map", folder)
        begin = 4096 * first
        (folder / "map.sqlite").write_bytes(content[:begin] + bytes(4096) + content[begin + 4096 :])
        try:
            report = repair(folder, out)
        except BadStore as error:
            assert "nothing can be saved of it" in str(error)  # noqa: PT017 (some are refused)
            continue
        found = opened(out, story.grid.settings)
        kept = {tile[:2]: tile for tile in found.grid.checkpoint().tiles_since(0)}
        for tile in story.grid.checkpoint().tiles_since(0):
            if tile[:2] in kept:
                assert np.array_equal(tile.planes["log_odds"], kept[tile[:2]].planes["log_odds"])
        saved.append(report.tiles)
    every = len(list(story.grid.checkpoint().tiles_since(0)))
    assert max(saved) == every
    assert any(0 < tiles < every for tiles in saved)


def test_a_log_that_does_not_fit_is_left_out_if_the_rest_is_exact(tmp_path):
    """The file of a later moment with the log of an earlier one."""
    with MapStore(tmp_path / "map") as store:
        story = Story(store, grid_of())
        story.integrate(2)
        story.commit()
        story.placing["robot0"] = story._changed["robot0"] = b"elsewhere"
        story.commit()
        shutil.copytree(tmp_path / "map", tmp_path / "mixed")
        story.integrate(6)
        story.commit()
    shutil.copyfile(tmp_path / "map" / "map.sqlite", tmp_path / "mixed" / "map.sqlite")
    shutil.copytree(tmp_path / "mixed", tmp_path / "tried")
    with pytest.raises(BadStore, match="is damaged"):
        opened(tmp_path / "tried", story.grid.settings)
    assert repair(tmp_path / "mixed", tmp_path / "new").exact
    found = opened(tmp_path / "new", story.grid.settings)
    assert found.grid.revision == 8
    assert_saved(story, found, [])


@pytest.mark.parametrize("statement", ["DELETE FROM settings", "UPDATE settings SET text = '{}'"])
def test_without_settings_nothing_can_be_saved(tmp_path, story, statement):
    change(tmp_path / "map", (statement,))
    with pytest.raises(BadStore, match="nothing can be saved of it: nothing says of what kind the map was"):
        repair(tmp_path / "map", tmp_path / "new")


def test_what_cannot_be_repaired_or_written_is_named(tmp_path, story):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_bytes(b"")
    for out in (tmp_path / "full", tmp_path / "full" / "file", tmp_path / "map"):
        with pytest.raises(
            BadInput, match=f"--out {out}: a folder that is empty, or not there yet, is needed"
        ):
            repair(tmp_path / "map", out)
    with pytest.raises(BadInput, match=f"{tmp_path}/none: there is no stored map, no file map.sqlite"):
        repair(tmp_path / "none", tmp_path / "new")
    assert not (tmp_path / "none").exists()
    with MapStore(tmp_path / "map"), pytest.raises(StoreInUse):
        repair(tmp_path / "map", tmp_path / "new")
    repair(tmp_path / "map", tmp_path / "new")


@pytest.mark.parametrize("out", ["new", "snapshots/new"])
def test_nothing_is_written_into_what_is_repaired(tmp_path, story, out):
    folder = tmp_path / "map"
    before = sorted(folder.rglob("*"))
    with pytest.raises(BadInput, match=f"--out {folder / out}: a folder that is not in {folder} is needed"):
        repair(folder, folder / out)
    assert sorted(folder.rglob("*")) == before


def test_a_snapshot_that_cannot_be_read_is_told_and_the_others_are_there(tmp_path, story, monkeypatch):
    folder, out = tmp_path / "map" / "snapshots", tmp_path / "new"
    shutil.copy(folder / "one.sqlite", folder / "two.sqlite")
    (folder / "cut.sqlite").write_bytes((folder / "one.sqlite").read_bytes()[:5000])
    (folder / "folder.sqlite").mkdir()
    os.utime(folder / "one.sqlite", ns=(1, 10**18))
    read = Path.read_bytes

    def read_badly(path):
        if path.name == "two.sqlite":
            raise OSError(errno.EIO, "Input/output error")
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", read_badly)
    run = CliRunner().invoke(app, ["repair", str(tmp_path / "map"), "--out", str(out)])
    assert run.exit_code == 0, run.output
    assert run.output.splitlines()[1:] == [
        "snapshots that cannot be read are not there: two",
        "the map is exactly as it was stored",
    ]
    with MapStore(out) as store:
        listed = {snapshot.name: snapshot for snapshot in store.snapshots.list()}
        assert sorted(listed) == ["cut", "one"]
        assert listed["one"].saved == 10**18
        assert fingerprint(saved(store, "one", story.grid.settings)) == fingerprint(story.grid)
    assert (out / "snapshots" / "cut.sqlite").stat().st_size == 5000


def test_the_command_tells_what_it_has_saved_and_what_not(tmp_path, story):
    folder, out = tmp_path / "map", tmp_path / "new"
    change(
        folder, ("UPDATE tiles SET record = x'00' WHERE rowid = 1",), ("DELETE FROM tiles WHERE rowid = 2",)
    )
    run = CliRunner().invoke(app, ["repair", str(folder), "--out", str(out)])
    assert run.exit_code == 0, run.output
    lines = run.output.splitlines()
    assert lines[0].startswith(f"{out}: ")
    assert "tiles of the map at revision 8, under a new epoch" in lines[0]
    assert lines[1] == "unknown now, x and y from and to in metres (1):"
    assert lines[2].startswith("  x ")
    assert lines[3] == "unknown now, and nothing tells where: 1 tiles"
    assert lines[4] == "tiles may be older than others: the map is not exactly one that the mapper had"
    run = CliRunner().invoke(app, ["repair", str(out), "--out", str(tmp_path / "newer")])
    assert run.output.splitlines()[1] == "the map is exactly as it was stored"


def test_the_command_refuses_in_one_line(tmp_path):
    run = CliRunner().invoke(app, ["repair", str(tmp_path), "--out", str(tmp_path / "new")])
    assert run.exit_code == 2
    assert "there is no stored map" in run.output
