"""Maps that keep robots apart: what each has seen by itself, and the sum, which is the map.

    robot a    planes --+
    robot b    planes --+--> sum: the tiles, copies and snapshots of an OccupancyGrid
    nobody     planes --+    (what the map began with: it is never left out)

A scan is counted twice, in its robot's planes and in the sum. Sums stop where the planes of a robot do, at
the largest number that a plane holds: in whatever order scans come, the sum is that of the robots' planes.
To leave one out, the tiles that it has written are summed anew, of those of the others; where no
other has written they take no memory any more.
"""

import sys
from collections.abc import Callable, Iterable
from functools import reduce
from itertools import groupby

import numpy as np

from ogm_core.cells.model import Planes
from ogm_core.errors import SMALLER_MAP, NoRoom, UnknownRobot, cut
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.sensor_models.evidence import Evidence
from ogm_core.tiles.aging import Aging
from ogm_core.tiles.checkpoint import NOBODY, Checkpoint, KeptCells, KeptTile, MapState, RobotState
from ogm_core.tiles.copies import CopyAhead, TileCopies, Tiles
from ogm_core.tiles.erasing import erase, written_rect
from ogm_core.tiles.polygon import Polygon
from ogm_core.tiles.store import TileStore
from ogm_core.tiles.summing import empty, mark, revisions_at, sum_tiles, written_tiles
from ogm_core.types import PlacedScan, Pose, Scan, Sweep

_MOST_NAMED = 20


def grid_of(settings: GridSettings, epoch: str = "", run: str = "") -> OccupancyGrid:
    """An empty map of these settings; arguments as `OccupancyGrid` has them."""
    return (SeparateGrid if settings.separate_robots else OccupancyGrid)(settings, epoch, run)


class RobotPlanes(OccupancyGrid):
    """A map of one robot's scans, the revisions of which are those of the map that it is a part of."""

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


