"""Planes of one robot in a map that keeps robots apart (see separate_grid)."""

import sys

from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.sensor_models.evidence import Evidence
from ogm_core.tiles.checkpoint import KeptCells, MapState, RobotState
from ogm_core.tiles.erasing import erase, written_rect
from ogm_core.tiles.polygon import Polygon
from ogm_core.tiles.store import TileStore


class RobotPlanes(OccupancyGrid):
    """A map of one robot's scans; its revisions are those of the map that it is a part of."""

    def __init__(self, settings: GridSettings, since: int) -> None:
        """Nothing is known yet, at revision `since` of the map."""
        super().__init__(settings)
        self.since = since

    @property
    def store(self) -> TileStore:
        """Its tiles: the writer's."""
        return self._store

    @property
    def known(self) -> CellRect | None:
        """The smallest rectangle that holds every cell that it knows."""
        return self._extent.known

    def make_room(self, evidence: Evidence, updated: CellRect, more: int) -> None:
        """Have a place for the cells of `updated` in so many bytes more, at most; none changes.

        Raises:
            NoRoom: they are too few.
        """
        self.max_bytes = self.nbytes + more
        self._make_room(evidence, updated)

    def count(self, evidence: Evidence, updated: CellRect, before: int) -> None:
        """Count what a scan says, for which there is room, as that of the revision after `before`."""
        self.revision, self.max_bytes = before, sys.maxsize
        self._add(evidence, updated, None)
        self.revision = before + 1

    def erase_cells(self, area: Polygon, revision: int) -> None:
        """Make the cells unknown whose centre lies in `area`."""
        if erase(self._store, area, area.rect, revision):
            self._extent.know(written_rect(self._store))

    def kept(self, robot: str, revision: int) -> tuple[RobotState, KeptCells]:
        """What a checkpoint of the map has of it, which is now at this revision."""
        self.revision = revision
        made = self.checkpoint()
        state = RobotState(robot, self.since, made.state.known, made.state.room)
        return state, made.cells[0]._replace(robot=robot)

    @classmethod
    def of(cls, settings: GridSettings, state: RobotState, revision: int) -> "RobotPlanes":
        """What a checkpoint at this revision has said of it; the tiles are not in it yet."""
        planes = cls(settings, state.since)
        planes.restore(MapState("", revision, None, 0, state.known, state.room), ())
        return planes
