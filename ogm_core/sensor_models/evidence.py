"""Inverse sensor models behind one face: what a placed scan says about which cells.

A scan is read beam by beam (`bresenham`, `dda`) or as sectors (`area_fill`), which come as `spans`. These
kernels tell which rectangle the updated cells fill, count the tiles that they need, and update them. Only the
last, and what finds a scan's sectors, lets go of Python's global lock: to take it again costs a thread more
than the other kernels, which take microseconds.
"""

import math
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import BadParameter, LimitReached, OutsideBounds
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.sensor_models import area_fill, beams, bresenham, counted_beams, dda, passing, spans
from ogm_core.sensor_models.area_outline import Rays, fan_of, heading_of, turned
from ogm_core.sensor_models.beams import Plain
from ogm_core.sensor_models.projection import beam_model, project, read_only
from ogm_core.sensor_models.scan_size import ScanSize
from ogm_core.sensor_models.true_line import MAX_COLUMNS, SUBCELLS
from ogm_core.tiles.store import TILE, TileStore
from ogm_core.types import PlacedScan, Scan

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

    def window(self, store: TileStore, inside: CellRect) -> CellRect:
        """`inside`, which shares the store's lower-left corner, as the kernels count."""
        return CellRect(
            store.rect.ix - self.base[0], store.rect.iy - self.base[1], inside.width, inside.height
        )

    def new_tiles(self, store: TileStore, window: CellRect) -> int:
        """How many tiles `update_cells` would write that were never written before."""
        return int(self.kernels.touch_tiles(*self.arrays, tuple(window), store.touched.copy(), 1))

    def touch(self, store: TileStore, window: CellRect, revision: int) -> None:
        """Mark every tile that `update_cells` would write with `revision`.

        In a part of a store that begins inside a tile also those of it that the part before has to mark.
        """
        plane = next(iter(store.planes.values()))
        west = int(plane.column[0]) % (TILE * plane.side) // plane.side
        whole = window.ix - west, window.iy, window.width + west, window.height
        store.tiles_used += int(self.kernels.touch_tiles(*self.arrays, whole, store.touched, revision))

    def update_cells(
        self, store: TileStore, window: CellRect, revision: int, plane: str, constants: Plain
    ) -> int:
        """Let `cells.updates` change the cells of a plane that lie in the window, and mark their tiles.

        Which of its updates that is, the plane's dtype says; `constants` are theirs. Returns how many.

        Raises:
            ValueError: the plane is finer than the cells, which these kernels count.
        """
        stored = store.planes[plane]
        if stored.side != 1:
            raise ValueError(f"plane {plane}: {stored.side} x {stored.side} numbers a cell, 1 is needed")
        updates, fresh = self.kernels.update_cells(
            *self.arrays, tuple(window), store.touched, revision, stored.cells, stored.column, constants
        )
        store.tiles_used += fresh
        return int(updates)

    def update_planes(self, store: TileStore, window: CellRect, revision: int) -> int:
        """Count in all planes of the store at once, those of cells and those of halves, as `passing` does.

        Returns how many updates.
        """
        updates, fresh = self.kernels.update_planes(
            *self.arrays, tuple(window), store.touched, revision, store.columns, store.cells
        )
        store.tiles_used += fresh
        return int(updates)


def observe(placed: PlacedScan, settings: GridSettings) -> Evidence:
    """Read a placed scan as the settings say.

    Raises:
        LimitReached: the sensor or a beam's end is farther away than cells can be addressed, or the scan
            speaks of more cells than one may, or is larger than any map may be.
        OutsideBounds: every beam that counts leaves bounds that drop such beams.
    """
    if settings.sensor_model == "sector":
        return _seen(placed, settings)
    if settings.cell_model.lengths:
        return _passed(placed, settings)
    lattice, bounds = settings.lattice, settings.bounds_rect
    exact = settings.traversal == "dda"
    ends, lines = project(placed, lattice, settings, exact=exact)
    if bounds is not None and settings.outside == "drop":
        _drop_outside(ends, bounds)
    if may_be_too_large(placed.scan, settings):
        _check_size(beams.count_cells(ends, exact), settings)
    return Evidence(dda, (ends, lines)) if exact else Evidence(bresenham, (ends,))


def _passed(placed: PlacedScan, settings: GridSettings) -> Evidence:
    """Read a placed scan as lengths of passing, and hits."""
    bounds, scan = settings.bounds_rect, placed.scan
    ends, _ = project(placed, settings.lattice, settings, subcells=SUBCELLS)
    _check_length(ends, scan, settings)
    if bounds is not None and settings.outside == "drop":
        _drop_outside(ends, CellRect(*(SUBCELLS * edge for edge in bounds)))
    if may_be_too_large(scan, settings):
        _check_size(beams.count_cells(ends, False) / SUBCELLS, settings)
    weights = counted_beams.weigh(read_only(scan.ranges), tuple(beam_model(scan, settings)), ends)
    return Evidence(passing, (ends, weights))


def may_be_refused(scan: Scan, settings: GridSettings) -> bool:
    """Whether a scan could be refused for its many or long beams alone, which is seldom: known at once."""
    counts = settings.cell_model.lengths
    return may_be_too_large(scan, settings) or (counts and _may_be_too_long(scan, settings))


