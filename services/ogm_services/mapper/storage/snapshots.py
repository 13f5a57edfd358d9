"""Named snapshots of a stored map: files beside it, each a store of its own, without placing state."""

import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from ogm_core.errors import BadParameter, BadStore, cut
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.wire.keys import MAX_NAME, NAME
from ogm_services.mapper.storage import rows
from ogm_services.mapper.storage.digests import Root
from ogm_services.mapper.storage.failures import told_as_damage, told_as_failure
from ogm_services.mapper.storage.layout import FILE, created_file, flush_folder, open_file
from ogm_services.mapper.storage.reading import read_map
from ogm_services.replies.answer import UnknownName

FOLDER = "snapshots"
_SUFFIX = ".sqlite"


@dataclass(frozen=True)
class NamedSnapshot:
    """A snapshot as it is listed."""

    name: str
    epoch: str
    revision: int
    stamp: int | None
    nbytes: int
    damage: str | None = None
    """What is wrong with its file, so that the rest is not known; None of most."""


class Snapshots:
    """The named snapshots in a store's folder. The store's thread uses it."""

    def __init__(self, folder: Path, connection: sqlite3.Connection) -> None:
        """`connection`: to the store whose map is saved."""
        self._store = folder
        self._folder = folder / FOLDER
        self._connection = connection

    def save(self, name: str) -> None:
        """Save the map that the store holds under a name that is not taken.

        Raises:
            BadParameter: it is no name, or it is taken, or the store holds no map.
            DiskFull, StoreFails: it cannot be written; there is no such snapshot then.
        """
        path = self._path(name)
        if path.exists():
            raise BadParameter(f"name {name}: there is a snapshot of this name: delete it, or take another")
        with told_as_damage(self._store / FILE, self._store):
            stored = rows.read_state(self._connection)
        if stored is None:
            raise BadParameter(f"name {name}: no map is stored yet: try again in a second")
        root = Root()
        with told_as_failure(path):
            self._folder.mkdir(exist_ok=True)
            flush_folder(self._store)
            with created_file(path) as snapshot:
                for row in self._connection.execute(f"{rows.TILES} ORDER BY tx, ty"):
                    snapshot.execute("INSERT INTO tiles VALUES (?, ?, ?, ?, ?)", row)
                    root.put((row[0], row[1]), row[4])
                rows.write_state(snapshot, rows.new_state(stored.map, stored.run, stored.settings, root))

    def list(self) -> list[NamedSnapshot]:
        """Every snapshot, by name."""
        return [self._listed(path) for path in sorted(self._folder.glob(f"*{_SUFFIX}"))]

    def read(self, name: str, settings: GridSettings, epoch: str | None = None) -> OccupancyGrid:
        """The map that was saved under a name, value for value; under a new `epoch` if one is given.

        Raises:
            UnknownName: there is no such snapshot.
            BadParameter: it is no name.
            BadStore, BadSetting: as `read_map`.
        """
        path = self._existing(name)
        with told_as_damage(path, self._store):
            connection = open_file(path, writing=False)
        with closing(connection):
            restored = read_map(connection, settings, path, self._store)
        if restored is None:
            raise BadStore(f"{path} is damaged: it holds no map: delete this snapshot")
        if epoch is not None:
            restored.grid.epoch = epoch
        return restored.grid

    def delete(self, name: str) -> None:
        """Delete a snapshot.

        Raises:
            UnknownName: there is no such snapshot.
            BadParameter: it is no name.
            StoreFails: it cannot be deleted.
        """
        path = self._existing(name)
        with told_as_failure(path):
            path.unlink()
            flush_folder(self._folder)

    def _existing(self, name: str) -> Path:
        path = self._path(name)
        if not path.exists():
            known = ", ".join(found.stem for found in sorted(self._folder.glob(f"*{_SUFFIX}"))[:20])
            raise UnknownName(f"name {name}: there is no such snapshot; there are: {known or 'none'}")
        return path

    def _path(self, name: str) -> Path:
        if not NAME.fullmatch(name):
            raise BadParameter(f"name {cut(name)!r}: a name is 1 to {MAX_NAME} of A-Z a-z 0-9 _ - .")
        return self._folder / f"{name}{_SUFFIX}"

    def _listed(self, path: Path) -> NamedSnapshot:
        size = path.stat().st_size
        try:
            with told_as_damage(path, self._store), closing(open_file(path, writing=False)) as connection:
                state = rows.read_state(connection)
                if state is None:
                    raise BadStore("it holds no map")  # noqa: TRY301
        except BadStore as error:
            return NamedSnapshot(path.stem, "", 0, None, size, str(error))
        return NamedSnapshot(path.stem, state.map.epoch, state.map.revision, state.map.stamp, size)
