"""Reading a store: the whole map, every row of it checked."""

import sqlite3
from dataclasses import dataclass
from pathlib import Path

from ogm_core.errors import BadSetting, BadStore, LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.separate_grid import grid_of
from ogm_services.mapper.storage import rows
from ogm_services.mapper.storage.digests import Root
from ogm_services.mapper.storage.failures import told_as_damage
from ogm_services.mapper.storage.map_settings import planes_in, settings_as_stored
from ogm_services.mapper.storage.rows import StoredState
from ogm_services.mapper.storage.tile_rows import read_tiles


@dataclass(frozen=True, eq=False)
class RestoredMap:
    """What a store holds: the map, and the placing state that goes with it."""

    grid: OccupancyGrid
    placing: dict[str, bytes]
    state: StoredState
    root: Root


def read_map(
    connection: sqlite3.Connection, settings: GridSettings, path: Path, folder: Path | None
) -> RestoredMap | None:
    """The map in a store, value for value; None if there is none.

    `settings` are those that the map goes on with; `path` is the store's file,
    `folder` where the store is, None if it is a snapshot.

    Raises:
        BadStore: the store is damaged; the text says what is, and what to do.
        BadSetting: they contradict those that it was made with; the text names each, with both values.
    """
    with told_as_damage(path, folder):
        rows.check_pages(connection)
        state = rows.read_state(connection)
        if state is None:
            return None
        where = str(folder or path)
        cure = (
            "only a mapper with those shows it"
            if folder is None
            else "give those, or store this map elsewhere"
        )
        grid = grid_of(settings_as_stored(state.settings, settings, where, cure))
        root = Root()
        try:
            grid.restore(state.map, read_tiles(connection, planes_in(state.settings), root))
        except IndexError as error:
            raise BadStore(f"{error} lies outside the map") from error
        except LimitReached as error:
            raise BadSetting(f"{where}: the map that is stored there: {error}: raise it") from error
        placing = rows.read_placing(connection, root)
        rows.check_root(state, root)
    return RestoredMap(grid, placing, state, root)
