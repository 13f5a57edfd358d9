"""Repair of a damaged store: what is intact goes into a new one, and what is not is told."""

import json
import os
import shutil
import sqlite3
import uuid
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

import numpy as np

from ogm_core.cells.arrays import CellArrays
from ogm_core.errors import BadInput, BadStore
from ogm_core.lattice import CellRect, Lattice, Region
from ogm_core.tiles.checkpoint import KeptTile, MapState, RobotState
from ogm_core.tiles.store import TILE
from ogm_core.whole_files import write_files
from ogm_services.mapper.storage import rows
from ogm_services.mapper.storage.digests import Root
from ogm_services.mapper.storage.failures import OtherVersion, told_as_failure
from ogm_services.mapper.storage.folder_lock import FILE as LOCK
from ogm_services.mapper.storage.folder_lock import FolderLock
from ogm_services.mapper.storage.layout import FILE, created_file, open_file
from ogm_services.mapper.storage.salvage import Salvage, salvage
from ogm_services.mapper.storage.snapshots import Snapshots, snapshot_path
from ogm_services.mapper.storage.tile_rows import begin_tiles, write_tiles


@dataclass(frozen=True)
class Repaired:
    """What was saved, and what was not."""

    tiles: int
    """Saved."""
    revision: int
    exact: bool
    """Whether the map is, value for value, one that the mapper once had."""
    damaged: tuple[Region, ...]
    """Where the tiles lay that are lost, m; they are unknown now, or what other robots know of them."""
    nameless: int
    """Tiles that are lost, too, and nothing tells where they lay."""
    robots: tuple[str, ...]
    """Parts of the placing state that are lost."""
    snapshots: tuple[str, ...]
    """Those that could not be read."""
    separate: bool = False
    """Whether the map keeps robots apart, so that tiles were lost of some of them."""


def repair(folder: Path, out: Path) -> Repaired:
    """Save what is intact of the store in `folder` into a new one in `out`, under a new epoch.

    `folder` stays as it is. Tiles that are damaged become unknown.

    Raises:
        BadInput: `folder` holds no store, or `out` is not empty, or lies in it.
        BadStore: nothing can be saved.
        StoreInUse: a mapper has one of the folders.
        DiskFull, StoreFails: the new store cannot be written.
    """
    if not (folder / FILE).is_file():
        raise BadInput(f"{folder}: there is no stored map, no file {FILE}")
    if out.exists() and not (out.is_dir() and {path.name for path in out.iterdir()} <= {LOCK}):
        raise BadInput(f"--out {out}: a folder that is empty, or not there yet, is needed")
    if folder.resolve() in out.resolve().parents:
        raise BadInput(f"--out {out}: a folder that is not in {folder} is needed")
    with FolderLock(folder), FolderLock(out), told_as_failure(out):
        with TemporaryDirectory(dir=out) as scratch:
            found = _best_of(folder, Path(scratch))
        state = _write(found, out / FILE)
        lost = tuple(_copied_snapshots(folder, out))
    return Repaired(
        tiles=len(found.tiles),
        revision=state.revision,
        exact=found.exact,
        damaged=tuple(_regions(found)),
        nameless=found.nameless_tiles,
        robots=tuple(sorted(found.damaged_parts)),
        snapshots=lost,
        separate=found.robots,
    )


def _copied_snapshots(folder: Path, out: Path) -> Iterator[str]:
    """Copy every snapshot as it is, damaged or not; the names of those that cannot be read."""
    for name in Snapshots(folder).names():
        path = snapshot_path(folder, name)
        try:
            content = path.read_bytes()
        except OSError:
            yield name
            continue
        copy = snapshot_path(out, name)
        copy.parent.mkdir(exist_ok=True)
        write_files({copy: content})
        os.utime(copy, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns))


