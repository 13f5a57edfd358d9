"""A map on disk comes back as it was stored, value for value; settings that contradict it are refused."""

import json
import os
import re
import sqlite3
import subprocess
import sys
from dataclasses import replace

import pytest

from counts_model import Counts
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadInput, BadSetting, BadStore
from ogm_core.lattice import CellRect, Clip, Region
from ogm_core.tiles.polygon import Polygon
from ogm_services.mapper.storage.folder_lock import StoreInUse
from ogm_services.mapper.storage.map_store import MapStore
from stored_maps import MODELS, RUN, Story, fingerprint, grid_of, restored

BOUNDS = Region(-5.0, -4.0, 12.3, 9.7)
WHERE = pytest.mark.parametrize("bounds", [None, BOUNDS], ids=["unbounded", "bounded"])


@MODELS
@WHERE
def test_what_was_stored_comes_back_value_for_value(tmp_path, model, bounds):
    """Of every commit, by the process that made it or by the next one."""
    with MapStore(tmp_path) as store:
        story = Story(store, grid_of(model, bounds=bounds, resolution=0.1))
        assert store.empty
        assert store.restore(story.grid.settings) is None
    for _ in range(5):
        with MapStore(tmp_path) as store:
            restored(store, story.grid.settings)
            story.store = store
            for count in (1, 2, 0):
                story.integrate(count)
                story.commit()
        with MapStore(tmp_path) as store:
            assert not store.empty
            found = store.restore(story.grid.settings)
            assert (found.state.run, found.state.map.revision) == (RUN, story.grid.revision)
            assert fingerprint(found.grid, found.placing) == story.now
    assert story.grid.revision == 15


@MODELS
def test_a_restored_map_goes_on_as_if_nothing_had_been(tmp_path, model):
    """The uninterrupted map and one that is restored after every scan."""
    with MapStore(tmp_path) as store:
        story = Story(store, grid_of(model, resolution=0.1))
        for _ in range(12):
            story.integrate()
            story.commit()
            after = store.restore(story.grid.settings).grid
            assert fingerprint(after) == fingerprint(story.grid)
            story.grid = after
    twin = Story(None, grid_of(model, resolution=0.1))
    twin.integrate(12)
    assert fingerprint(twin.grid, twin.placing) == story.now


def test_only_what_has_changed_is_written(tmp_path):
    with MapStore(tmp_path) as store:
        story = Story(store, grid_of())
        story.integrate(3)
        story.commit()
        before = dict(store._connection.execute("SELECT tx || ',' || ty, rowid FROM tiles"))
        writes = []
        store._connection.set_trace_callback(writes.append)
        story.integrate(1)
        changed = list(story.grid.checkpoint().tiles_since(3))
        story.commit()
        store._connection.set_trace_callback(None)
        assert 0 < len(changed) < len(before)
        assert sum("INTO tiles" in text for text in writes) == len(changed)
        assert sum("INTO placing" in text for text in writes) == 1
        assert sum(text == "COMMIT" for text in writes) == 1


def test_a_map_that_nobody_has_looked_at_is_not_written_over(tmp_path):
    with MapStore(tmp_path) as store:
        story = Story(store, grid_of())
        story.integrate(2)
        story.commit()
    with MapStore(tmp_path) as store:
        with pytest.raises(RuntimeError, match="is restored, or its map would be lost"):
            Story(store, grid_of(epoch="other")).commit()
        assert restored(store, story.grid.settings) == story.now


def test_a_reset_map_takes_the_place_of_the_one_before(tmp_path):
    with MapStore(tmp_path) as store:
        story = Story(store, grid_of())
        story.integrate(4)
        story.commit()
        story.grid.reset("epoch2")
        story.commit()
        assert restored(store, story.grid.settings) == story.now
        assert store._connection.execute("SELECT count(*) FROM tiles").fetchone() == (0,)
        story.integrate(2)
        story.commit()
        assert restored(store, story.grid.settings) == story.now
        assert len(story.placing) == 3


def test_parts_of_the_placing_state_come_and_go(tmp_path):
    grid = grid_of()
    with MapStore(tmp_path) as store:

        def stored(parts):
            store.commit(grid.checkpoint(), grid.settings, RUN, parts)
            return store.restore(grid.settings).placing

        assert stored({"a": b"1", "b": b"\0\xff", "ä": b""}) == {"a": b"1", "b": b"\0\xff", "ä": b""}
        assert stored({}) == {"a": b"1", "b": b"\0\xff", "ä": b""}
        assert stored({"a": None, "b": b"2", "never": None}) == {"b": b"2", "ä": b""}


def test_a_map_that_began_with_another_goes_on_on_its_lattice(tmp_path):
    """Its anchor is no setting, and map files round resolutions."""
    grid = grid_of(resolution=0.05 * (1 + 4e-7), anchor=(1.23, -4.56))
    with MapStore(tmp_path) as store:
        story = Story(store, grid)
        story.integrate(2)
        story.commit()
        found = store.restore(grid_of().settings).grid
    assert found.lattice == grid.lattice
    assert fingerprint(found) == fingerprint(grid)


