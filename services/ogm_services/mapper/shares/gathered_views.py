"""Views of a gathered map: what answers see of it (a `live.served_map.ServedMap`), by either of its names."""

import math
import threading
import time
from collections.abc import Callable

from ogm_core.lattice import Lattice, Region
from ogm_core.snapshot import MapSnapshot
from ogm_core.status import MapInfo
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.live_figures import Judged, LiveFigures, MapWithFigures
from ogm_services.mapper.shares.gathered_map import Gathered, GatheredMap


class GatheredView(MapWithFigures):
    """A gathered map as it is named, by `now`, and copied, by `made`. Any thread."""

    def __init__(
        self,
        gathered: GatheredMap,
        now: Callable[[Gathered], Identity],
        made: Callable[[Gathered], MapSnapshot],
    ) -> None:
        self._gathered = gathered
        self._now = now
        self._made = made
        self.asked = -math.inf
        """When somebody asked last which map it is, or for it, s of the monotonic clock."""
        self._making = threading.Lock()
        self._copy: tuple[Gathered, MapSnapshot] | None = None
        """The newest snapshot, and of what; `_making` guards it."""
        super().__init__(LiveFigures(lambda: self.now, lambda: self.snapshot().known_cells, self._to_judge))

    @property
    def now(self) -> Identity:
        """See `ServedMap`."""
        self.asked = time.monotonic()
        return self._now(self._gathered.state)

    @property
    def free_below(self) -> float:
        """See `ServedMap`."""
        return self._gathered.settings.cell_model.free_below

    @property
    def finest(self) -> Lattice:
        """See `ServedMap`."""
        return self._gathered.settings.finest_lattice

    @property
    def newest_copy(self) -> MapSnapshot | None:
        """See `ServedMap`."""
        copy = self._copy
        return None if copy is None else copy[1]

    def snapshot(self) -> MapSnapshot:
        """See `ServedMap`."""
        self.asked = time.monotonic()
        with self._making:
            state = self._gathered.state
            if self._copy is None or self._copy[0] is not state:
                self._copy = state, self._made(state)
            return self._copy[1]

    def ahead_of_copy(self) -> None:
        """None: what has come since a copy is not known here scan by scan."""
        return

    def cells_in(self, region: Region | None, *, finest: bool = False) -> int:
        """See `ServedMap`."""
        rect, settings = self._gathered.state.extent(), self._gathered.settings
        cells = rect.cells if region is None else rect.intersection(settings.lattice.cover(region)).cells
        return cells * settings.cell_model.finest**2 if finest else cells

    def info(self) -> MapInfo:
        """See `ServedMap`."""
        state = self._gathered.state
        extent = state.extent()
        return MapInfo(
            known_cells=self._figures.known_cells(),
            bytes=state.copies.nbytes,
            width=extent.width,
            height=extent.height,
            resolution=self._gathered.settings.resolution,
        )

    def _to_judge(self) -> Judged:
        return Judged(self.snapshot().finest(), self._gathered.settings, [], 0)


def told_map(gathered: GatheredMap) -> GatheredView:
    """The map as it is named to all the world."""
    return GatheredView(gathered, lambda state: state.named, gathered.told)


def followed_map(gathered: GatheredMap) -> GatheredView:
    """The map as it is named to who follows this gateway."""
    return GatheredView(gathered, lambda state: state.named_by(gathered.run), gathered.followed)
