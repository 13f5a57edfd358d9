"""Rows of tiles in a store: written, read with their digests checked, and copied.

A map that keeps robots apart has rows of the tiles of each, in format 3. The table of others has no robots.
"""

import sqlite3
from collections.abc import Collection, Iterable, Iterator

from ogm_core.cells.model import Plane
from ogm_core.errors import BadStore
from ogm_core.tiles.checkpoint import NOBODY, KeptTile
from ogm_core.tiles.codec import decode_tile, encode_tile
from ogm_services.mapper.storage.digests import Changes, Root, TileName, tile_digest
from ogm_services.mapper.storage.layout import ROBOTS_TABLE, ROBOTS_VERSION

_COLUMNS = "tx, ty, revision, record, digest"


def keeps_robots(connection: sqlite3.Connection) -> bool:
    """Whether each row is one robot's."""
    columns = connection.execute("SELECT name FROM pragma_table_info('tiles')")
    return any(name == "robot" for (name,) in columns)


def name_of(tile: KeptTile) -> TileName:
    """Under which name its row is."""
    return tile.tx, tile.ty, tile.robot


def tiles_query(connection: sqlite3.Connection) -> str:
    """What asks for rows as `read_tile` takes them."""
    robot = "robot" if keeps_robots(connection) else f"'{NOBODY}'"
    return f"SELECT {_COLUMNS}, {robot} FROM tiles"


def begin_tiles(connection: sqlite3.Connection, *, robots: bool) -> None:
    """Have a table without rows, with or without `robots`, inside a transaction."""
    if robots == keeps_robots(connection):
        connection.execute("DELETE FROM tiles")
        return
    if not robots:
        raise BadStore("the map in it keeps robots apart, and cannot become one that does not")
    connection.execute("DROP TABLE tiles")
    connection.execute(ROBOTS_TABLE)
    connection.execute(f"PRAGMA user_version = {ROBOTS_VERSION}")


def write_tiles(connection: sqlite3.Connection, tiles: Iterable[KeptTile]) -> Changes:
    """Write rows of tiles, each in place of the one before; their digests."""
    robots = keeps_robots(connection)
    columns = f"{_COLUMNS}, robot" if robots else _COLUMNS
    write = (
        f"INSERT INTO tiles ({columns}) VALUES (?, ?, ?, ?, ?{', ?' if robots else ''}) ON CONFLICT "
        f"({'robot, ' if robots else ''}tx, ty) DO UPDATE SET "
        "revision = excluded.revision, record = excluded.record, digest = excluded.digest"
    )
    digests: Changes = {}
    for tile in tiles:
        record = encode_tile(tile.planes)
        digest = digests[name_of(tile)] = tile_digest(name_of(tile), tile.revision, record)
        row = (tile.tx, tile.ty, tile.revision, record, digest)
        connection.execute(write, (*row, tile.robot) if robots else row)
    return digests


def delete_robots(connection: sqlite3.Connection, robots: Collection[str], root: Root) -> Changes:
    """Delete the rows of some robots, which are under `root`."""
    for robot in robots:
        connection.execute("DELETE FROM tiles WHERE robot = ?", (robot,))
    return dict.fromkeys(root.tiles_of(robots)) if robots else {}


def copy_tiles(connection: sqlite3.Connection, copy: sqlite3.Connection, root: Root) -> None:
    """Write every row, as it is, into another store, each put under `root`."""
    robots = keeps_robots(connection)
    begin_tiles(copy, robots=robots)
    columns = f"{_COLUMNS}, robot" if robots else _COLUMNS
    write = f"INSERT INTO tiles ({columns}) VALUES (?, ?, ?, ?, ?{', ?' if robots else ''})"
    order = "robot, tx, ty" if robots else "tx, ty"
    for row in connection.execute(f"{tiles_query(connection)} ORDER BY {order}"):
        copy.execute(write, row if robots else row[:-1])
        root.put((row[0], row[1], row[5]), row[4])


def read_tile(row: tuple[object, ...], planes: tuple[Plane, ...]) -> tuple[KeptTile, bytes]:
    """A row of `tiles_query` as a tile, and its digest.

    Raises:
        BadStore: it is damaged.
    """
    match row:
        case (int(tx), int(ty), int(revision), bytes(record), bytes(digest), str(robot)):
            pass
        case _:
            raise BadStore("a row of a tile is damaged")
    try:
        if tile_digest((tx, ty, robot), revision, record) != digest:
            raise BadStore("its digest is another")  # noqa: TRY301
        return KeptTile(tx, ty, revision, decode_tile(record, planes), robot), digest
    except BadStore as error:
        whose = f" of robot {robot}" if robot else ""
        raise BadStore(f"tile ({tx}, {ty}){whose}: {error}") from error


def read_tiles(connection: sqlite3.Connection, planes: tuple[Plane, ...], root: Root) -> Iterator[KeptTile]:
    """Every tile, robot by robot, each put under `root`.

    Raises:
        BadStore: one of them is damaged.
    """
    order = " ORDER BY robot" if keeps_robots(connection) else ""
    for row in connection.execute(tiles_query(connection) + order):
        tile, digest = read_tile(row, planes)
        root.put(name_of(tile), digest)
        yield tile
