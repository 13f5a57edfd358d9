"""Named snapshots: the map as it was, in a file of its own."""

import os
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from ogm_core.errors import BadParameter, BadSetting, BadStore
from ogm_services.mapper.storage.map_store import MapStore
from ogm_services.replies.answer import UnknownName
from stored_maps import MODELS, RUN, Story, fingerprint, grid_of, restored, saved


@pytest.fixture
def story(tmp_path):
    """A store with three scans in its map."""
    with MapStore(tmp_path) as store:
        story = Story(store, grid_of())
        story.integrate(3)
        story.commit()
        yield story


@MODELS
def test_a_snapshot_is_the_map_as_it_was(tmp_path, model):
    with MapStore(tmp_path) as store:
        story = Story(store, grid_of(model, resolution=0.1))
        states = {}
        for name in ("a", "b.1", "C_-"):
            story.integrate(2)
            story.commit()
            store.save(name)
            states[name] = fingerprint(story.grid)
        story.integrate(1)
        story.grid.reset("epoch2")
        story.commit()
        assert restored(store, story.grid.settings) == story.now
    with MapStore(tmp_path) as store:
        for name, state in states.items():
            assert fingerprint(saved(store, name, story.grid.settings)) == state
        assert [snapshot.name for snapshot in store.snapshots.list()] == sorted(states)
    assert len(set(states.values())) == 3


def test_a_snapshot_is_listed_with_what_it_is(story):
    story.store.save("one")
    story.integrate(1)
    story.commit()
    story.store.save("two")
    one, two = story.store.snapshots.list()
    assert (one.name, one.epoch, one.revision, one.stamp, one.damage) == ("one", "epoch1", 3, 2, None)
    assert (two.name, two.revision, two.stamp) == ("two", 4, 3)
    file = (story.store.folder / "snapshots" / "one.sqlite").stat()
    assert (one.bytes, one.saved, one.run) == (file.st_size, file.st_mtime_ns, RUN)


def test_a_snapshot_has_the_run_of_who_saves_it(story):
    """Which is another than who has stored the map, if it has not changed since its mapper was started."""
    story.store.save("one", "run2")
    assert [snapshot.run for snapshot in story.store.snapshots.list()] == ["run2"]
    assert saved(story.store, "one", story.grid.settings).run == "run2"


def test_what_is_open_stays_as_it_is(story):
    """Whoever deletes it meanwhile, or saves another map under its name."""
    story.store.save("one")
    before = fingerprint(story.grid)
    with story.store.snapshots.opened("one") as snapshot:
        story.store.snapshots.delete("one")
        story.integrate(1)
        story.commit()
        story.store.save("one")
        assert fingerprint(snapshot.grid(story.grid.settings)) == before
    assert fingerprint(saved(story.store, "one", story.grid.settings)) == fingerprint(story.grid) != before


def test_it_is_known_beforehand_how_much_memory_a_snapshot_takes(story):
    story.store.save("one")
    with story.store.snapshots.opened("one") as snapshot:
        tiles = snapshot.grid(story.grid.settings).snapshot().stored.tiles
        assert snapshot.nbytes == sum(
            plane.nbytes for block in tiles.blocks for plane in block.planes.values()
        )


def test_what_is_read_begins_a_new_epoch_where_it_is_told_to(story):
    """Nothing that is kept of the map before is taken for it, and it is stored whole."""
    story.store.save("one")
    before = fingerprint(story.grid, epoch=False)
    story.integrate(4)
    story.commit()
    story.grid = saved(story.store, "one", story.grid.settings)
    story.grid.epoch = "epoch2"
    assert story.grid.epoch == "epoch2"
    assert fingerprint(story.grid, epoch=False) == before
    story.commit()
    found = story.store.restore(story.grid.settings)
    assert fingerprint(found.grid, found.placing) == story.now
    assert len(found.placing) == 3


def test_a_snapshot_that_is_deleted_is_gone(story):
    snapshots = story.store.snapshots
    for name in ("one", "two"):
        story.store.save(name)
    snapshots.delete("one")
    assert [snapshot.name for snapshot in snapshots.list()] == ["two"]
    for ask in (snapshots.delete, lambda name: saved(story.store, name, story.grid.settings)):
        with pytest.raises(UnknownName, match="name one: there is no such snapshot; there are: two"):
            ask("one")
    story.store.save("one")
    assert fingerprint(saved(story.store, "one", story.grid.settings)) == fingerprint(story.grid)


def test_a_name_that_is_taken_is_refused_and_what_has_it_stays(story):
    story.store.save("one")
    before = fingerprint(story.grid)
    story.integrate(1)
    story.commit()
    with pytest.raises(BadParameter, match="name one: there is a snapshot of this name: delete it"):
        story.store.save("one")
    assert fingerprint(saved(story.store, "one", story.grid.settings)) == before


@pytest.mark.parametrize("name", ["", "a/b", "../x", "a b", "ä", "x" * 65, "a\n", "\0", "a" * 10_000])
def test_what_is_no_name_is_refused_in_a_short_line(story, name):
    snapshots = story.store.snapshots
    for ask in (
        story.store.save,
        snapshots.delete,
        lambda name: saved(story.store, name, story.grid.settings),
    ):
        with pytest.raises(BadParameter, match=r"a name is 1 to 64 of A-Z a-z 0-9 _ - \.$") as refusal:
            ask(name)
        assert len(str(refusal.value)) < 200
    assert not (story.store.folder / "snapshots").exists()


