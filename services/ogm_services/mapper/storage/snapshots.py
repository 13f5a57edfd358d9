"""Named snapshots of a stored map: files beside it, each a store of its own, without placing state."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from ogm_core.errors import BadParameter, BadStore, OgmError, cut
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.status import SnapshotInfo
from ogm_core.tiles.store import tile_bytes
from ogm_core.wire.keys import MAX_NAME, NAME
from ogm_services.mapper.storage import rows
from ogm_services.mapper.storage.digests import Root
from ogm_services.mapper.storage.failures import told_as_damage, told_as_failure
from ogm_services.mapper.storage.layout import FILE, created_file, flush_folder, open_file, unfinished
from ogm_services.mapper.storage.map_settings import planes_in
from ogm_services.mapper.storage.reading import read_map
from ogm_services.mapper.storage.rows import StoredState
from ogm_services.mapper.storage.tile_rows import copy_tiles
from ogm_services.replies.answer import NameTaken, UnknownSnapshot

FOLDER = "snapshots"
_SUFFIX = ".sqlite"
_MOST_NAMED = 20


class SavedMap:
    """A snapshot whose file is open: another of its name may take its place, and this one stays as it is."""

    def __init__(self, connection: sqlite3.Connection, state: StoredState, path: Path) -> None:
        self._connection = connection
        self._path = path
        self.state = state

    @property
    def nbytes(self) -> int:
        """What its tiles take in memory, and their sums where they are those of robots, at most."""
        tiles = self.state.tiles * (2 if self.state.map.robots else 1)
        return tiles * tile_bytes(planes_in(self.state.settings))

    def grid(self, settings: GridSettings) -> OccupancyGrid:
        """The map, value for value, every row of it checked.

        Raises:
            BadStore, BadSetting: as `read_map`.
        """
        restored = read_map(self._connection, settings, self._path, None)
        assert restored is not None, "it has a state"
        grid = restored.grid
        grid.run = self.state.run
        return grid


class Snapshots:
    """The named snapshots in a store's folder. Any thread, but that the store's own saves."""

    def __init__(self, folder: Path) -> None:
        """`folder`: the store's."""
        self._store = folder
        self._folder = folder / FOLDER

    def check_free(self, name: str) -> None:
        """Refuse a name under which nothing can be saved.

        Raises:
            BadParameter: it is no name.
            NameTaken: there is a snapshot of this name.
        """
        self._free(name)

    def save(self, name: str, connection: sqlite3.Connection, run: str | None = None) -> SnapshotInfo:
        """Save the map that the store holds under a name that is not taken.

        `connection` is the store's; `run` that of who saves, None: of who has stored it.

        Raises:
            BadParameter: it is no name, or the store holds no map.
            NameTaken: there is a snapshot of this name.
            DiskFull, StoreFails: it cannot be written; there is no such snapshot then.
        """
        path = self._free(name)
        with told_as_damage(self._store / FILE, self._store):
            stored = rows.read_state(connection)
        if stored is None:
            raise BadParameter(f"name {name}: no map is stored yet: try again in a second")
        root = Root()
        with told_as_failure(path):
            self._folder.mkdir(exist_ok=True)
            flush_folder(self._store)
            with created_file(path) as snapshot:
                copy_tiles(connection, snapshot, root)
                state = rows.new_state(stored.map, run or stored.run, stored.settings, root)
                rows.write_state(snapshot, state)
            return _told(path, state)

    def clear_unfinished(self) -> None:
        """Delete what was not finished when the process that saved it was ended. Before anything is saved.

        Raises:
            StoreFails: it cannot be deleted.
        """
        with told_as_failure(self._folder):
            for path in self._folder.glob(unfinished(f"*{_SUFFIX}")):
                path.unlink()

    def names(self) -> tuple[str, ...]:
        """Of every snapshot; whatever else lies in the folder is none, and nobody opens it."""
        ends = len(_SUFFIX)
        found = [path.name[:-ends] for path in self._folder.glob(f"*{_SUFFIX}") if path.is_file()]
        return tuple(sorted(name for name in found if NAME.fullmatch(name)))

    def list(self) -> list[SnapshotInfo]:
        """Every snapshot, by name."""
        found = (self._listed(name) for name in self.names())
        return [snapshot for snapshot in found if snapshot is not None]

    @contextmanager
    def opened(self, name: str) -> Iterator[SavedMap]:
        """The snapshot of a name, as long as it is needed.

        Raises:
            UnknownSnapshot: there is none.
            BadParameter: it is no name.
            BadStore: it is damaged.
        """
        path = self._existing(name)
        with told_as_damage(path, None):
            connection = open_file(path, writing=False)
        with closing(connection):
            with told_as_damage(path, None):
                state = _state_in(connection)
            yield SavedMap(connection, state, path)

    def delete(self, name: str) -> None:
        """Delete a snapshot.

        Raises:
            UnknownSnapshot: there is none of this name.
            BadParameter: it is no name.
            StoreFails: it cannot be deleted.
        """
        path = self._existing(name)
        with told_as_failure(path):
            path.unlink(missing_ok=True)  # somebody else may just have done it
            flush_folder(self._folder)

    def _existing(self, name: str) -> Path:
        path = self._path(name)
        if not path.is_file():
            known = ", ".join(self.names()[:_MOST_NAMED])
            raise UnknownSnapshot(f"name {name}: there is no such snapshot; there are: {known or 'none'}")
        return path

    def _free(self, name: str) -> Path:
        path = self._path(name)
        if path.is_file():
            raise NameTaken(f"name {name}: there is a snapshot of this name: delete it, or take another")
        if path.exists():
            raise NameTaken(f"name {name}: {path} is no file: take another name")
        return path

    def _path(self, name: str) -> Path:
        if not NAME.fullmatch(name):
            raise BadParameter(f"name {cut(name)!r}: a name is 1 to {MAX_NAME} of A-Z a-z 0-9 _ - .")
        return snapshot_path(self._store, name)

    def _listed(self, name: str) -> SnapshotInfo | None:
        """What is told of a snapshot, None of one that is there no more."""
        path = self._path(name)
        try:
            with told_as_damage(path, None), closing(open_file(path, writing=False)) as connection:
                return _told(path, _state_in(connection))
        except FileNotFoundError:
            return None
        except OgmError as error:
            return _told(path, None, str(error)) if path.exists() else None


def snapshot_path(store: Path, name: str) -> Path:
    """Where the snapshot of a name is, or would be, in a store's folder."""
    return store / FOLDER / f"{name}{_SUFFIX}"


def _state_in(connection: sqlite3.Connection) -> StoredState:
    state = rows.read_state(connection)
    if state is None:
        raise BadStore("it holds no map")
    return state


def _told(path: Path, state: StoredState | None, damage: str | None = None) -> SnapshotInfo:
    file = path.stat()
    if state is None:
        return SnapshotInfo(path.stem, "", "", 0, None, file.st_mtime_ns, file.st_size, damage)
    which = state.map.epoch, state.run, state.map.revision, state.map.stamp
    return SnapshotInfo(path.stem, *which, file.st_mtime_ns, file.st_size)
