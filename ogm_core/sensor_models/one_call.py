"""The common scan in one compiled call, from its ranges to cells: what `evidence` does in several.

Most scans change cells within the rectangle that is known already, in tiles for which there is room, beam by
beam, by constants. Then there is no limit to meet and nothing to grow, and what is left are the kernels that
`evidence` calls. A small scan takes as long for each call from Python, and for what surrounds it, as for its
beams. With all other scans nothing is done here: `evidence` takes them.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cells.model import CellModel
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.sensor_models import beams, bresenham, dda, shared_lines
from ogm_core.sensor_models.beams import Plain
from ogm_core.sensor_models.evidence import may_be_too_large
from ogm_core.sensor_models.projection import beam_model, directions, read_only
from ogm_core.sensor_models.team import Team
from ogm_core.tiles.extent import NO_CELLS, Extent
from ogm_core.tiles.store import TILE_BITS, TileStore
from ogm_core.types import PlacedScan, Scan

_SENSORS = 64
"""So many kinds of scan are remembered."""
_ANYWHERE = CellRect(-(2**60), -(2**60), 2**61, 2**61)
_Kind = tuple[float | None, ...]
_Rect = tuple[int, int, int, int]


class _Sensor(NamedTuple):
    """What all scans of a kind have in common, and the lattice: see `_integrate`."""

    beam: NDArray[np.float64]
    directions: NDArray[np.float64]


class _Place(NamedTuple):
    """Rectangles of a map, each (ix, iy, width, height) in `rects`, and those that change, to compare.

    Its bounds; what limits count as known; its clip; what is known in that; the window of the store. What
    does not exist is everywhere.
    """

    stretched: CellRect
    known: CellRect | None
    stored: CellRect
    rects: NDArray[np.int64]


class OneCall:
    """The way of common scans into one map; its writer's."""

    def __init__(self, settings: GridSettings, plane: str, constants: Plain) -> None:
        self._settings = settings
        self._plane, self._constants = plane, constants
        self._exact = settings.traversal == "dda"
        self.cell_work = (dda if self._exact else bresenham).CELL_WORK
        """How much work a cell is."""
        self.into_plane = plane, constants, self._exact
        """What a team has to know."""
        self._drops = settings.outside == "drop" and settings.bounds is not None
        self._sensors: dict[_Kind, _Sensor | None] = {}
        self._place: _Place | None = None

    @classmethod
    def into(cls, settings: GridSettings, model: CellModel) -> "OneCall | None":
        """None if no scan is that simple for such a map: its model does more, or its cells age first."""
        if settings.sensor_model != "beam" or model.by_cell is None or settings.half_life is not None:
            return None
        return cls(settings, *model.by_cell)

    def integrate(
        self,
        placed: PlacedScan,
        extent: Extent,
        store: TileStore,
        max_bytes: int,
        revision: int,
        team: Team | None = None,
    ) -> int | None:
        """Do what `observe` and the model's `update` do; return the number of cell updates.

        None if this is no common scan: then nothing has changed. `extent` is that of the map. If there is a
        `team` for this store, it helps.
        """
        scan, pose, sweep = placed
        limits = scan.range_min, scan.range_max, scan.clear_range, scan.reach
        kind = scan.angle_min, scan.angle_increment, *limits, scan.ranges.size
        if kind not in self._sensors:
            self._see(kind, scan)
        sensor, place = self._sensors[kind], self._place
        if sensor is None:
            return None
        if place is None or not (
            place.known is extent.known and place.stretched is extent.stretched and place.stored is store.rect
        ):
            place = self._place = self._placed(extent, store.rect)
        if place is None:
            return None
        plane, (x, y, theta) = store.planes[self._plane], pose
        updates, fresh = _integrate(
            read_only(scan.ranges),
            *sensor,
            float(x),
            float(y),
            float(theta),
            None if sweep is None else sweep.beams,
            np.empty((4, scan.ranges.size)) if self._exact else None,
            self._drops,
            place.rects,
            (max_bytes - store.nbytes) // store.tile_bytes,
            store.touched,
            revision,
            plane.cells,
            plane.column,
            self._constants,
            None if team is None else team.arrays,
        )
        store.tiles_used += fresh
        return None if updates < 0 else updates

    def _see(self, kind: _Kind, scan: Scan) -> None:
        """Remember a kind of scan; None where such a scan may speak of more cells than one may."""
        if len(self._sensors) >= _SENSORS:
            self._sensors.clear()
        self._sensors[kind] = None
        if not may_be_too_large(scan, self._settings):
            lattice, model = self._settings.lattice, beam_model(scan, self._settings)
            beam = np.array([*model, *lattice.anchor, lattice.resolution], np.float64)
            self._sensors[kind] = _Sensor(beam, directions(*model[:2], scan.ranges.size))

    def _placed(self, extent: Extent, stored: CellRect) -> _Place | None:
        """None before the first scan."""
        stretched, known, clip = extent.stretched, extent.known, extent.clip or _ANYWHERE
        if stretched is None:
            return None
        inside = extent.bounds or stored
        window = CellRect(stored.ix, stored.iy, inside.width, inside.height)
        rects = extent.whole_bounds or _ANYWHERE, stretched, clip, known or NO_CELLS, window
        return _Place(stretched, known, stored, np.array(rects, np.int64))


