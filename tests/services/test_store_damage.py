"""Damaged stores: an earlier exact state or a clear refusal, never a wrong map; and what repair saves."""

import json
import sqlite3

import pytest

from ogm_core.cells.rate import Rate
from ogm_core.errors import BadStore
from ogm_services.mapper.storage.map_store import MapStore
from stored_maps import Story, grid_of, restored
from tampering import tampered


@pytest.fixture
def story(tmp_path):
    """A store that is closed, of some ten tiles and three robots."""
    with MapStore(tmp_path) as store:
        story = Story(store, grid_of())
        story.integrate(5)
        story.commit()
    return story


CHANGES = {
    "tiles": {"tx": -40, "ty": 40, "revision": 3, "record": b"\0", "digest": bytes(16)},
    "placing": {"key": "robot9", "value": b"elsewhere", "digest": bytes(16)},
    "state": {"root": bytes(16), "digest": bytes(16)},
    "settings": {"digest": bytes(16)},
}


@pytest.mark.parametrize(
    ("table", "column"), [(table, column) for table in CHANGES for column in CHANGES[table]]
)
@pytest.mark.parametrize("kind", ["another value", "text", "number", "nothing"])
def test_every_field_is_checked(tmp_path, story, table, column, kind):
    others = {"another value": CHANGES[table][column], "text": "text", "number": 1.5, "nothing": b""}
    with sqlite3.connect(tmp_path / "map.sqlite") as connection:
        connection.execute(
            f"UPDATE {table} SET {column} = ? WHERE rowid = (SELECT min(rowid) FROM {table})", (others[kind],)
        )
    connection.close()
    with pytest.raises(BadStore, match=r"map\.sqlite is damaged: "), MapStore(tmp_path) as store:
        store.restore(story.grid.settings)


@pytest.mark.parametrize(
    "field", ["run", "tiles", "epoch", "revision", "stamp", "cell_updates", "known", "room"]
)
def test_every_word_of_the_state_is_checked(tmp_path, story, field):
    """Another revision, stamp or rectangle than the map's, that would do as well."""
    others = {"run": "run2", "epoch": "epoch2", "known": [0, 0, 64, 64], "room": [-8192, -8192, 16384, 16384]}
    with sqlite3.connect(tmp_path / "map.sqlite") as connection:
        (text,) = connection.execute("SELECT text FROM state").fetchone()
        fields = json.loads(text)
        assert field in fields
        fields[field] = others.get(field, 7)
        connection.execute("UPDATE state SET text = ?", (json.dumps(fields),))
    connection.close()
    with pytest.raises(BadStore, match="the row of its state is damaged"), MapStore(tmp_path) as store:
        store.restore(story.grid.settings)


def test_another_setting_in_the_store_is_damage_and_no_contradiction(tmp_path, story):
    with sqlite3.connect(tmp_path / "map.sqlite") as connection:
        (text,) = connection.execute("SELECT text FROM settings").fetchone()
        connection.execute("UPDATE settings SET text = ?", (text.replace("0.05", "0.06"),))
    connection.close()
    with pytest.raises(BadStore, match="the row of its settings is damaged"), MapStore(tmp_path) as store:
        store.restore(story.grid.settings)


def test_a_page_that_is_only_needed_for_writing_is_looked_at(tmp_path, story):
    """The index of the tiles: reading all of them does not meet it, and the next commit would."""
    path = tmp_path / "map.sqlite"
    connection = sqlite3.connect(path)
    ask = "SELECT rootpage FROM sqlite_master WHERE name = 'sqlite_autoindex_tiles_1'"
    (page,) = connection.execute(ask).fetchone()
    connection.close()
    content = path.read_bytes()
    path.write_bytes(content[: 4096 * (page - 1)] + bytes(4096) + content[4096 * page :])
    with pytest.raises(BadStore, match=r"map\.sqlite is damaged: "), MapStore(tmp_path) as store:
        store.restore(story.grid.settings)


def test_what_is_not_damaged_is_restored(tmp_path, story):
    with MapStore(tmp_path) as store:
        assert restored(store, story.grid.settings) == story.now


@pytest.mark.parametrize(
    "changes",
    [{}, {"model": Rate(), "separate_robots": True, "resolution": 0.25}],
    ids=["one", "robots apart"],
)
def test_a_store_that_is_tampered_with_is_exact_or_refused(tmp_path, changes):
    """Sixty places: bits, lengths, pages and rows, in the file and in its log."""
    found = tampered(60, tmp_path, **changes)
    results = {result for _, result, _ in found}
    assert results == {"exact", "refused"}
    assert sum(found.values()) == 60
    assert sum(count for (_, result, _), count in found.items() if result == "refused") >= 15
    assert {mended for _, _, mended in found} == {"exact", "in part", "nothing"}