@pytest.mark.parametrize("name", [".", "..", "...", "-rf", "x" * 64, ".sqlite"])
def test_names_that_look_odd_are_files_in_the_folder(story, name):
    snapshots = story.store.snapshots
    story.store.save(name)
    assert [snapshot.name for snapshot in snapshots.list()] == [name]
    assert fingerprint(saved(story.store, name, story.grid.settings)) == fingerprint(story.grid)
    assert [path.name for path in (story.store.folder / "snapshots").iterdir()] == [f"{name}.sqlite"]


def test_there_is_nothing_to_save_before_a_map_is_stored(tmp_path):
    with MapStore(tmp_path) as store:
        assert store.snapshots.list() == []
        with pytest.raises(BadParameter, match="no map is stored yet"):
            store.save("one")


def test_a_damaged_snapshot_is_refused_and_listed_as_damaged(story):
    snapshots, folder = story.store.snapshots, story.store.folder / "snapshots"
    for name in ("good", "cut", "zeroed", "empty"):
        story.store.save(name)
    content = (folder / "cut.sqlite").read_bytes()
    (folder / "cut.sqlite").write_bytes(content[: len(content) // 2])
    (folder / "zeroed.sqlite").write_bytes(content[: 4 * 4096] + bytes(4096) + content[5 * 4096 :])
    (folder / "empty.sqlite").write_bytes(b"")
    for name in ("cut", "zeroed", "empty"):
        said = rf"^{re.escape(str(folder))}/{name}\.sqlite is damaged: .*: delete this snapshot$"
        with pytest.raises(BadStore, match=said):
            saved(story.store, name, story.grid.settings)
    listed = {snapshot.name: snapshot.damage for snapshot in snapshots.list()}
    assert listed["good"] is None
    assert "is damaged" in listed["cut"]
    assert "is damaged" in listed["empty"]
    snapshots.delete("cut")
    assert fingerprint(saved(story.store, "good", story.grid.settings)) == fingerprint(story.grid)


def test_a_snapshot_of_other_settings_is_refused(story, tmp_path_factory):
    story.store.save("one")
    with pytest.raises(BadSetting, match=r"one\.sqlite: .* map\.alpha is 0\.3, and there 0\.1: only a "):
        saved(story.store, "one", replace(story.grid.settings, alpha=0.3))
    other = tmp_path_factory.mktemp("other")
    with MapStore(other) as store:
        shutil.copytree(story.store.folder / "snapshots", other / "snapshots")
        assert fingerprint(saved(store, "one", story.grid.settings)) == fingerprint(story.grid)


def test_a_save_that_was_cut_off_leaves_nothing_that_is_listed(story):
    folder = story.store.folder / "snapshots"
    story.store.save("one")
    (folder / "one.sqlite").rename(folder / ".two.sqlite.part")
    assert story.store.snapshots.list() == []
    story.store.save("two")
    assert [path.name for path in folder.iterdir()] == ["two.sqlite"]


def test_what_was_not_finished_is_gone_at_the_next_start(tmp_path):
    with MapStore(tmp_path) as store:
        story = Story(store, grid_of())
        story.integrate(1)
        story.commit()
        for name in ("one", "two.sqlite.part"):
            store.save(name)
    folder = tmp_path / "snapshots"
    (folder / "one.sqlite").rename(folder / ".one.sqlite.part")
    with MapStore(tmp_path):
        assert [path.name for path in folder.iterdir()] == ["two.sqlite.part.sqlite"]


def test_a_snapshot_takes_no_room_for_what_is_no_map(story):
    """The placing state is not in it, however much it is."""
    story.placing["robot0"] = story._changed["robot0"] = np.random.default_rng(1).bytes(300_000)
    story.commit()
    story.store.save("one")
    assert story.store.snapshots.list()[0].bytes < 100_000


def test_what_is_no_file_or_has_no_name_is_no_snapshot(story, tmp_path):
    """Nobody opens it: a pipe would never answer."""
    story.store.save("one")
    snapshots, folder = story.store.snapshots, story.store.folder / "snapshots"
    os.mkfifo(folder / "pipe.sqlite")
    (folder / "folder.sqlite").mkdir()
    (folder / "nowhere.sqlite").symlink_to(tmp_path / "nothing")
    for name in ("my map.sqlite", ".sqlite"):
        shutil.copy(folder / "one.sqlite", folder / name)
    (folder / "link.sqlite").symlink_to(folder / "one.sqlite")
    assert [snapshot.name for snapshot in snapshots.list()] == ["link", "one"]
    for name in ("pipe", "folder", "nowhere"):
        with pytest.raises(UnknownName, match=r"there is no such snapshot; there are: link, one$"):
            snapshots.delete(name)
    with pytest.raises(BadParameter, match=r"name folder: .*folder\.sqlite is no file: take another name"):
        story.store.save("folder")
    assert fingerprint(saved(story.store, "link", story.grid.settings)) == fingerprint(story.grid)


def test_a_stored_map_that_is_copied_there_is_a_snapshot(story, tmp_path_factory):
    """Of the moment at which its mapper had ended, when it had no log."""
    other = tmp_path_factory.mktemp("other")
    story.store.save("one")
    shutil.copytree(story.store.folder, other, dirs_exist_ok=True)
    with MapStore(other) as store:
        restored(store, story.grid.settings)
    shutil.copy(other / "map.sqlite", story.store.folder / "snapshots" / "two.sqlite")
    assert [(found.name, found.damage) for found in story.store.snapshots.list()] == [
        ("one", None),
        ("two", None),
    ]
    assert fingerprint(saved(story.store, "two", story.grid.settings)) == fingerprint(story.grid)