@njit(cache=True, nogil=True, error_model="numpy")
def _integrate(
    ranges: NDArray[np.float32],
    beam: NDArray[np.float64],
    turned: NDArray[np.float64],
    x: float,
    y: float,
    theta: float,
    poses: NDArray[np.float64] | None,
    lines: NDArray[np.float64] | None,
    drops: bool,
    rects: NDArray[np.int64],
    room: int,
    touched: NDArray[np.int64],
    revision: int,
    cells: NDArray[np.int16],
    column: NDArray[np.int64],
    constants: Plain,
    team: Plain | None,
) -> tuple[int, int]:
    """Add a common scan to the cells; returns the number of updates, and of tiles that held 0 before.

    -1 and 0 if it is none: nothing is written then. `beam` are the numbers of a BeamModel and of
    LatticeParams, `turned` the `directions` of `beams.project_turned`; x, y and theta the sensor's, or
    `poses` at every beam, None if it stood still; `lines` room for those of projection.Beams, None along
    Bresenham's; `rects` those of `_Place`. Beams that leave the bounds count for nothing if it `drops` them.
    There is `room` for so many more tiles. `team` is that of `shared_lines.update_cells`, or None. The rest
    is that of `bresenham.update_cells`.
    """
    ends = np.empty((5, ranges.size), np.int64)
    drawn = np.empty((4, 0)) if lines is None else lines
    model = beam[0], beam[1], beam[2], beam[3], beam[4], beam[5], beam[6]
    lattice = beam[7], beam[8], beam[9]
    if poses is None:
        projected = beams.project_turned(ranges, model, (x, y, theta), lattice, ends, drawn, turned)
    else:
        projected = beams.project(ranges, model, poses, lattice, ends, drawn)
    if not projected:
        return -1, 0
    bounds, stretched, clip, known, window = rects[0], rects[1], rects[2], rects[3], rects[4]
    if drops:
        counted, dropped = beams.drop_outside(ends, bounds[0], bounds[1], bounds[2], bounds[3])
        if counted and dropped == counted:
            return -1, 0
    updated = _shared(bresenham.extent(ends) if lines is None else dda.extent(ends, drawn), bounds)
    kept = _shared(updated, clip)
    if not (_within(updated, stretched) and _within(kept, known) and _tiles(kept) <= room):
        return -1, 0
    if kept[2] < 1 or kept[3] < 1:
        return 0, 0
    inside = window[0], window[1], window[2], window[3]
    if team is not None:
        return shared_lines.update_cells(
            ends, lines, inside, touched, revision, cells, column, constants, team
        )
    if lines is None:
        return bresenham.update_cells(ends, inside, touched, revision, cells, column, constants)
    return dda.update_cells(ends, drawn, inside, touched, revision, cells, column, constants)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _shared(rect: _Rect, other: NDArray[np.int64]) -> _Rect:
    """The cells that two rectangles (ix, iy, width, height) share; none if width or height is below 1."""
    ix, iy = max(rect[0], other[0]), max(rect[1], other[1])
    right, top = min(rect[0] + rect[2], other[0] + other[2]), min(rect[1] + rect[3], other[1] + other[3])
    return ix, iy, right - ix, top - iy


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _within(rect: _Rect, other: NDArray[np.int64]) -> bool:
    """Whether all cells of a rectangle, if there are any, lie in another."""
    shared = _shared(rect, other)
    return rect[2] < 1 or rect[3] < 1 or shared == rect


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _tiles(rect: _Rect) -> int:
    """How many tiles a rectangle meets."""
    if rect[2] < 1 or rect[3] < 1:
        return 0
    wide = ((rect[0] + rect[2] - 1) >> TILE_BITS) - (rect[0] >> TILE_BITS) + 1
    high = ((rect[1] + rect[3] - 1) >> TILE_BITS) - (rect[1] >> TILE_BITS) + 1
    return wide * high
