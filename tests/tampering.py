"""Stores that are tampered with: every kind of damage, at random places, and what comes of it.

A damaged store is refused in one line, or holds a state that its map once had, exactly. As a program,
`python tests/tampering.py TIMES`, it says of each kind of damage what became of how many stores.
"""

import random
import shutil
import sqlite3
import sys
from collections import Counter
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

from ogm_core.errors import BadInput, BadStore
from ogm_services.mapper.storage.map_store import MapStore
from ogm_services.mapper.storage.repair import repair
from stored_maps import Story, fingerprint, grid_of, restored

FILE, LOG = "map.sqlite", "map.sqlite-wal"
COMMITS = 8
SAVED = "saved exact", "saved in part", "saved nothing"
"""What repair makes of a store that is refused."""
PAGE = 4096


class Images:
    """A store's files after each commit, as a kill -9 right then leaves them, and the states that were."""

    def __init__(self, folder, **changes):
        self.folder = folder
        with MapStore(folder / "live") as store:
            story = Story(store, grid_of(**changes))
            for k in range(COMMITS):
                story.integrate(1 + k % 3)
                story.commit()
                if k == COMMITS // 2:  # its pages are in the file now, and the log begins anew
                    store._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
                self._keep(k)
            self._keep(COMMITS)
        shutil.copytree(folder / "live", folder / "closed")
        self.settings, self.states, self.last = story.grid.settings, story.states, story.grid.revision

    def of(self, k):
        """The folder as it was after commit `k`; COMMITS: after the store was closed."""
        return self.folder / ("closed" if k == COMMITS else f"image{k}")

    def _keep(self, k):
        if k < COMMITS:
            shutil.copytree(self.folder / "live", self.of(k))


