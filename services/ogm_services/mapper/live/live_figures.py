"""Live figures: what is counted and judged of a map while it is written, as seldom as who asks can bear."""

import math
import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

from ogm_core.grid_settings import GridSettings
from ogm_core.quality.bounded import bounded_figures
from ogm_core.quality.figures import Consistency, quality_figures
from ogm_core.quality.truth import truth_figures
from ogm_core.simulation.worlds import World
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import PlacedScan
from ogm_services.mapper.live.identity import Identity
from ogm_services.replies.answer import Unavailable

FIGURES_PERIOD = 1.0
"""Figures of the whole map are computed at most this often, s."""
PATIENT_PERIOD = 3.0
"""Who asks for the status counts the known cells only if nobody did for so long, s: it takes a moment."""

_T = TypeVar("_T")


class _OutOfTime(Exception):
    """Figures have taken as long as they may."""


class Judged(NamedTuple):
    """What is judged: a map of one moment, and its newest scans."""

    snapshot: MapSnapshot
    settings: GridSettings
    recent: list[PlacedScan]
    updates: int
    """How many its cells have had."""


class LiveFigures:
    """Figures of a live map. Any thread; each has its own lock: who waits for one holds up nobody else."""

    def __init__(
        self, now: Callable[[], Identity], known_cells: Callable[[], int], judged: Callable[[], Judged]
    ) -> None:
        """What the map is at this moment: `now` waits for nobody, the others may copy the map."""
        self._now = now
        self._known_cells_now = known_cells
        self._judged = judged
        self._known_cells = _Figure()
        self._quality = _Figure()
        self._stopping = threading.Event()

    def known_cells(self) -> int:
        """How many cells are known; may be a second old (see `count_known`), or PATIENT_PERIOD."""
        return self._figure(self._known_cells, self._known_cells_now, patient=True)

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

    def fresh_quality(self, world: World | None = None, within: float = math.inf) -> dict[str, Any]:
        """The same of this very moment and all of it, even after `stop`, whatever it costs.

        Figures that are not ready `within` so many seconds are None, and named in the list `missing`.
        """
        deadline = time.monotonic() + within

        def check_time() -> None:
            if time.monotonic() >= deadline:
                raise _OutOfTime

        return self._quality_now(world, check_time)

    def stop(self) -> None:
        """Nobody waits any more for the figures that are being computed: they may take minutes."""
        self._stopping.set()

    def _check_stopping(self) -> None:
        if self._stopping.is_set():
            raise Unavailable("the mapper is stopping")

    def _bounded_quality(self, world: World | None) -> dict[str, Any]:
        snapshot, settings, recent, updates = self._judged()
        figures = bounded_figures(snapshot, settings, recent, world, self._check_stopping)
        truth, judged = figures.pop("truth"), figures.pop("judged")
        counts = {"scans": snapshot.scans, "cell_updates": updates}
        return {**figures, **counts, "judged": judged, "truth": truth}

    def _quality_now(self, world: World | None, between: Callable[[], None]) -> dict[str, Any]:
        snapshot, settings, recent, updates = self._judged()
        consistency = Consistency(snapshot, settings)
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
        at_once = patient and known is not None and known.epoch == self._now().epoch
        if not cached.lock.acquire(blocking=not at_once):
            return cast(_T, value)
        try:
            identity = self._now()
            new_life = cached.identity is None or cached.identity.epoch != identity.epoch
            changed = identity != cached.identity or world is not cached.world
            old = time.monotonic() - cached.time >= (PATIENT_PERIOD if patient else FIGURES_PERIOD)
            if new_life or (old and changed):
                cached.value = compute()
                cached.identity, cached.world, cached.time = identity, world, time.monotonic()
            return cast(_T, cached.value)
        finally:
            cached.lock.release()


class MapWithFigures:
    """A map that is told of by its figures. Any thread."""

    def __init__(self, figures: LiveFigures) -> None:
        self._figures = figures

    def count_known(self) -> None:
        """See `LiveFigures.count_known`."""
        self._figures.count_known()

    def quality(self, world: World | None = None) -> dict[str, Any]:
        """See `LiveFigures.quality`."""
        return self._figures.quality(world)

    def fresh_quality(self, world: World | None = None, within: float = math.inf) -> dict[str, Any]:
        """See `LiveFigures.fresh_quality`."""
        return self._figures.fresh_quality(world, within)

    def stop(self) -> None:
        """Nobody waits any more for the figures that are being computed: they may take minutes."""
        self._figures.stop()


class _Figure:
    """A value, the map and the world that it is of, and when it was computed."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.value: Any = None
        self.identity: Identity | None = None
        self.world: World | None = None
        self.time = 0.0