CONTRADICTIONS = [
    ({"resolution": 0.1}, "map.resolution is 0.1, and there 0.05"),
    ({"resolution": 0.0500001}, "map.resolution is 0.0500001, and there 0.05"),
    ({"sensor_model": "sector"}, "map.sensor_model is sector, and there beam"),
    ({"traversal": "dda"}, "map.traversal is dda, and there bresenham"),
    ({"alpha": 0.2}, "map.alpha is 0.2, and there 0.1"),
    ({"reach": 5.0}, "map.reach is 5.0, and there none"),
    ({"clear_range": 5.0}, "map.clear_range is 5.0, and there none"),
    ({"half_life": 60.0}, "map.half_life is 60.0, and there none"),
    ({"clip": Clip(xmax=128)}, r"map.clip is \[null, null, 128, null\], and there none"),
    ({"outside": "drop"}, "map.outside is drop, and there clip"),
    ({"bounds": BOUNDS}, r"map.bounds is \[-5.0, -4.0, 12.3, 9.7\], and there none"),
    ({"cell_model": LogOdds("float64")}, "map.cells is float64, and there int16"),
    ({"cell_model": LogOdds(p_prior=0.4)}, "map.p_prior is 0.4, and there 0.5"),
    ({"cell_model": LogOdds(p_occ=0.8)}, "map.p_occ is 0.8, and there 0.7"),
    ({"cell_model": LogOdds(p_free=0.2)}, "map.p_free is 0.2, and there 0.3"),
    ({"cell_model": LogOdds(l_min=-4.0)}, "map.l_min is -4.0, and there -8.0"),
    ({"cell_model": LogOdds(l_max=4.0)}, "map.l_max is 4.0, and there 8.0"),
    ({"cell_model": Counts()}, "map.cell_model is Counts, and there LogOdds"),
]


@pytest.fixture
def stored(tmp_path):
    """A folder with a store, and the story of its map."""
    with MapStore(tmp_path / "map") as store:
        story = Story(store, grid_of())
        story.integrate(5)
        story.commit()
    return tmp_path / "map", story


@pytest.mark.parametrize(("change", "said"), CONTRADICTIONS)
def test_a_contradiction_is_refused_by_name_with_both_values(stored, change, said):
    folder, story = stored
    with MapStore(folder) as store:
        with pytest.raises(BadSetting, match=f"{re.escape(str(folder))}: .*{said}"):
            store.restore(replace(story.grid.settings, **change))
        assert restored(store, story.grid.settings) == story.now


def test_another_kind_of_cell_is_one_contradiction(stored):
    folder, story = stored
    with MapStore(folder) as store, pytest.raises(BadSetting) as refusal:
        store.restore(replace(story.grid.settings, cell_model=LogOdds("float64")))
    assert str(refusal.value).count(", and there ") == 1


def test_all_contradictions_are_named(stored):
    folder, story = stored
    others = replace(story.grid.settings, alpha=0.3, traversal="dda", cell_model=LogOdds(p_occ=0.9))
    with MapStore(folder) as store, pytest.raises(BadSetting) as refusal:
        store.restore(others)
    assert str(refusal.value).count(", and there ") == 3
    assert "give those, or store this map elsewhere" in str(refusal.value)


def test_limits_may_be_raised_and_not_below_what_is_stored(stored):
    folder, story = stored
    raised = replace(story.grid.settings, max_cells=10**9, max_bytes=2**33, max_scan_cells=10**10)
    with MapStore(folder) as store:
        found = store.restore(raised)
        assert found.grid.settings == raised
        with pytest.raises(BadSetting, match="max_bytes = 1000: raise it"):
            store.restore(replace(story.grid.settings, max_bytes=1000))


def test_a_folder_is_one_mappers(tmp_path):
    """The other one is another process, that is named, and may be killed."""
    code = "from pathlib import Path; from ogm_services.mapper.storage.map_store import MapStore\n"
    code += f"store = MapStore(Path({str(tmp_path)!r})); print('ready', flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "ready\n"
        with pytest.raises(StoreInUse, match=f"{tmp_path}: process {other.pid} stores its map there"):
            MapStore(tmp_path)
        other.kill()
    with MapStore(tmp_path) as store:
        assert store.empty
        with pytest.raises(StoreInUse, match=f"process {os.getpid()} "):
            MapStore(tmp_path)


