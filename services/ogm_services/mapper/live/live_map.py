"""Live map, the map while it is written: one writer, and any number of readers with copies."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar, cast

from ogm_core.errors import SMALLER_MAP, LimitReached, NoRoom
from ogm_core.grid import OccupancyGrid
from ogm_core.lattice import CellRect, Region
from ogm_core.quality.bounded import bounded_figures
from ogm_core.quality.figures import Consistency, quality_figures
from ogm_core.quality.truth import truth_figures
from ogm_core.simulation.worlds import World
from ogm_core.snapshot import MapSnapshot
from ogm_core.status import MapInfo
from ogm_core.tiles.checkpoint import Checkpoint
from ogm_core.tiles.copies import Tiles
from ogm_core.tiles.polygon import Polygon
from ogm_core.tiles.view import TileView
from ogm_core.types import PlacedScan, Pose, Scan, Sweep
from ogm_core.units import MEBIBYTE
from ogm_services.replies.answer import Unavailable
from ogm_services.runtime.memory import MemoryUse

RECENT_SCANS = 100
"""The live consistency is that of so many newest scans."""
RECENT_BYTES = 64 * MEBIBYTE
"""What they hold at most: of very long scans there are fewer."""
LOOK_PERIOD = 0.05
"""How old a figure of the memory that is left may be, s, while much is."""
_GOOD_PART = 8
_MUCH = 4 * MEBIBYTE
"""More than this the writer does not wait for after a tick, bytes: some milliseconds."""
FIGURES_PERIOD = 1.0
"""Figures of the whole map are computed at most this often, s."""
PATIENT_PERIOD = 3.0
"""Who asks for the status counts the known cells only if nobody did for so long, s: it takes a moment."""

_T = TypeVar("_T")


class _OutOfTime(Exception):
    """Figures have taken as long as they may."""


class Identity(NamedTuple):
    """Which map it is, the process that writes it, and how far it has come."""

    epoch: str
    run: str
    revision: int
    stamp: int | None

    @classmethod
    def of(cls, told: OccupancyGrid | MapSnapshot) -> "Identity":
        """That of a map, or of a copy."""
        return cls(told.epoch, told.run, told.revision, told.stamp)

    @property
    def life(self) -> tuple[str, str]:
        """Within one, a higher revision is a newer map."""
        return self.epoch, self.run


class _State(NamedTuple):
    """What is told of a map without a look at its cells."""

    identity: Identity
    rect: CellRect
    nbytes: int


class LiveMap:
    """An `OccupancyGrid` with one writer and many readers.

    Who owns what: only the worker thread calls `integrate`, `reset`, `become` and `erase`, and `_writing` is
    held while a kernel runs or tiles that have changed are copied out. After each change the writer replaces
    `_state`, a tuple that nobody changes: whoever reads it waits for nobody. Readers (HTTP and Zenoh threads)
    share the newest snapshot, which nobody changes; `_reading` keeps them from making the same copy twice.
    Figures have locks of their own, so that who waits for them holds up nobody else.
    """

    def __init__(self, grid: OccupancyGrid, memory: MemoryUse | None = None) -> None:
        """`memory`: what others hold beside the map, which gets new tiles only while all of it has room."""
        self._grid = grid
        self._memory = memory
        self._recent = _RecentScans(RECENT_BYTES if memory is None else memory.share(RECENT_BYTES))
        self._writing = threading.Lock()
        self._reading = threading.Lock()
        self._snapshot: MapSnapshot | None = None
        self._view: TileView | None = None
        self._copied = 0
        self._state = self._told()
        self._looked = -math.inf, 0
        """When it was added up what the map may hold, s, and what that is, bytes."""
        self._known_cells = _Figure()
        self._quality = _Figure()
        self._stopping = threading.Event()
        if memory is not None:
            memory.add("map", lambda: self._state.nbytes)
            memory.add("copies", self._copies_bytes)
            memory.add("recent", lambda: self._recent.nbytes, self._recent.share)

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Writer: add a scan taken at its sensor's pose; see `OccupancyGrid.integrate`."""
        with self._writing:
            if self._memory is not None:
                self._grid.max_bytes = min(self._grid.settings.max_bytes, self._allowed(self._memory))
            try:
                updates = self._grid.integrate(scan, pose, sweep)
            except NoRoom as refusal:
                raise self._reason_of(refusal) from refusal
            grew, self._state = self._grid.nbytes > self._state.nbytes, self._told()
            self._recent.append(PlacedScan(scan, pose, sweep))
            if grew and self._memory is not None:
                self._memory.make_room()
            return updates

    def reset(self, epoch: str) -> None:
        """Writer: empty the map."""
        with self._writing:
            self._grid.reset(epoch)
            self._state = self._told()
            self._recent.clear()

    def become(self, grid: OccupancyGrid) -> None:
        """Writer: go on with another map on the same lattice, which is this one's from now on.

        Its epoch is none that this map has had; its run is this process's.
        """
        with self._writing:
            self._grid = grid
            self._state = self._told()
            self._recent.clear()

    def erase(self, area: Polygon) -> int:
        """Writer: make the cells of an area unknown; see `OccupancyGrid.erase`.

        Scans of before are no measure of what is left: the live consistency begins anew.
        """
        with self._writing:
            erased = self._grid.erase(area)
            self._state = self._told()
            self._recent.clear()
            return erased

    def copy_ahead(self) -> Tiles:
        """Copy what has changed while the writer goes on: `checkpoint` has next to nothing left to copy.

        Returns memory for that.
        """
        with self._writing:
            ahead = self._grid.copy_ahead()
        made = ahead.made()
        with self._writing:
            self._grid.take_ahead(ahead, made)
            make_room = self._grid.room_for_checkpoint()
        return make_room()

    def checkpoint(self, most: int | None = None, room: Tiles | None = None) -> Checkpoint | None:
        """Writer: the map as it is now, for a store; None if more than `most` bytes were to be copied.

        They are copied into `room` if it is large enough: into new memory that takes many times longer.
        """
        with self._writing:
            # Before the first scan what the map began with counts as uncopied, and nobody waits for the lock.
            if most is not None and self._grid.revision and self._grid.uncopied_bytes > most:
                return None
            return self._grid.checkpoint(room)

    @property
    def now(self) -> Identity:
        """Epoch, revision and stamp of this moment; waits for nobody."""
        return self._state.identity

    @property
    def time(self) -> int | None:
        """Writer: how far the time of a map that forgets has come, ns; None before its first scan."""
        return self._grid.time.time

    def cells_in(self, region: Region | None) -> int:
        """How many cells of the map a region covers, None: all of them; waits for nobody.

        Raises:
            BadParameter: the region is inverted or not finite.
        """
        rect = self._state.rect
        return rect.cells if region is None else rect.intersection(self._grid.lattice.cover(region)).cells

    def snapshot(self) -> MapSnapshot:
        """The map as it is now; the same object until it changes."""
        with self._reading:
            room = self._room()
            with self._writing:
                return self._current_snapshot(room)

    @property
    def newest_copy(self) -> MapSnapshot | None:
        """The newest snapshot that was taken, None if none was; waits for nobody."""
        return self._snapshot

    def info(self) -> MapInfo:
        """The status's `map_info`; known cells may be a second old (see `count_known`), or PATIENT_PERIOD."""
        state = self._state
        return MapInfo(
            known_cells=self._figure(self._known_cells, self._known_cells_now, patient=True),
            bytes=state.nbytes,
            width=state.rect.width,
            height=state.rect.height,
            resolution=self._grid.lattice.resolution,
        )

    def count_known(self) -> None:
        """Bring the number of known cells up to date, so that nobody who asks for it need wait."""
        self._figure(self._known_cells, self._known_cells_now)

    def quality(self, world: World | None = None) -> dict[str, Any]:
        """Quality figures of the map and its newest scans; may be a second old.

        `truth` says how well the map agrees with a true `world`, None without one. `judged` says of which
        share of the map and its scans they are: they cost so much at most (see `bounded_figures`).

        Raises:
            Unavailable: they were not ready when `stop` was called.
        """
        return self._figure(self._quality, lambda: self._bounded_quality(world), world)

    def stop(self) -> None:
        """Nobody waits any more for the figures that are being computed: they may take minutes."""
        self._stopping.set()

    def fresh_quality(self, world: World | None = None, within: float = math.inf) -> dict[str, Any]:
        """The same of this very moment and all of it, even after `stop`, whatever it costs.

        Figures that are not ready `within` so many seconds are None, and named in the list `missing`.
        """
        deadline = time.monotonic() + within

        def check_time() -> None:
            if time.monotonic() >= deadline:
                raise _OutOfTime

        return self._quality_now(world, check_time)

    def _check_stopping(self) -> None:
        if self._stopping.is_set():
            raise Unavailable("the mapper is stopping")

    def _bounded_quality(self, world: World | None) -> dict[str, Any]:
        snapshot, recent, updates = self._to_judge()
        figures = bounded_figures(snapshot, self._grid.settings, recent, world, self._check_stopping)
        truth, judged = figures.pop("truth"), figures.pop("judged")
        counts = {"scans": snapshot.scans, "cell_updates": updates}
        return {**figures, **counts, "judged": judged, "truth": truth}

    def _to_judge(self) -> tuple[MapSnapshot, list[PlacedScan], int]:
        """The map of this moment, its newest scans, and how many updates its cells have had."""
        with self._reading:
            room = self._room()
            with self._writing:
                return self._current_snapshot(room), list(self._recent), self._grid.cell_updates

    def _quality_now(self, world: World | None, between: Callable[[], None]) -> dict[str, Any]:
        snapshot, recent, updates = self._to_judge()
        consistency = Consistency(snapshot, self._grid.settings)
        figures = quality_figures(snapshot, consistency, updates)
        figures["truth"] = None
        missing = ["consistency"] if world is None else ["consistency", "truth"]
        try:
            if world is not None:
                between()
                figures["truth"] = truth_figures(snapshot, world, between)
                missing.remove("truth")
            for placed in recent:
                consistency.add(placed, between)
            figures["consistency"] = consistency.figures()
            missing.remove("consistency")
        except _OutOfTime:
            figures["missing"] = missing
        return figures

    def _allowed(self, memory: MemoryUse) -> int:
        """Bytes that the map may hold now, beside all else and the copy of it that readers get.

        While a good part of all memory is left to it, this is added up a few times a second only.
        """
        looked, allowed = self._looked
        now = time.monotonic()
        if now - looked > LOOK_PERIOD or allowed - self._state.nbytes < memory.limit // _GOOD_PART:
            copies = self._copies_bytes()
            left = memory.left() + self._state.nbytes + copies
            # A new copy takes up to a quarter more than its tiles.
            allowed = min(left - copies, left * 4 // 9)
            self._looked = now, allowed
        return allowed

    def _reason_of(self, refusal: NoRoom) -> LimitReached:
        """A refusal that names the limit which was reached."""
        if self._memory is None or self._grid.max_bytes >= self._grid.settings.max_bytes:
            return refusal
        return LimitReached(
            f"it needs new tiles, and of mapper.max_memory, {self._memory.limit} bytes, too little is left "
            f"({self._memory.in_words()}; readers need a copy of the map): raise it, {SMALLER_MAP}",
            "max_memory",
        )

    def _copies_bytes(self) -> int:
        view = self._view
        return 0 if view is None else self._copied + view.nbytes

    def _told(self) -> _State:
        """The state of the grid; the writer's."""
        grid = self._grid
        return _State(Identity.of(grid), grid.rect, grid.nbytes)

    def _room(self) -> Tiles | None:
        """Memory for the next snapshot; `_reading` is held, and the writer goes on meanwhile."""
        if self._snapshot is not None and Identity.of(self._snapshot) == self.now:
            return None
        self._copy_aged()
        with self._writing:
            make_room = self._grid.room_for_snapshot()
        return make_room()

    def _copy_aged(self) -> None:
        """Copy what has missed a tick (see tiles.aging), if that is much, while the writer goes on."""
        with self._writing:
            aged = self._grid.aged_bytes
            if aged <= _MUCH:
                return
            afresh = self._memory is not None and self._memory.left() < aged
            ahead = self._grid.aged_copy_ahead(afresh=afresh)
        if afresh:
            self._snapshot = self._view = None
        made = ahead.made()
        with self._writing:
            self._grid.take_ahead(ahead, made)

    def _current_snapshot(self, room: Tiles | None) -> MapSnapshot:
        """The newest snapshot, taken if need be; both locks are held."""
        known = self._snapshot
        if known is None or Identity.of(known) != Identity.of(self._grid):
            known = self._snapshot = self._grid.snapshot(room)
            self._view = cast(TileView, known.stored)
            self._copied = self._view.tiles.nbytes
            if self._memory is not None:
                self._memory.make_room()
        return known

    def _known_cells_now(self) -> int:
        return self.snapshot().known_cells

    def _figure(
        self,
        cached: "_Figure",
        compute: Callable[[], _T],
        world: World | None = None,
        *,
        patient: bool = False,
    ) -> _T:
        """The cached value, computed anew if the map or the world is another and it is FIGURES_PERIOD old.

        Who is `patient` takes a value of up to PATIENT_PERIOD, and does not wait while another one computes
        it, unless all that is known is of before a reset.
        """
        known, value = cached.identity, cached.value
        at_once = patient and known is not None and known.epoch == self.now.epoch
        if not cached.lock.acquire(blocking=not at_once):
            return cast(_T, value)
        try:
            identity = self.now
            new_life = cached.identity is None or cached.identity.epoch != identity.epoch
            changed = identity != cached.identity or world is not cached.world
            old = time.monotonic() - cached.time >= (PATIENT_PERIOD if patient else FIGURES_PERIOD)
            if new_life or (old and changed):
                cached.value = compute()
                cached.identity, cached.world, cached.time = identity, world, time.monotonic()
            return cast(_T, cached.value)
        finally:
            cached.lock.release()


class _RecentScans:
    """The newest scans that are in the map, as far as they take no more than their share, bytes."""

    def __init__(self, share: int) -> None:
        self.share = share
        self.nbytes = 0
        self._scans: deque[PlacedScan] = deque()

    def __iter__(self) -> Iterator[PlacedScan]:
        return iter(self._scans)

    def append(self, placed: PlacedScan) -> None:
        self._scans.append(placed)
        self.nbytes += _bytes_of(placed)
        while len(self._scans) > RECENT_SCANS or self.nbytes > self.share:
            self.nbytes -= _bytes_of(self._scans.popleft())

    def clear(self) -> None:
        self._scans.clear()
        self.nbytes = 0


def _bytes_of(placed: PlacedScan) -> int:
    sweep = placed.sweep
    return placed.scan.nbytes + (0 if sweep is None else sweep.beams.nbytes)


class _Figure:
    """A value, the map and the world that it is of, and when it was computed."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.value: Any = None
        self.identity: Identity | None = None
        self.world: World | None = None
        self.time = 0.0
