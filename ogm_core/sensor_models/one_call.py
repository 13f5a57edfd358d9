"""The common scan in one compiled call, from its ranges to cells: what `evidence` does in several.

Most scans change cells that the store holds, in tiles for which there is room. Then nothing is to be moved,
no limit is met, and what is left are the kernels that `evidence` calls. A small scan takes as long for each
call from Python, and for what surrounds it, as for its beams. With all other scans nothing is done here:
`evidence` takes them.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.blocks import BLOCK_TYPES
from ogm_core.cells.model import CellModel
from ogm_core.errors import BadParameter
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.sensor_models import bresenham, dda, passing, spans
from ogm_core.sensor_models.area_outline import fan_of, heading_of
from ogm_core.sensor_models.beams import Plain
from ogm_core.sensor_models.evidence import may_be_refused
from ogm_core.sensor_models.one_call_kernels import NO_BOUNDS, add_lines, count_beams, fill_area
from ogm_core.sensor_models.projection import beam_model, directions, read_only
from ogm_core.sensor_models.team import Team
from ogm_core.sensor_models.true_line import SUBCELLS
from ogm_core.tiles.extent import NO_CELLS, Extent
from ogm_core.tiles.store import TileStore
from ogm_core.types import PlacedScan, Pose, Scan, Sweep

_SENSORS = 64
"""So many kinds of scan are remembered."""
_ANYWHERE = CellRect(-(2**60), -(2**60), NO_BOUNDS, NO_BOUNDS)
_Kind = tuple[float | None, ...]


class _Sensor(NamedTuple):
    """What all scans of a kind have in common, and the lattice: see one_call_kernels."""

    beam: NDArray[np.float64]
    directions: NDArray[np.float64] | Plain


class _Place(NamedTuple):
    """Rectangles of a map, each (ix, iy, width, height) in `rects`, and those that change, to compare.

    Its bounds; what limits count as known; its clip; what is known in that; the cells that its store keeps.
    What does not exist is everywhere. The kernel lets grow what is known.
    """

    stretched: CellRect
    known: CellRect | None
    stored: CellRect
    rects: NDArray[np.int64]


class OneCall:
    """The way of common scans into one map; its writer's."""

    def __init__(self, settings: GridSettings, by_cell: tuple[str, Plain] | None) -> None:
        self._settings = settings
        self._by_cell = by_cell
        """The plane whose cells change, and by which constants; None: beams are counted, in all planes."""
        self._areas = settings.sensor_model == "sector"
        self._exact = by_cell is not None and settings.traversal == "dda" and not self._areas
        self._kernel: Callable[..., tuple[int, int, bool]] = (
            count_beams if by_cell is None else fill_area if self._areas else add_lines
        )
        lines = passing if by_cell is None else dda if self._exact else bresenham
        self.cell_work: float = (spans if self._areas else lines).CELL_WORK
        """How much work a cell is."""
        self.into_plane = None if by_cell is None or self._areas else (*by_cell, self._exact)
        """What a team has to know; None: no team can help."""
        self._drops = settings.outside == "drop" and settings.bounds is not None
        self._sensors: dict[_Kind, _Sensor | None] = {}
        self._place: _Place | None = None

    @classmethod
    def into(cls, settings: GridSettings, model: CellModel) -> "OneCall | None":
        """None if no scan is that simple for such a map: its model does more, or its cells age first."""
        if settings.half_life is not None or settings.separate_robots:
            return None
        if settings.sensor_model == "sector" and (
            model.planes[0].dtype not in BLOCK_TYPES or (settings.bounds and settings.outside == "drop")
        ):
            return None
        return cls(settings, model.by_cell) if model.by_cell or model.lengths else None

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
        sensor, place = self._sensors[kind], self._placed(extent, store.rect)
        if sensor is None or place is None:
            return None
        at = self._seen_from(pose, sweep)
        if at is None:
            return None
        updates, fresh, grown = self._kernel(
            read_only(scan.ranges),
            *sensor,
            *at,
            self._drops,
            place.rects,
            self._settings.max_cells,
            (max_bytes - store.nbytes) // store.tile_bytes,
            store.touched,
            revision,
            *self._cells_of(store, scan.ranges.size, team),
        )
        store.tiles_used += fresh
        if grown:
            stretched, known = CellRect(*place.rects[1].tolist()), CellRect(*place.rects[3].tolist())
            extent.widen(stretched, known if known.cells else None)
            self._place = _Place(stretched, extent.known, store.rect, place.rects)
        return None if updates < 0 else updates

    def _seen_from(self, pose: Pose, sweep: Sweep | None) -> Plain | None:
        """What the kernel is told of the sensor's pose; None where no cell can be addressed."""
        if not self._areas:
            x, y, theta = pose
            return float(x), float(y), float(theta), None if sweep is None else sweep.beams
        x, y, theta = pose if sweep is None else sweep.middle
        try:
            cell, place = self._settings.lattice.place_of(x, y)
        except BadParameter:
            return None
        return *place, heading_of(theta), cell

    def _cells_of(self, store: TileStore, beams: int, team: Team | None) -> Plain:
        """What the kernel is told of cells: the last of its arguments."""
        if self._by_cell is None:
            return store.columns, store.cells
        plane = store.planes[self._by_cell[0]]
        lines = np.empty((4, beams)) if self._exact else None
        return lines, plane.cells, plane.column, self._by_cell[1], None if team is None else team.arrays

    def _see(self, kind: _Kind, scan: Scan) -> None:
        """Remember a kind of scan; None where it could be refused for its many or long beams."""
        if len(self._sensors) >= _SENSORS:
            self._sensors.clear()
        self._sensors[kind] = None
        if not may_be_refused(scan, self._settings):
            lattice, model = self._settings.lattice, beam_model(scan, self._settings)
            parts = SUBCELLS if self._by_cell is None else 1
            beam = np.array([*model, *lattice.anchor, lattice.resolution / parts], np.float64)
            shape = *model[:2], scan.ranges.size
            self._sensors[kind] = _Sensor(beam, tuple(fan_of(*shape)) if self._areas else directions(*shape))

    def _placed(self, extent: Extent, stored: CellRect) -> _Place | None:
        """None before the first scan."""
        stretched, known, place = extent.stretched, extent.known, self._place
        if stretched is None:
            return None
        if place is None or place[:3] != (stretched, known, stored):
            bounds, clip, inside = extent.whole_bounds, extent.clip, extent.bounds or stored
            window = CellRect(stored.ix, stored.iy, inside.width, inside.height)
            rects = bounds or _ANYWHERE, stretched, clip or _ANYWHERE, known or NO_CELLS, window
            place = self._place = _Place(stretched, known, stored, np.array(rects, np.int64))
        return place