def test_no_folder_can_be_made_where_a_file_is(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    for folder in (tmp_path / "file", tmp_path / "file" / "map"):
        with pytest.raises(BadInput, match=f"{folder}: a map cannot be stored there: "):
            MapStore(folder)


def test_a_store_of_another_version_is_refused_by_name(stored):
    folder, story = stored
    for version, said in ((4, "format 4; this one reads format 3: use the newer one"), (0, "format 0")):
        with sqlite3.connect(folder / "map.sqlite") as connection:
            connection.execute(f"PRAGMA user_version = {version}")
        connection.close()
        with pytest.raises(BadStore, match=said):
            MapStore(folder)
    with sqlite3.connect(folder / "map.sqlite") as connection:
        connection.execute("PRAGMA user_version = 1")
    connection.close()
    with MapStore(folder) as store:
        assert restored(store, story.grid.settings) == story.now


@pytest.mark.parametrize(
    ("half_life", "erased", "version"), [(None, False, 1), (None, True, 2), (1.0, False, 2)]
)
def test_a_store_is_of_the_newer_version_once_its_map_forgets_or_something_was_erased(
    tmp_path, half_life, erased, version
):
    """A program that knows neither goes on with it until then, and refuses it by its version afterwards."""

    def of(path):
        connection = sqlite3.connect(path)
        ((found, state),) = connection.execute("SELECT user_version, text FROM pragma_user_version, state")
        connection.close()
        return found, json.loads(state).keys() & {"time", "ticks", "erasures"}

    with MapStore(tmp_path) as store:
        story = Story(store, grid_of(half_life=half_life))
        story.integrate(3)
        story.commit()
        if erased:
            story.grid.erase(Polygon([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)], story.grid.lattice))
        story.commit()
        store.save("kept")
    for file in (tmp_path / "map.sqlite", tmp_path / "snapshots" / "kept.sqlite"):
        found, newer = of(file)
        assert (found, bool(newer)) == (version, version > 1)
    with MapStore(tmp_path) as store:
        assert restored(store, story.grid.settings) == story.now


def test_a_map_with_a_clip_is_stored_with_what_the_whole_one_would_be(tmp_path):
    story = Story(None, grid_of(clip=Clip(xmin=64)))
    story.integrate(3)
    with MapStore(tmp_path) as store:
        story.store = store
        story.commit()
        before = store.restore(story.grid.settings).grid.checkpoint().state
        assert before == story.grid.checkpoint().state
    assert before.stretched.union(CellRect(*before.known)) == before.stretched != before.known
    with MapStore(tmp_path) as store, pytest.raises(BadSetting, match=r"clip is none, and there \[64, null"):
        store.restore(grid_of().settings)


@pytest.mark.parametrize("content", [b"", b"hello" * 1000, b"SQLite format 3\0" + bytes(5000)])
def test_a_file_that_is_no_store_is_refused_and_left_alone(tmp_path, content):
    (tmp_path / "map.sqlite").write_bytes(content)
    with pytest.raises(
        BadStore, match=f"{tmp_path / 'map.sqlite'} is damaged: .* `ogm repair {tmp_path} --out"
    ):
        MapStore(tmp_path)
    assert (tmp_path / "map.sqlite").read_bytes() == content


def test_a_database_of_somebody_else_is_refused(tmp_path):
    connection = sqlite3.connect(tmp_path / "map.sqlite")
    connection.execute("CREATE TABLE tiles (x)")
    connection.close()
    with pytest.raises(BadStore, match="it is no map that ogm has stored"):
        MapStore(tmp_path)


def test_a_log_without_its_file_is_no_new_store(stored):
    folder, _ = stored
    (folder / "map.sqlite").rename(folder / "map.sqlite-wal")
    with pytest.raises(BadStore, match="it is not there, and its log is"):
        MapStore(folder)


def test_what_is_stored_survives_whatever_the_environment_says_of_journals(stored):
    """Each commit is on disk before the next begins: the log is synchronised in full."""
    folder, _ = stored
    with MapStore(folder) as store:
        ask = store._connection.execute
        assert ask("PRAGMA journal_mode").fetchone() == ("wal",)
        assert ask("PRAGMA synchronous").fetchone() == (2,)
        assert ask("PRAGMA user_version").fetchone() == (1,)
    assert sorted(path.name for path in folder.iterdir()) == ["lock", "map.sqlite"]


def test_the_log_does_not_grow_without_end(tmp_path):
    with MapStore(tmp_path) as store:
        story = Story(store, grid_of(), robots=30)
        for _ in range(60):
            story.integrate(12)
            story.commit()
            assert (tmp_path / "map.sqlite-wal").stat().st_size < 2 * 2**20
        assert restored(store, story.grid.settings) == story.now


def test_settings_are_stored_as_they_are_named(stored):
    folder, _ = stored
    with MapStore(folder) as store:
        (text,) = store._connection.execute("SELECT text FROM settings").fetchone()
    fields = json.loads(text)
    assert (fields["resolution"], fields["p_occ"], fields["cells"], fields["bounds"]) == (
        0.05,
        0.7,
        "int16",
        None,
    )
    assert fields["planes"] == [["log_odds", "int16", 1]]