def _may_be_too_long(scan: Scan, settings: GridSettings) -> bool:
    reach = settings.distances[2] if scan.reach is None else scan.reach
    return min(scan.range_max, reach) >= (MAX_COLUMNS - 2) * settings.resolution


def _check_length(ends: NDArray[np.int64], scan: Scan, settings: GridSettings) -> None:
    """Refuse a scan with a beam across more cells than lines are exact for."""
    if not _may_be_too_long(scan, settings):
        return
    across = np.abs(ends[[beams.IX, beams.IY]] - ends[[beams.IX0, beams.IY0]]).max(initial=0)
    if across >= SUBCELLS * (MAX_COLUMNS - 1):
        raise LimitReached(
            f"a beam across {across // SUBCELLS} cells is longer than the {MAX_COLUMNS - 2} that cell "
            "model rate counts exactly: give a shorter mapper.reach and clear_range, or a larger resolution",
            "too_far",
        )


def _drop_outside(ends: NDArray[np.int64], bounds: CellRect) -> None:
    """Skip the beams that leave the bounds; OutsideBounds if these are all that count."""
    counted, dropped = beams.drop_outside(ends, *bounds)
    if counted and dropped == counted:
        raise OutsideBounds(f"all {counted} beams start or end outside the bounds")


def may_be_too_large(scan: Scan, settings: GridSettings) -> bool:
    """Whether a scan could speak of more cells than one may, which is seldom; that is known at once."""
    reach = settings.distances[2] if scan.reach is None else scan.reach
    longest = 1.5 * min(scan.range_max, reach) / settings.resolution + 2.0
    cells = scan.ranges.size * longest
    if settings.sensor_model == "sector":
        cells += math.pi * longest * longest
    return bool(cells > settings.max_scan_cells)


def _check_size(cells: float, settings: GridSettings) -> None:
    if cells > settings.max_scan_cells:
        raise LimitReached(
            f"a scan that speaks of {cells:.0f} cells is more than "
            f"mapper.max_scan_cells = {settings.max_scan_cells}: "
            "raise it, or make the scan smaller: fewer beams, a shorter reach or a larger resolution",
            "max_scan_cells",
        )


def _seen(placed: PlacedScan, settings: GridSettings) -> Evidence:
    """Read a placed scan as sectors, at the sensor's pose of mid sweep."""
    if placed.sweep is not None:
        placed = PlacedScan(placed.scan, placed.sweep.middle)
    lattice, bounds = settings.lattice, settings.bounds_rect
    kinds = np.empty(0, np.int64)
    if bounds is not None and settings.outside == "drop":
        ends = project(placed, lattice, settings).ends
        _drop_outside(ends, bounds)
        kinds = ends[beams.KIND]
    if may_be_too_large(placed.scan, settings):
        counts = placed.scan.ranges if kinds.size == 0 else np.where(kinds, placed.scan.ranges, np.nan)
        _check_size(ScanSize(settings, bounded=False).of(replace(placed.scan, ranges=counts)), settings)
    try:
        sensor_cell, (fu, fv) = lattice.place_of(placed.pose.x, placed.pose.y)
    except BadParameter as error:
        raise LimitReached(f"the sensor is out of reach: {error}: is its pose right?", "too_far") from error
    scan = placed.scan
    heading = heading_of(placed.pose.theta)
    fan = fan_of(float(scan.angle_min), float(scan.angle_increment), scan.ranges.size)
    window = CellRect(0, 0, 0, 0)
    if bounds is not None:
        window = CellRect(bounds.ix - sensor_cell[0], bounds.iy - sensor_cell[1], bounds.width, bounds.height)
    model, ranges, resolution = beam_model(scan, settings), read_only(scan.ranges), float(lattice.resolution)
    place = heading, fu, fv
    looked, seen = area_fill.see(
        ranges, tuple(model), kinds, tuple(fan), place, resolution, tuple(window), settings.max_cells
    )
    if not looked:
        outline = turned(ranges, model, kinds, fan, heading, resolution)
        box = CellRect(*area_fill.box_of(outline[0]))
        _refuse_early(outline, (fu, fv), box, settings)
        seen = area_fill.spans(*outline, fu, fv, box)
    return Evidence(spans, (seen,), sensor_cell)


def _refuse_early(
    outline: tuple[Rays, NDArray[np.int64]],
    place: tuple[float, float],
    box: CellRect,
    settings: GridSettings,
) -> None:
    """Refuse a scan that is certainly too large for any map, before all its cells are listed.

    `place` is where the sensor is within its cell.
    """
    heights = outline[0][3] * outline[0][1]
    extent = CellRect(0, 0, 0, 0)
    for middle in (int(heights.min()), 0, int(heights.max())):
        probe = CellRect(box.ix, middle - _PROBE // 2, box.width, _PROBE)
        found = CellRect(*spans.extent(area_fill.spans(*outline, *place, probe)))
        if found.cells:
            extent = extent.union(found) if extent.cells else found
    settings.check_known(extent.width, extent.height)
