"""What a placed scan says about which cells: the sensor models behind one face.

A scan is read beam by beam (ogm_core.bresenham, ogm_core.dda) or as sectors (ogm_core.sector). Each of these
three modules of kernels answers the same questions: which rectangle do the updated cells fill, which tiles,
and then: update them.
"""

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core import beams, bresenham, dda, sector
from ogm_core.errors import LimitReached, OutsideBounds
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.logodds import Update
from ogm_core.projection import project
from ogm_core.star import star_of
from ogm_core.strips import StripStore
from ogm_core.types import PlacedScan

_PROBE = 8
"""Rows at the top, the middle and the bottom of a scan that are looked at first."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Which cells a scan will update. The cells in `arrays` are counted from `base`."""

    kernels: ModuleType
    """Its `extent`, `touch_tiles` and `update_cells` understand `arrays`."""
    arrays: tuple[NDArray[Any], ...]
    base: tuple[int, int] = (0, 0)

    def extent(self) -> CellRect:
        """Smallest rectangle that holds every cell that is updated, were the map unbounded."""
        ix, iy, width, height = self.kernels.extent(*self.arrays)
        return CellRect(ix + self.base[0], iy + self.base[1], width, height)

    def window(self, store: StripStore, inside: CellRect) -> CellRect:
        """`inside`, which shares the store's lower-left corner, as the kernels count."""
        return CellRect(
            store.rect.ix - self.base[0], store.rect.iy - self.base[1], inside.width, inside.height
        )

    def touch_tiles(self, touched: NDArray[np.int64], window: CellRect, revision: int) -> int:
        """Write `revision` into every tile with an updated cell in the window; count those that held 0."""
        return int(self.kernels.touch_tiles(*self.arrays, window, touched, revision))

    def update_cells(self, store: StripStore, window: CellRect, update: Update) -> int:
        """Update the cells that lie in the window; return the number of cell updates."""
        return int(self.kernels.update_cells(*self.arrays, window, store.cells, store.column, update))


def observe(placed: PlacedScan, settings: GridSettings) -> Evidence:
    """Read a placed scan as the settings say.

    Raises:
        LimitReached: the sensor or a beam's end is farther away than cells can be addressed, or the scan is
            larger than any map may be.
        OutsideBounds: every beam that counts leaves bounds that drop such beams.
    """
    lattice, bounds = settings.lattice()
    by_sector = settings.sensor == "sector"
    if by_sector and placed.sweep is not None:
        placed = PlacedScan(placed.scan, placed.sweep.middle)
    exact = settings.traversal == "dda" and not by_sector
    cells, lines = project(placed, lattice, settings, exact=exact)
    if bounds is not None and settings.outside == "drop":
        counted, dropped = beams.drop_outside(cells, *bounds)
        if counted and dropped == counted:
            raise OutsideBounds(f"all {counted} beams start or end outside the bounds")
    if by_sector:
        return _seen(placed, cells[2], settings)
    if exact:
        return Evidence(dda, (cells, lines))
    return Evidence(bresenham, (cells,))


def _seen(placed: PlacedScan, kinds: NDArray[np.int64], settings: GridSettings) -> Evidence:
    """Read a placed scan as sectors; `kinds` says which beams count."""
    lattice, bounds = settings.lattice()
    sensor_cell, (fu, fv) = lattice.place_of(placed.pose.x, placed.pose.y)
    edges = sector.edges_of(*star_of(placed, kinds, lattice.resolution, settings), fv)
    if bounds is not None:
        window = CellRect(bounds.ix - sensor_cell[0], bounds.iy - sensor_cell[1], bounds.width, bounds.height)
    else:
        window = CellRect(*sector.box_of(edges))
        if window.cells > settings.max_cells:
            _refuse_early(edges, fu, fv, window, settings.max_cells)
    return Evidence(sector, (sector.spans(edges, fu, fv, window),), sensor_cell)


def _refuse_early(edges: NDArray[np.float64], fu: float, fv: float, box: CellRect, max_cells: int) -> None:
    """Refuse a scan that is certainly too large for any map, before all its cells are listed."""
    extent = CellRect(0, 0, 0, 0)
    top = box.iy + box.height
    for first in (box.iy, -_PROBE // 2, top - _PROBE):
        probe = CellRect(box.ix, first, box.width, _PROBE)
        found = CellRect(*sector.extent(sector.spans(edges, fu, fv, probe)))
        if found.cells:
            extent = extent.union(found) if extent.cells else found
    if extent.cells > max_cells:
        raise LimitReached(f"a scan of {extent.width} x {extent.height} cells would be more than max_cells")