def _best_of(folder: Path, scratch: Path) -> Salvage:
    """What can be read of copies: SQLite writes into what it opens. With the log, or what was before it."""
    found: list[Salvage] = []
    reason: Exception | None = None
    for k, names in enumerate(((FILE, f"{FILE}-wal"), (FILE,))):
        place = scratch / str(k)
        place.mkdir()
        for name in names:
            if (folder / name).exists():
                with _readable(folder / name) as source, (place / name).open("wb") as copy:
                    shutil.copyfileobj(source, copy)
        try:
            with closing(open_file(place / FILE)) as connection:
                found.append(salvage(connection))
        except OtherVersion:
            raise
        except (sqlite3.Error, BadStore) as error:
            reason = reason or error
    if not found:
        raise BadStore(f"{folder / FILE}: nothing can be saved of it: {reason}") from reason
    return max(found, key=lambda salvage: (salvage.exact, len(salvage.tiles)))


def _readable(path: Path) -> BinaryIO:
    try:
        return path.open("rb")
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror or error}") from error


def _write(found: Salvage, path: Path) -> MapState:
    with created_file(path) as connection:
        written = rows.write_placing(connection, found.placing)
        begin_tiles(connection, robots=found.robots)
        written |= write_tiles(connection, (tile for tile, _ in found.tiles.values()))
        state = _new_state(found)
        run = "" if found.state is None else found.state.run
        rows.write_state(connection, rows.new_state(state, run, found.settings, Root().changed(written)))
    return state


def _new_state(found: Salvage) -> MapState:
    """The stored state under a new epoch; without one, what the tiles tell."""
    epoch = uuid.uuid4().hex
    tiles = [tile for tile, _ in found.tiles.values()]
    if found.state is not None:
        known = found.state.map.known if found.exact else _known(tiles, found)
        return found.state.map._replace(epoch=epoch, known=known, robots=tuple(_robots(tiles, found)))
    revision = max((tile.revision for tile in tiles), default=0)
    known, room, robots = _known(tiles, found), _room(tiles), tuple(_robots(tiles, found))
    return MapState(epoch, revision, None, 0, known, room, robots=robots)


def _robots(tiles: list[KeptTile], found: Salvage) -> Iterator[RobotState]:
    """The robots of a map that keeps them apart: as they were, or what the tiles tell."""
    if not found.robots:
        return
    stored = () if found.state is None else found.state.map.robots
    if found.exact:
        yield from stored
        return
    since = {robot.robot: robot.since for robot in stored}
    for robot in sorted({tile.robot for tile in tiles}):
        own = [tile for tile in tiles if tile.robot == robot]
        yield RobotState(robot, since.get(robot, 0), _known(own, found), _room(own))


def _room(tiles: Iterable[KeptTile]) -> CellRect:
    rects = (CellRect(tile.tx * TILE, tile.ty * TILE, TILE, TILE) for tile in tiles)
    return _union(rects) or CellRect(0, 0, 0, 0)


def _known(tiles: Iterable[KeptTile], found: Salvage) -> CellRect | None:
    """The smallest rectangle that holds every cell of which something was written."""
    return _union(_written(tile, found) for tile in tiles)


def _written(tile: KeptTile, found: Salvage) -> CellRect:
    sides = {plane.name: plane.side for plane in found.planes}
    planes = {name: cells.reshape(TILE * sides[name], -1) for name, cells in tile.planes.items()}
    up, along = np.nonzero(CellArrays(planes, sides).any_written())
    if not len(up):
        return CellRect(tile.tx * TILE, tile.ty * TILE, 0, 0)
    west, south = int(along.min()), int(up.min())
    size = int(along.max()) - west + 1, int(up.max()) - south + 1
    return CellRect(tile.tx * TILE + west, tile.ty * TILE + south, *size)


def _union(rects: Iterable[CellRect]) -> CellRect | None:
    some = [rect for rect in rects if rect.cells]
    return reduce(CellRect.union, some) if some else None


def _regions(found: Salvage) -> Iterator[Region]:
    """Where the damaged tiles lie, those beside each other from west to east as one."""
    settings = json.loads(found.settings)
    lattice = Lattice(settings["resolution"], tuple(settings["anchor"]))
    left = {(tx, ty) for tx, ty, _ in found.damaged_tiles}
    for tx, ty in sorted(left, key=lambda place: (place[1], place[0])):
        if (tx, ty) not in left:
            continue
        end = tx
        while (end, ty) in left:
            left.remove((end, ty))
            end += 1
        corners = lattice.corner_of(tx * TILE, ty * TILE), lattice.corner_of(end * TILE, (ty + 1) * TILE)
        yield Region(*corners[0], *corners[1])
