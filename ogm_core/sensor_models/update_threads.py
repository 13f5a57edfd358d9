"""Update threads: the cells of one large scan are updated by several threads, each in columns of its own.

Every thread reads all beams, in their order, and updates the cells of its columns alone: each cell gets the
same evidence in the same order as from one thread, so the map is the same to the last bit.

Lines in known parts of a map, where most go, are a team's (`team`, `shared_lines`): it needs no Python while
scans come fast. All other evidence threads share here, by `update`.
"""

import itertools
import threading
import time
from queue import SimpleQueue
from types import TracebackType
from typing import Self

import numpy as np

from ogm_core.cells.model import CellModel
from ogm_core.lattice import CellRect
from ogm_core.sensor_models.beams import Plain
from ogm_core.sensor_models.evidence import Evidence
from ogm_core.sensor_models.helper import Helper
from ogm_core.sensor_models.strip_work import even_cuts
from ogm_core.sensor_models.team import Team
from ogm_core.tiles.parts import StorePart, part_of_window
from ogm_core.tiles.store import TILE, TileStore

SPOILT = "a scan is in a part of the map only, which is not to be trusted now"
LEAST_CELLS = 120_000
"""To wake up a thread for less work takes longer than it saves; cells along beams."""
LEAST_LINES = 70_000
"""The same for a team."""
_AHEAD = 1 / 6
"""Of that, the calling thread has updated so many before the others have woken up."""
_SIZES = 64
_A_BEAM = 5
"""Numbers that evidence has of a beam; it has about as many of a row of an area."""
_GAIN, _BEFORE = 0.86, 30e-6
"""Sharing a scan paid if it took less than this part of what one thread would compute, `_BEFORE` included.

That is estimated too large, by the beams that are read twice. To find cuts, and what one call does otherwise,
takes so long before, s.
"""
_TRIES = 4
"""So many scans are shared till it is given up: the first ones find caches cold and threads fast asleep."""
_LONGEST_REST = 127
"""So many large scans go to one thread alone while the machine has no core for another."""


