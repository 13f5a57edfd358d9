"""Served map: what answers need of a map that changes, whoever writes it."""

import math
from typing import Any, Protocol

from ogm_core.lattice import Lattice, Region
from ogm_core.simulation.worlds import World
from ogm_core.snapshot import MapSnapshot
from ogm_core.status import MapInfo
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.live_map import Ahead


class ServedMap(Protocol):
    """A map that others change: a mapper's own (`LiveMap`), or one that is gathered. Any thread.

    Its snapshots are `tiles.view.TileView`s, of copies whose revisions are the snapshots'.
    """

    @property
    def now(self) -> Identity:
        """Epoch, run, revision and stamp of this moment; waits for nobody."""

    @property
    def free_below(self) -> float:
        """Below which probability known cells count as free."""

    @property
    def finest(self) -> Lattice:
        """The lattice of the finest cells that are served: fixed for the map's life."""

    @property
    def newest_copy(self) -> MapSnapshot | None:
        """The newest snapshot that was taken, None if none was; waits for nobody."""

    def snapshot(self) -> MapSnapshot:
        """The map as it is now; the same object until it changes."""

    def cells_in(self, region: Region | None, *, finest: bool = False) -> int:
        """How many cells of the map a region covers, None: all of them; waits for nobody."""

    def info(self) -> MapInfo:
        """The status's `map_info`."""

    def quality(self, world: World | None = None) -> dict[str, Any]:
        """Quality figures of the map; may be a second old."""

    def fresh_quality(self, world: World | None = None, within: float = math.inf) -> dict[str, Any]:
        """The same of this very moment."""


class WatchedMap(ServedMap, Protocol):
    """A served map that a `Monitor` watches."""

    def count_known(self) -> None:
        """Bring the number of known cells up to date, so that nobody who asks for it need wait."""

    def ahead_of_copy(self) -> Ahead | None:
        """What has come into the map since its newest copy, None if that is not known."""
