"""Layout of a store's file: its tables, its version, and how SQLite is to open it."""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from ogm_core.errors import BadStore
from ogm_core.units import MEBIBYTE
from ogm_services.mapper.storage.failures import OtherVersion

FILE = "map.sqlite"
"""Name of the file in a store's folder; SQLite puts its log, map.sqlite-wal, beside it."""
APPLICATION_ID = 0x4F474D31
"""In the file's header: "OGM1", so that other databases are told apart."""
FIRST_VERSION = 1
"""Of the tables and of what is in them."""
SECOND_VERSION = 2
"""Of maps that forget, or in which something was erased, which version 1 knew nothing of."""
ROBOTS_VERSION = VERSION = 3
"""The newest: of maps that keep robots apart."""
WAL_BYTES = MEBIBYTE
"""From this size on the log's pages go into the file, and the log begins anew."""
_PAGE = 4096
_TABLES = f"""
PRAGMA page_size = {_PAGE};
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {FIRST_VERSION};
BEGIN;
CREATE TABLE settings (id INTEGER PRIMARY KEY, text TEXT NOT NULL, digest BLOB NOT NULL);
CREATE TABLE state (id INTEGER PRIMARY KEY, text TEXT NOT NULL, root BLOB NOT NULL, digest BLOB NOT NULL);
CREATE TABLE tiles (
    tx INTEGER NOT NULL, ty INTEGER NOT NULL, revision INTEGER NOT NULL,
    record BLOB NOT NULL, digest BLOB NOT NULL, UNIQUE (tx, ty)
);
CREATE TABLE placing (key TEXT PRIMARY KEY, value BLOB NOT NULL, digest BLOB NOT NULL);
COMMIT;
"""
"""Of settings and state there is one row, its id 1."""
ROBOTS_TABLE = """
CREATE TABLE tiles (
    tx INTEGER NOT NULL, ty INTEGER NOT NULL, revision INTEGER NOT NULL,
    record BLOB NOT NULL, digest BLOB NOT NULL, robot TEXT NOT NULL, UNIQUE (robot, tx, ty)
)
"""
"""In place of the table of tiles, from ROBOTS_VERSION on."""


@contextmanager
def created_file(path: Path) -> Iterator[sqlite3.Connection]:
    """A store without a map, to be filled: it takes its name with all that is in it, or never.

    Raises:
        sqlite3.Error, OSError: it cannot be written; nothing is left of it.
    """
    part = path.with_name(unfinished(path.name))
    try:
        part.unlink(missing_ok=True)
        with closing(sqlite3.connect(part, isolation_level=None)) as connection:
            # Nobody else knows of the file, and half of it is of no use: no journal, and flushed once.
            connection.execute("PRAGMA journal_mode = OFF")
            connection.execute("PRAGMA synchronous = OFF")
            connection.executescript(_TABLES)
            connection.execute("BEGIN")
            yield connection
            connection.execute("COMMIT")
        _flush(part)
        part.replace(path)
        flush_folder(path.parent)
    finally:
        part.unlink(missing_ok=True)


def unfinished(name: str) -> str:
    """Name of a file until it is whole and takes its own."""
    return f".{name}.part"


def open_file(path: Path, *, writing: bool = True) -> sqlite3.Connection:
    """A connection to a store, whose version has been looked at; transactions are begun by hand.

    Raises:
        BadStore: it is no store, or of another version.
        sqlite3.Error: it cannot be opened.
    """
    # Nobody writes it: it is read without locks, a store's file that was copied without its log as well.
    mode = "mode=rw" if writing else "mode=ro&immutable=1"
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?{mode}", isolation_level=None, uri=True)
    try:
        # One process has the folder (see folder_lock): SQLite needs no memory that it shares with others.
        for setting in ("locking_mode = EXCLUSIVE", "trusted_schema = OFF", "cell_size_check = ON"):
            connection.execute(f"PRAGMA {setting}")
        _check_version(connection, path)
        if writing:
            for setting in (
                *("journal_mode = WAL", "synchronous = FULL", "secure_delete = OFF"),
                "wal_autocheckpoint = 0",  # the store does it, and hears of what goes wrong
            ):
                connection.execute(f"PRAGMA {setting}")
    except BaseException:
        connection.close()
        raise
    return connection


def version_of(connection: sqlite3.Connection) -> int:
    """The version of a store."""
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    return int(version)


def _check_version(connection: sqlite3.Connection, path: Path) -> None:
    if connection.execute("PRAGMA application_id").fetchone() != (APPLICATION_ID,):
        raise BadStore("it is no map that ogm has stored")
    version = version_of(connection)
    if version > VERSION:
        raise OtherVersion(
            f"{path}: a newer ogm has stored this map, in format {version}; this one reads format {VERSION}: "
            "use the newer one"
        )
    if version < FIRST_VERSION:
        raise BadStore(f"ogm has never stored a map in format {version}")


def flush_folder(folder: Path) -> None:
    """See to it that the names in a folder are on disk."""
    _flush(folder)


def _flush(path: Path) -> None:
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
