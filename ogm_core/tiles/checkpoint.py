"""Checkpoint: a map at one revision, as a store on disk keeps it, tile by tile."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.forgetting import MapTime
from ogm_core.lattice import CellRect
from ogm_core.tiles.copies import TileCopies, Tiles
from ogm_core.tiles.store import TILE

NOBODY = ""
"""Whose those tiles are that no robot has written; no robot has this name."""


class MapState(NamedTuple):
    """What a map is beside its settings and its cells."""

    epoch: str
    revision: int
    stamp: int | None
    """Of the newest integrated scan, ns since the Unix epoch."""
    cell_updates: int
    known: CellRect | None
    """The smallest rectangle that holds every known cell, None if there is none."""
    room: CellRect
    """The cells that memory is laid out for: whole tiles."""
    erasures: int = 0
    """How often cells were erased; each was a revision. A store of before there was such a thing has none."""
    time: MapTime = MapTime()
    """How far its time has come, and its ticks; a store of before there were half-lives has none."""
    stretched: CellRect | None = None
    """Of a map with a clip: the rectangle that limits count of the map without one."""
    robots: tuple["RobotState", ...] = ()
    """Of a map that keeps robots apart: those that are in it."""


class RobotState(NamedTuple):
    """What the planes of one robot are beside their cells, in a map that keeps robots apart."""

    robot: str
    """NOBODY: what the map began with."""
    since: int
    """The map's revision before the robot's first scan: another one if it was forgotten and came again."""
    known: CellRect | None
    room: CellRect
    """As those of the map."""


class KeptTile(NamedTuple):
    """A tile of the lattice: its cells are those from (tx, ty) * TILE on."""

    tx: int
    ty: int
    revision: int
    """That of the last scan that wrote into it, of an erasure, or of the last tick that its cells have had.

    Cells that a map begins with have 1.
    """
    planes: Tiles
    """Its stored cells by plane, each shape (cells of a tile,), row after row."""
    robot: str = NOBODY
    """Whose it is, in a map that keeps robots apart."""


class KeptCells(NamedTuple):
    """The cells of a map, or of one robot of those that are kept apart."""

    copies: TileCopies
    touched: NDArray[np.int64]
    """Revision that last wrote into each tile of `copies`, 0: never."""
    robot: str = NOBODY

    def tiles_since(self, revision: int) -> Iterator[KeptTile]:
        """The tiles that were written after `revision`; all that were ever written after 0.

        Tiles that a map at revision 0 began with count as written after it.
        """
        written = self.touched > revision
        tx, ty = np.nonzero(written)
        left, bottom = self.copies.rect.ix // TILE, self.copies.rect.iy // TILE
        for planes, here, rows in self.copies.find(self.copies.numbers[tx, ty]):
            revisions = self.copies.of[tx[here], ty[here]].tolist()
            columns, up = (tx[here] + left).tolist(), (ty[here] + bottom).tolist()
            for x, y, last, row in zip(columns, up, revisions, rows.tolist(), strict=True):
                tile = {name: cells[row] for name, cells in planes.items()}
                yield KeptTile(x, y, last, tile, self.robot)


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """A map at one revision. Nobody changes it any more; any thread reads it."""

    state: MapState
    cells: tuple[KeptCells, ...]
    """The map's, or each robot's in a map that keeps them apart."""

    def tiles_since(self, revision: int) -> Iterator[KeptTile]:
        """The tiles that were written after `revision`, robot by robot; see `KeptCells.tiles_since`."""
        for cells in self.cells:
            yield from cells.tiles_since(revision)
