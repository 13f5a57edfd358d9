"""What goes wrong with a store's files, said in one line: damage, and what cannot be written."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ogm_core.errors import BadStore, DiskFull
from ogm_core.whole_files import NO_ROOM
from ogm_services.replies.answer import Unavailable


class StoreFails(Unavailable):
    """A map cannot be stored now; what is stored is what was stored before."""

    slug = "store-fails"


class OtherVersion(BadStore):
    """The store is of a version that this one does not read; nothing is wrong with it."""


@contextmanager
def told_as_damage(path: Path, folder: Path | None) -> Iterator[None]:
    """Say of whatever is wrong with a store's file which file it is, and what to do.

    `folder` has the store, which can be repaired; None: the file is a snapshot, which cannot.

    Raises:
        BadStore: something is.
        StoreFails: another program has it open.
    """
    try:
        yield
    except OtherVersion:
        raise
    except (sqlite3.Error, BadStore) as error:
        if getattr(error, "sqlite_errorname", "").startswith("SQLITE_BUSY"):
            raise StoreFails(f"{path}: another program has it open: end that first") from error
        cure = "delete this snapshot"
        if folder is not None:
            into = "saves what is intact into a new store, and tells what is not"
            cure = f"`ogm repair {folder} --out NEW` {into}"
        raise BadStore(f"{path} is damaged: {error}: {cure}") from error


@contextmanager
def told_as_failure(path: Path) -> Iterator[None]:
    """Say of whatever keeps a file from being written which file it is.

    Raises:
        DiskFull, StoreFails: something does.
    """
    try:
        yield
    except sqlite3.Error as error:
        name = getattr(error, "sqlite_errorname", "")
        if name == "SQLITE_FULL":
            raise DiskFull(f"{path}: cannot be written: {error}") from error
        raise StoreFails(f"{path}: cannot be written: {error} ({name})") from error
    except OSError as error:
        kind = DiskFull if error.errno in NO_ROOM else StoreFails
        raise kind(f"{path}: cannot be written: {error.strerror or error}") from error
