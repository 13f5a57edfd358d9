"""Map store: a map on disk, in a folder of its own, always as it was after an exact scan.

    DIR/lock           held by the one process that has the store
    DIR/map.sqlite     tiles, placing state, settings and state, with a root over all of them
    DIR/snapshots/     the map under names (see snapshots)

Each commit is one transaction: after a crash the store holds what the last one wrote, or the one before.
"""

import contextlib
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Self

from ogm_core.errors import BadStore
from ogm_core.grid_settings import GridSettings
from ogm_core.status import SnapshotInfo
from ogm_core.tiles.checkpoint import Checkpoint, KeptTile
from ogm_services.mapper.storage import rows
from ogm_services.mapper.storage.digests import Root
from ogm_services.mapper.storage.failures import StoreFails, told_as_damage, told_as_failure
from ogm_services.mapper.storage.folder_lock import FolderLock
from ogm_services.mapper.storage.layout import FILE, WAL_BYTES, created_file, flush_folder, open_file
from ogm_services.mapper.storage.map_settings import as_text
from ogm_services.mapper.storage.reading import RestoredMap, read_map
from ogm_services.mapper.storage.rows import StoredState
from ogm_services.mapper.storage.snapshots import Snapshots
from ogm_services.mapper.storage.tile_rows import begin_tiles, delete_robots, write_tiles


class MapStore:
    """A map on disk. The thread that opened it uses it, and closes it."""

    def __init__(self, folder: Path) -> None:
        """Lock the folder and open the store in it; make both if need be.

        Raises:
            StoreInUse: another process has the folder.
            BadStore: what is there is damaged, or of another version.
            BadInput: there can be no such folder.
            DiskFull, StoreFails: there is no store, and none can be made.
        """
        self.folder = folder
        self.path = folder / FILE
        self._wal = folder / f"{FILE}-wal"
        self._files: dict[Path, tuple[int, int]] = {}
        """Those that are written into: which they are, by where they were."""
        self._root = Root()
        self._state: StoredState | None = None
        self._unstored: dict[str, bytes | None] = {}
        self._looked = False
        self._lock = FolderLock(folder)
        try:
            self._connection = self._opened()
            self._files[self.path] = _which(self.path)
            self.snapshots = Snapshots(folder)
            self.snapshots.clear_unfinished()
        except BaseException:
            self._lock.release()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the store."""
        self._connection.close()
        self._lock.release()

    @property
    def nbytes(self) -> int:
        """Bytes of its file and its log."""
        return sum(path.stat().st_size for path in (self.path, self._wal) if path.exists())

    @property
    def empty(self) -> bool:
        """Whether it holds no map.

        Raises:
            BadStore: it is damaged.
        """
        with told_as_damage(self.path, self.folder):
            return rows.read_state(self._connection) is None

    def restore(self, settings: GridSettings) -> RestoredMap | None:
        """The map that is stored, value for value; None if there is none. Before the first commit.

        Raises:
            BadStore, BadSetting: as `read_map`.
        """
        restored = read_map(self._connection, settings, self.path, self.folder)
        self._looked = True
        if restored is not None:
            self._state, self._root = restored.state, restored.root
        return restored

    def holds(self, checkpoint: Checkpoint) -> bool:
        """Whether that map is stored in the folder, and all of the placing state that was given."""
        known = self._state is not None and self._state.map == checkpoint.state and not self._unstored
        return known and self._displaced() is None

    def commit(
        self,
        checkpoint: Checkpoint,
        settings: GridSettings,
        run: str,
        placing: Mapping[str, bytes | None],
    ) -> None:
        """Store a map, and the parts of the placing state that have changed since they were last given.

        A part that is None is there no more. What earlier commits have failed to store is stored, too.
        A store that was there before is restored first.

        Raises:
            DiskFull, StoreFails: nothing of it is stored, and nothing forgotten.
        """
        if not self._looked:
            raise RuntimeError("a store that was there before is restored, or its map would be lost")
        self._unstored.update(placing)
        displaced = self._displaced()
        if displaced is not None:
            raise StoreFails(
                f"{displaced}: it was moved, deleted or replaced while its mapper runs: put it back"
            )
        before = self._state
        whole = before is None or before.map.epoch != checkpoint.state.epoch
        text = as_text(settings)
        with self._transaction():
            changes = rows.write_placing(self._connection, self._unstored)
            if whole:
                begin_tiles(self._connection, robots=settings.separate_robots)
            else:
                gone = _gone_robots(checkpoint, before)
                changes |= delete_robots(self._connection, gone, self._root)
            unstored = _unstored_tiles(checkpoint, None if whole else before)
            changes |= write_tiles(self._connection, unstored)
            root = self._root.changed(changes, without_tiles=whole)
            state = rows.new_state(checkpoint.state, run, text, root)
            rows.write_state(self._connection, state)
        self._root, self._state, self._unstored = root, state, {}
        with told_as_failure(self.path):
            self._files.setdefault(self._wal, _which(self._wal))
            if whole or self._wal.stat().st_size > WAL_BYTES:
                self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")

    def save(self, name: str, run: str | None = None) -> SnapshotInfo:
        """Save the map that is stored under a name; see `Snapshots.save`."""
        return self.snapshots.save(name, self._connection, run)

    def _displaced(self) -> Path | None:
        """A file that is written into, and is no longer what the next process will find in its place."""
        for path, which in self._files.items():
            try:
                if _which(path) != which:
                    return path
            except OSError:
                return path
        return None

    def _opened(self) -> sqlite3.Connection:
        new = not self.path.exists()
        with told_as_damage(self.path, self.folder):
            if new and self._wal.exists():
                raise BadStore("it is not there, and its log is")
            if not new and not self.path.stat().st_size:
                raise BadStore("it is empty")
            if not new:
                return open_file(self.path)
        with told_as_failure(self.path):
            with created_file(self.path):
                pass
            flush_folder(self.folder.absolute().parent)
            self._looked = True
            return open_file(self.path)

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """What is written inside is on disk in the end, or nothing of it."""
        with told_as_failure(self.path):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                with contextlib.suppress(sqlite3.Error):  # SQLite may have rolled back by itself
                    self._connection.execute("ROLLBACK")
                raise


def _which(path: Path) -> tuple[int, int]:
    """Which file it is, wherever it lies."""
    file = path.stat()
    return file.st_dev, file.st_ino


def _gone_robots(checkpoint: Checkpoint, before: StoredState | None) -> set[str]:
    """The robots that are stored, and have been forgotten since; they may have come again."""
    if before is None:
        return set()
    since = {robot.robot: robot.since for robot in checkpoint.state.robots}
    return {robot.robot for robot in before.map.robots if since.get(robot.robot) != robot.since}


def _unstored_tiles(checkpoint: Checkpoint, before: StoredState | None) -> Iterator[KeptTile]:
    """The tiles that have changed since what is stored; all without that."""
    if before is None:
        return checkpoint.tiles_since(0)
    if before.map.revision == checkpoint.state.revision:  # those that a map began with have changed as little
        return iter(())
    return checkpoint.tiles_since(before.map.revision)
