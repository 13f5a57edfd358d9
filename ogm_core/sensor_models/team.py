"""A team: the threads that help with the lines in one store, their mailboxes, and room for a scan's beams."""

import weakref
from collections.abc import Callable
from functools import partial

import numpy as np

from ogm_core.sensor_models import bresenham, dda, shared_lines
from ogm_core.sensor_models.beams import Plain
from ogm_core.sensor_models.mailbox import (
    ASLEEP,
    DONE,
    EMPTY,
    FAILED,
    POSTED,
    STATE,
    TAKEN,
    WORDS,
    Mailbox,
    done,
)
from ogm_core.tiles.store import TileStore

_PATIENCE = 200_000
"""ns: so long a helper looks for the next scan before it sleeps; to wake it again takes a third of that."""
_ABOUT = 0.75
"""Helpers are woken up as the last scan was much work. To cut none, this one must be clearly less."""


class Team:
    """`helpers` threads beside the one that calls; for one store, and scans of up to so many beams.

    Who owns what: a mailbox's state says whose it is. With it go the cells of the part in it, and the marks
    by which a helper says what tiles it has touched. The beams' room is the caller's, but for those who have
    TAKEN a part. When a call of `shared_lines` has returned, no mailbox is POSTED, TAKEN or DONE, and nothing
    is marked: then all of the map is the caller's. Helpers let go of the store when they fall asleep; this
    holds none.
    """

    def __init__(self, helpers: int, least: float, store: TileStore, beams: int, *, exact: bool) -> None:
        """Parts have about as much work as `least` cells, or more; lines are `exact` along dda's."""
        self._store, self._beams = weakref.ref(store), beams
        self._mailboxes = np.zeros((helpers, WORDS), np.int64)
        self._mailboxes[:, STATE] = ASLEEP
        self._told = np.zeros(3)
        self._told[shared_lines.LEAST] = _ABOUT * least / (dda if exact else bresenham).CELL_WORK
        self._marks = np.zeros((helpers, *store.touched.shape), np.int64)
        self._ends, self._lines = np.empty(5 * beams, np.int64), np.empty(4 * beams if exact else 0)
        self._exact = exact
        self.arrays: Plain = self._mailboxes, self._marks, self._ends, self._lines, self._told
        """For `shared_lines.update_cells`."""

    def fits(self, store: TileStore, beams: int) -> bool:
        """Whether it can help with a scan of so many beams into this store."""
        return self._store() is store and beams <= self._beams

    def job(self, helper: int, store: TileStore, plane: str, constants: Plain) -> Callable[[], None] | None:
        """What a helper's thread has to call now; None if it is still at it."""
        if self._mailboxes.item(helper, STATE) not in (ASLEEP, FAILED):
            return None
        mailbox = self._mailboxes[helper]
        mailbox[STATE] = EMPTY
        cells, column, _ = store.planes[plane]
        lines = self._lines if self._exact else None
        work = self._marks[helper], cells, column
        return partial(_serve, mailbox, (_PATIENCE, self._ends, lines, work, constants))

    @property
    def times(self) -> tuple[float, float] | None:
        """Seconds that the last scan took, and that one thread would have; None: one did all."""
        _, took, alone = self._told.tolist()
        return (took, alone) if took else None

    def settle(self) -> bool:
        """After a call that has raised: wait until nobody is at work; whether somebody may have been."""
        begun = [mailbox for mailbox in self._mailboxes if mailbox[STATE] in (POSTED, TAKEN, DONE)]
        for mailbox in begun:
            done(mailbox)
        return bool(begun)


def _serve(mailbox: Mailbox, arguments: Plain) -> None:
    try:
        shared_lines.serve(mailbox, *arguments)
    except BaseException as error:
        mailbox[STATE] = FAILED
        if not isinstance(error, MemoryError):  # for want of memory no cell has changed: the caller tries
            raise
