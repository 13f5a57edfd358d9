"""What can still be read of a damaged store: every row by itself, and what is missing."""

import sqlite3
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from ogm_core.cells.model import Plane
from ogm_core.errors import BadStore
from ogm_core.tiles.checkpoint import NOBODY, KeptTile
from ogm_services.mapper.storage import rows
from ogm_services.mapper.storage.digests import Root, TileName, part_digest, settings_digest
from ogm_services.mapper.storage.map_settings import planes_in
from ogm_services.mapper.storage.rows import StoredState
from ogm_services.mapper.storage.tile_rows import keeps_robots, name_of, read_tile, tiles_query

_UNREADABLE = (sqlite3.Error, BadStore, OverflowError)


@dataclass
class Salvage:
    """The rows of a store that are intact, one by one."""

    settings: str
    planes: tuple[Plane, ...]
    state: StoredState | None
    """None if its row is damaged."""
    tiles: dict[TileName, tuple[KeptTile, bytes]] = field(default_factory=dict)
    """Each with its digest."""
    placing: dict[str, bytes] = field(default_factory=dict)
    damaged_tiles: set[TileName] = field(default_factory=set)
    """Those whose names can still be told."""
    damaged_parts: set[str] = field(default_factory=set)
    exact: bool = False
    """Whether all is there, and of one moment."""
    robots: bool = False
    """Whether the map keeps robots apart."""

    @property
    def nameless_tiles(self) -> int:
        """How many tiles more there were, of which nothing is left to tell where."""
        known = len(self.tiles) + len(self.damaged_tiles)
        return 0 if self.state is None else max(0, self.state.tiles - known)


def salvage(connection: sqlite3.Connection) -> Salvage:
    """Read what is intact.

    Raises:
        BadStore: nothing says of what kind the map was, or there was none.
    """
    settings, state = _settings(connection), None
    with suppress(*_UNREADABLE):
        state = rows.read_state(connection)
    found, query = Salvage(settings, planes_in(settings), state), tiles_query(connection)
    for row_id in _each(connection, "tiles", "rowid"):
        with suppress(*_UNREADABLE):
            row = connection.execute(f"{query} WHERE rowid = ?", (row_id,)).fetchone()
            if row is not None:
                tile, digest = read_tile(row, found.planes)
                found.tiles[name_of(tile)] = tile, digest
    found.robots = keeps_robots(connection)
    for name in _each(connection, "tiles", "robot, tx, ty" if found.robots else f"'{NOBODY}', tx, ty"):
        match name:
            case (str(robot), int(tx), int(ty)) if (tx, ty, robot) not in found.tiles:
                found.damaged_tiles.add((tx, ty, robot))
    _read_placing(connection, found)
    found.exact = state is not None and _is_exact(found, state)
    return found


def _settings(connection: sqlite3.Connection) -> str:
    try:
        text, digest = connection.execute("SELECT text, digest FROM settings").fetchone() or ("", b"")
        if settings_digest(text) != digest:
            raise BadStore("its settings are damaged")
    except (*_UNREADABLE, AttributeError) as error:
        raise BadStore(f"nothing says of what kind the map was: {error}") from error
    return str(text)


def _read_placing(connection: sqlite3.Connection, found: Salvage) -> None:
    for key in _each(connection, "placing", "key"):
        try:
            row = connection.execute(f"{rows.PLACING} WHERE key = ?", (key,)).fetchone()
        except _UNREADABLE:
            row = None
        if row is not None and isinstance(row[1], bytes) and part_digest(str(key), row[1]) == row[2]:
            found.placing[str(key)] = row[1]
        else:
            found.damaged_parts.add(str(key))


def _is_exact(found: Salvage, state: StoredState) -> bool:
    root = Root()
    for name, (_, digest) in found.tiles.items():
        root.put(name, digest)
    for key, value in found.placing.items():
        root.put(key, part_digest(key, value))
    try:
        rows.check_root(state, root)
    except BadStore:
        return False
    return True


def _each(connection: sqlite3.Connection, table: str, columns: str) -> Iterator[object]:
    """Names of a table's rows, as far as they can be read from either end."""
    seen: set[object] = set()
    for way in ("ASC", "DESC"):
        order = ", ".join(f"{column} {way}" for column in columns.split(", "))
        with suppress(*_UNREADABLE):
            for name in connection.execute(f"SELECT {columns} FROM {table} ORDER BY {order}"):
                seen.add(name if len(name) > 1 else name[0])
    return iter(seen)