class SeparateGrid(OccupancyGrid):
    """A map that keeps robots apart. Its own planes are the sum."""

    def reset(self, epoch: str) -> None:
        """Forget every cell and every robot; see `OccupancyGrid.reset`."""
        self._robots: dict[str, RobotPlanes] = {}
        self._writing: RobotPlanes
        """Whose scan is being counted."""
        self.kept_bytes = 0
        super().reset(epoch)

    @property
    def nbytes(self) -> int:
        """Bytes that all planes have allocated."""
        return super().nbytes + sum(planes.nbytes for planes in self._robots.values())

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots that are in the map, by name."""
        return tuple(sorted(self._robots.keys() - {NOBODY}))

    def begin_with(self, planes: Planes, offset: tuple[int, int] = (0, 0)) -> None:
        """Fill an empty map with what no robot has seen; see `OccupancyGrid.begin_with`."""
        nobody = RobotPlanes(self.settings, 0)
        nobody.begin_with(planes, offset)
        self.settings.check_bytes(2 * nobody.nbytes)
        super().begin_with(planes, offset)
        self._robots[NOBODY] = nobody

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None, robot: str = NOBODY) -> int:
        """Add a scan that `robot` took; see `OccupancyGrid.integrate`."""
        planes = self._robots.get(robot)
        self._writing = RobotPlanes(self.settings, self.revision) if planes is None else planes
        updates = super().integrate(scan, pose, sweep)
        if planes is None and self._writing.revision:
            self._robots[robot] = self._writing
        return updates

    def _add_at_once(self, placed: PlacedScan) -> int | None:
        """Nothing: there are two stores."""
        return None

    def _add(self, evidence: Evidence, updated: CellRect, aging: Aging | None) -> int:
        updates = super()._add(evidence, updated, aging)  # having made room in both
        # By one thread: what could run out of memory now would leave the two apart.
        self._writing.count(evidence, updated, self.revision)
        return updates

    def _make_room(self, evidence: Evidence, updated: CellRect) -> TileStore:
        """Have room in the robot's planes and in the sum, which needs no more new tiles than these."""
        allowed = self.max_bytes
        half = max(0, allowed - self.nbytes) // 2
        try:
            self._writing.make_room(evidence, updated, half)
            self.max_bytes = super().nbytes + half
            return super()._make_room(evidence, updated)
        except NoRoom as refusal:
            raise NoRoom(
                f"it needs new tiles of {self._store.tile_bytes} bytes, for its robot and for the sum of "
                f"all, for which mapper.max_bytes = {allowed} has no room: raise it, {SMALLER_MAP}",
                "max_bytes",
            ) from refusal
        finally:
            self.max_bytes = allowed

    def erase(self, area: Polygon) -> int:
        """Make cells unknown, whoever has seen them; see `OccupancyGrid.erase`."""
        erased = super().erase(area)
        for planes in self._robots.values():
            planes.erase_cells(area, self.revision)
        self._know()
        return erased

    def forget(self, robot: str) -> None:
        """Leave a robot out: the map is that of all others' scans. The revision grows by one.

        Scans of it that come later are added as those of a robot that is new.

        Raises:
            UnknownRobot: it is not in the map; nothing has changed.
        """
        if robot not in self.robots:
            named = ", ".join(self.robots[:_MOST_NAMED]) or "none"
            raise UnknownRobot(f"robot {cut(robot)}: it is not in the map; there are: {named}")
        gone = written_tiles(self._robots.pop(robot).store)
        self.revision += 1
        self.erasures += 1
        left = np.zeros(len(gone), np.bool_)
        for store in self._stores:
            written = revisions_at(store, gone) > 0
            mark(store, gone[written], self.revision)
            left |= written
        sum_tiles(self._store, gone[left], self._stores, self.model.add)
        mark(self._store, gone[left], self.revision)
        empty(self._store, gone[~left], self.revision)
        self._know()

    def copies_ahead(self) -> list[CopyAhead]:
        """Of every robot's planes: a checkpoint copies those, and the sum is made of them."""
        return [planes.copy_ahead() for planes in self._robots.values()]

    def take_ahead(self, ahead: CopyAhead, made: TileCopies) -> None:
        """Take what `ahead` has made, whosesoever planes it has copied."""
        for planes in self._robots.values():
            planes.take_ahead(ahead, made)

    @property
    def uncopied_bytes(self) -> int:
        """How much the next checkpoint has to copy."""
        return sum(planes.uncopied_bytes for planes in self._robots.values())

    def room_for_checkpoint(self) -> Callable[[], Tiles]:
        """What makes no memory ready: whose planes will have to be copied nobody knows."""
        return dict

    def checkpoint(self, room: Tiles | None = None) -> Checkpoint:
        """The robots' planes as they are now, for a store; see `OccupancyGrid.checkpoint`."""
        kept = [planes.kept(robot, self.revision) for robot, planes in self._robots.items()]
        states, cells = tuple(state for state, _ in kept), tuple(cells for _, cells in kept)
        self.kept_bytes = sum(robot.copies.nbytes for robot in cells)
        return Checkpoint(self._state()._replace(robots=states), cells)

    def restore(self, state: MapState, tiles: Iterable[KeptTile]) -> None:
        """Become the map of a checkpoint; its tiles come robot by robot. See `OccupancyGrid.restore`.

        Raises:
            IndexError: a tile is of a robot that is not in the map.
        """
        super().restore(state, ())
        of = {robot.robot: RobotPlanes.of(self.settings, robot, state.revision) for robot in state.robots}
        self._robots = of
        for robot, its_tiles in groupby(tiles, lambda tile: tile.robot):
            if robot not in of:
                raise IndexError(f"robot {cut(robot)!r}")
            of[robot].store.put(its_tiles)
            self.settings.check_bytes(self.nbytes)
        written = [written_tiles(store) for store in self._stores]
        places = np.unique(np.concatenate((*written, np.empty((0, 2), np.int64))), axis=0)
        revisions = np.array([revisions_at(store, places) for store in self._stores])
        mark(self._store, places, revisions.max(axis=0, initial=0))
        self.settings.check_bytes(self.nbytes)
        sum_tiles(self._store, places, self._stores, self.model.add)

    @property
    def _stores(self) -> list[TileStore]:
        return [planes.store for planes in self._robots.values()]

    def _know(self) -> None:
        """Have known what some robot knows, or nobody."""
        known = [planes.known for planes in self._robots.values()]
        some = [rect for rect in known if rect is not None]
        self._extent.know(reduce(CellRect.union, some) if some else None)