class UpdateThreads:
    """`count` threads that update cells together: the one that calls `update`, and others, as a context.

    Who owns what: during `update` the cells of a part are its taker's alone, and no two parts share one; of
    `touched`, where a tile is cut, both write the same number. A part is taken from a list by `pop`, which
    hands out each once; whoever has taken it, or has failed to update it, says so in `_Scan._outcomes`. The
    caller takes every part that no thread has taken when its own is done, and returns once there is an
    outcome of each: then all cells are its again. `_updating` is held meanwhile, so that `close` waits.
    """

    def __init__(self, count: int, *, least_cells: int = LEAST_CELLS) -> None:
        """No thread runs before the first scan with so much work for each of two."""
        self.count = count
        self._least = float(least_cells)
        self.worth_sharing = 2.0 * least_cells
        """From how much work on a scan is shared, in cells along beams."""
        self.worth_a_team = 2.0 * min(least_cells, LEAST_LINES)
        """The same for scans that go into the map in one call."""
        self._worth, self._worth_a_team = [count > 1] * _SIZES, [False] * _SIZES
        """Whether the last scan of up to 2^k beams was that much work, by k; at first it is found out."""
        self._rest = self._resting = self._misses = 0
        """How many large scans one thread takes alone where sharing does not pay, how many of these are left,
        and how many have not paid in a row."""
        self._updating = threading.Lock()
        self._team: Team | None = None
        self._helpers: list[Helper] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the threads, after the scan that they are at. The next large scan would start others."""
        with self._updating:
            self._end()

    def wanted(self, beams: int) -> bool:
        """Whether a scan of so many beams may be worth sharing: the last of about as many was."""
        return self._worth[beams.bit_length()] and not self._resting

    def alone(self, beams: int, work: float) -> None:
        """Note how much work it was that one thread has done for a scan; small ones need not be told of."""
        self._note(self._worth, beams, work >= self.worth_sharing)

    def _note(self, worth: list[bool], beams: int, large: bool) -> None:
        large = worth[beams.bit_length()] = large and self.count > 1
        if large and self._resting:
            self._resting -= 1

    def team(self, store: TileStore, beams: int, plane: str, constants: Plain, exact: bool) -> Team | None:
        """Who helps to update this plane of a store by a scan of so many beams; None: better nobody."""
        if self._resting or not self._worth_a_team[beams.bit_length()]:
            return None
        with self._updating:
            self._start(self.count - 1)
            team = self._team
            if team is None or not team.fits(store, beams):
                team = self._team = Team(self.count - 1, self.worth_a_team / 2.0, store, beams, exact=exact)
            for number, helper in enumerate(self._helpers):
                job = team.job(number, store, plane, constants)
                if job is not None:
                    helper.tell(job)
        return team

    def finished(self, team: Team | None, beams: int, work: float) -> None:
        """Note how much work a scan was that was integrated in one call, by a team or by one thread."""
        times = None if team is None else team.times
        if times is None:
            self._note(self._worth_a_team, beams, work >= self.worth_a_team)
        else:
            took, alone = times
            self._judge(paid=took < _GAIN * alone)

    def update(
        self,
        model: CellModel,
        updated: CellRect,
        evidence: Evidence,
        store: TileStore,
        window: CellRect,
        revision: int,
    ) -> int:
        """Do what `model.update` does, on several threads if that pays; return the number of updates.

        `updated` is a rectangle of the lattice that holds all cells that will be.

        Raises:
            RuntimeError: some of the cells could not be updated, and others are: the map is spoilt.
        """
        beams = evidence.arrays[0].size // _A_BEAM
        cuts = self._cuts(evidence, window) if self.wanted(beams) else []
        if len(cuts) <= 2:
            updates = model.update(evidence, store, window, revision)
            self.alone(beams, updates * evidence.kernels.CELL_WORK)
            return updates
        left = updated.ix - store.rect.ix
        met = store.touched[left // TILE : -(-(left + updated.width) // TILE)]
        before = np.count_nonzero(met)
        with self._updating:
            updates = self._share(_Scan(model, evidence, store, window, revision, cuts))
        store.tiles_used += int(np.count_nonzero(met) - before)
        return updates

    def _cuts(self, evidence: Evidence, window: CellRect) -> list[int]:
        """The columns of a window at which parts begin, as many as there is work for, and its width."""
        each, wide = evidence.kernels.CELL_WORK, evidence.kernels.CUT
        work = np.zeros(-(-window.width // wide))
        evidence.kernels.strip_work(*evidence.arrays, tuple(window), work)
        cuts = even_cuts(work, self.count, self._least / each, _AHEAD * self._least / each)
        return [*(wide * cuts[:-1]).tolist(), window.width]

    def _share(self, scan: "_Scan") -> int:
        try:
            self._start(len(scan.left))
            began = time.perf_counter()
            for helper in self._helpers[: len(scan.left)]:
                helper.tell(scan.take)
            updates = scan.finish()
            paid = time.perf_counter() - began + _BEFORE < _GAIN * scan.alone
            self._judge(paid=paid)
            return updates
        except BaseException:
            self._end()  # whoever catches this finds nobody at work on the map
            raise

    def _judge(self, *, paid: bool) -> None:
        """Go on sharing while it pays, else rest ever longer."""
        self._misses = 0 if paid else self._misses + 1
        if paid:
            self._rest = 0
        elif self._misses >= _TRIES:
            self._misses = 0
            self._rest = self._resting = min(2 * self._rest + 1, _LONGEST_REST)

    def _start(self, count: int) -> None:
        if not all(helper.alive for helper in self._helpers):
            self._end()  # an error has ended one, and nobody does what it was told
        while len(self._helpers) < count:
            self._helpers.append(Helper(f"ogm-update-{len(self._helpers) + 1}"))

    def _end(self) -> None:
        for helper in self._helpers:
            helper.end()
        for helper in self._helpers:
            helper.join()
        self._helpers, self._team = [], None


_Part = tuple[int, int]
"""Its first column, and the one after its last."""


class _Scan:
    """The parts of a scan, till all of them are done."""

    def __init__(
        self,
        model: CellModel,
        evidence: Evidence,
        store: TileStore,
        window: CellRect,
        revision: int,
        cuts: list[int],
    ) -> None:
        self._model, self._evidence, self._revision = model, evidence, revision
        self._store, self._window = store, window
        self._first, *self.left = itertools.pairwise(cuts)
        """The caller's part, and those that nobody has taken."""
        self._count = len(cuts) - 1
        self._outcomes: SimpleQueue[tuple[_Part, int | BaseException]] = SimpleQueue()
        """Of each part that was taken: the number of updates, or what was raised before there was one."""
        self.alone = 0.0
        """After `finish`: how long the caller alone would have computed, s."""

    def take(self) -> int:
        """Take a part, if there is one left, and update its cells; the number of updates."""
        try:
            part = self.left.pop()
        except IndexError:
            return 0
        return self._try(part)

    def finish(self) -> int:
        """Caller: its own part, what nobody has taken, and the outcomes of all; the number of updates."""
        began = time.thread_time()
        own = self._try(self._first)
        while self.left:
            own += self.take()
        took = time.thread_time() - began
        updates, failed = 0, []
        for _ in range(self._count):
            part, outcome = self._outcomes.get()
            if isinstance(outcome, int):
                updates += outcome
            else:
                failed.append((part, outcome))
        for part, error in failed:
            if not isinstance(error, Exception):
                raise error
            updates += self._again(part, whole=len(failed) == self._count)
        self.alone = took * updates / max(own, 1)
        return updates

    def _again(self, part: _Part, *, whole: bool) -> int:
        """Update the cells of a part that failed, as for want of memory: kernels write only after that."""
        try:
            return self._update(part)
        except Exception as error:
            if whole:  # no cell has changed, unless this is not the first of them
                raise
            raise RuntimeError(SPOILT) from error

    def _try(self, part: _Part) -> int:
        outcome: int | BaseException
        try:
            outcome = self._update(part)
        except BaseException as error:  # noqa: BLE001 (the caller raises it)
            outcome = error
        self._outcomes.put((part, outcome))
        return outcome if isinstance(outcome, int) else 0

    def _update(self, part: _Part) -> int:
        store, window = StorePart(self._store, *part), part_of_window(self._window, *part)
        return self._model.update(self._evidence, store, window, self._revision)