def flipped(rng, path, _images):
    content = bytearray(path.read_bytes())
    for _ in range(rng.choice((1, 1, 1, 8))):
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def truncated(rng, path, _images):
    size = path.stat().st_size
    with path.open("r+b") as file:
        file.truncate(rng.choice((rng.randrange(size), size // PAGE * rng.randrange(100) // 100 * PAGE)))


def zeroed(rng, path, _images):
    content = path.read_bytes()
    begin = rng.choice((rng.randrange(len(content)), rng.randrange(len(content)) // PAGE * PAGE))
    end = min(len(content), begin + rng.choice((1, 16, 512, PAGE, 4 * PAGE)))
    path.write_bytes(content[:begin] + bytes(end - begin) + content[end:])


def lengthened(rng, path, _images):
    with path.open("ab") as file:
        file.write(rng.randbytes(rng.choice((1, 100, PAGE))))


def older_page(rng, path, images):
    """A page as it was once: a write that never came to the disk."""
    older = images.of(rng.randrange(COMMITS)) / path.name
    content, before = path.read_bytes(), older.read_bytes() if older.exists() else b""
    begin = rng.randrange(max(1, len(before))) // PAGE * PAGE
    path.write_bytes(content[:begin] + before[begin : begin + PAGE] + content[begin + PAGE :])


def older_file(rng, path, images):
    """The file or the log alone as it was once."""
    older = images.of(rng.randrange(COMMITS)) / path.name
    if older.exists():
        shutil.copyfile(older, path)


def no_file(_rng, path, _images):
    """One without the other; a folder without both is a new one."""
    if path.with_name(LOG).exists():
        path.unlink()


BYTES = (*(flipped,) * 3, *(truncated,) * 2, *(zeroed,) * 2, lengthened, older_page, older_file, no_file)


def _rows(connection, table):
    return [row for (row,) in connection.execute(f"SELECT rowid FROM {table} ORDER BY rowid")]


def row_missing(rng, connection, _older):
    table = rng.choice(("tiles", "tiles", "placing", "state", "settings"))
    connection.execute(f"DELETE FROM {table} WHERE rowid = ?", (rng.choice(_rows(connection, table)),))


def row_older(rng, connection, older):
    """A row, good by itself, as it was once."""
    table = rng.choice(("tiles", "tiles", "placing", "state"))
    row_id = rng.choice(_rows(older, table))
    row = older.execute(f"SELECT * FROM {table} WHERE rowid = ?", (row_id,)).fetchone()
    marks = ", ".join("?" * len(row))
    connection.execute(f"INSERT OR REPLACE INTO {table} VALUES ({marks})", row)


def row_of_another(rng, connection, _older):
    """Two tiles' records change places."""
    one, other = rng.sample(_rows(connection, "tiles"), 2)
    ask = "SELECT revision, record, digest FROM tiles WHERE rowid = ?"
    rows = [connection.execute(ask, (row_id,)).fetchone() for row_id in (one, other)]
    change = "UPDATE tiles SET revision = ?, record = ?, digest = ? WHERE rowid = ?"
    for row_id, row in zip((other, one), rows, strict=True):
        connection.execute(change, (*row, row_id))


def field_changed(rng, connection, _older):
    table, field, value = rng.choice(
        [
            ("tiles", "revision", 1000),
            ("tiles", "tx", 77),
            ("tiles", "tx", -(2**62)),
            ("tiles", "record", b""),
            ("tiles", "digest", bytes(16)),
            ("tiles", "revision", "text"),
            ("placing", "key", "robot9"),
            ("placing", "value", b"other"),
            ("state", "root", bytes(16)),
            ("state", "text", "{}"),
            ("state", "digest", 7),
            ("settings", "text", "{}"),
            ("settings", "digest", b""),
        ]
    )
    row = rng.choice(_rows(connection, table))
    connection.execute(f"UPDATE {table} SET {field} = ? WHERE rowid = ?", (value, row))


ROWS = (row_missing, row_missing, row_older, row_older, row_of_another, field_changed)


def tamper(rng, images, place):
    """Make a damaged store in `place`; the name of what was done."""
    k = COMMITS if rng.random() < 0.4 else rng.randrange(1, COMMITS)
    shutil.copytree(images.of(k), place)
    if rng.random() < 0.35:
        kind = rng.choice(ROWS)
        with (
            closing(sqlite3.connect(place / FILE)) as connection,
            closing(_older(images, rng, place)) as older,
        ):
            kind(rng, connection, older)
            connection.commit()
        return kind.__name__
    kind = rng.choice(BYTES)
    log = place / LOG
    path = log if log.exists() and log.stat().st_size and rng.random() < 0.5 else place / FILE
    kind(rng, path, images)
    return f"{kind.__name__}, {'log' if path == log else 'file'}"


def _older(images, rng, place):
    folder = place.with_name(f"{place.name}-older")
    shutil.copytree(images.of(rng.randrange(COMMITS)), folder)
    return sqlite3.connect(folder / FILE)


def outcome(images, place):
    """What a mapper makes of a store: "refused", or "exact"; AssertionError if it takes a wrong map."""
    try:
        with MapStore(place) as store:
            found = restored(store, images.settings)
    except BadStore as error:
        if 30 < len(str(error)) < 2000 + 2 * len(str(place)):
            return "refused"
        raise
    assert found in images.states, "a map that never was"
    _goes_on(images, place)
    return "exact"


def _goes_on(images, place):
    """What was restored can be stored again, with more: nothing is damaged that nobody has looked at."""
    with MapStore(place) as store:
        story = Story.going_on(store, store.restore(images.settings))
        for _ in range(3):
            story.integrate(2)
            story.commit()
    with MapStore(place) as store:
        assert restored(store, images.settings) == story.now, "what was stored after it is not what came back"


def repaired(images, place):
    """What `repair` makes of it: "nothing", "exact" or "in part"; AssertionError if that is not so."""
    out = place.with_name(f"{place.name}-new")
    try:
        report = repair(place, out)
    except BadInput as error:
        if "nothing can be saved" in str(error) or not (place / FILE).exists():
            return "nothing"
        raise
    with MapStore(out) as store:
        found = store.restore(images.settings)
    assert found.grid.epoch != "epoch1"
    found.grid.epoch = "epoch1"
    is_one = fingerprint(found.grid, found.placing) in images.states
    assert is_one or not report.exact, "a map that never was is called exact"
    return "exact" if report.exact else "in part"


def tampered(count, folder, seed=1, **changes):
    """Tamper `count` times; how often each kind of damage had which outcome: {(kind, outcome): times}."""
    images, found = Images(Path(folder), **changes), Counter()
    for k in range(count):
        rng = random.Random(f"{seed} {k}")
        place = Path(folder, f"place{k}")
        kind = tamper(rng, images, place)
        damaged = place.with_name("damaged")
        shutil.copytree(place, damaged)
        try:
            result = outcome(images, place)
            mended = repaired(images, damaged)
        except Exception as error:
            raise AssertionError(f"damage {k}, {kind}: {error!r}") from error
        found[kind, result, mended] += 1
        for used in (place, place.with_name(f"{place.name}-older"), damaged, Path(folder, "damaged-new")):
            shutil.rmtree(used, ignore_errors=True)
    return found


def main(times):
    """Tamper so often, and print a line for each kind of damage."""
    with TemporaryDirectory() as folder:
        found = tampered(times, folder)
    for kind in sorted({kind for kind, _, _ in found}):
        became = Counter()
        for (damage, result, mended), times_found in found.items():
            if damage == kind:
                became["exact" if result == "exact" else f"saved {mended}"] += times_found
        print(kind, *(became[said] for said in ("exact", *SAVED)), sep="; ")


if __name__ == "__main__":
    main(int(sys.argv[1]))
