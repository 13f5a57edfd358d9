"""Lines whose cells several threads update, each those in columns of its own: the kernels of both sides.

    the caller    cuts a scan, posts the parts   updates the first, and what nobody took   waits for the rest
    each helper   looks into its mailbox         takes its part, updates it                looks again

All of it is compiled: while scans follow each other at once no thread sleeps or waits for Python's lock.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.sensor_models import bresenham, dda
from ogm_core.sensor_models.beams import Plain
from ogm_core.sensor_models.mailbox import (
    DONE,
    EMPTY,
    MONOTONIC,
    NS,
    OF_THREAD,
    POSTED,
    Mailbox,
    change,
    done,
    hand_over,
    now,
    state,
    taken,
)
from ogm_core.sensor_models.strip_work import even_cuts, work_of_beams
from ogm_core.sensor_models.tiles_around import tiles_around
from ogm_core.tiles.marks import unmarked
from ogm_core.tiles.store import TILE, TILE_BITS

_FIRST, _END, _BEAMS, _REVISION, _UPDATES, _WINDOW = range(1, 7)
"""Words of a mailbox: the first column of a part, and the one after its last, of so many beams; the revision;
the number of updates when it is done; four of the whole window."""
_WIDE = 8
"""Parts are cut at every so many columns: no two share a line of a cache."""
LEAST, TOOK, ALONE = range(3)
"""Numbers that are `told`: from how many cells each on parts are cut; seconds that the last scan took, 0 if
nobody helped; and that the caller alone would have computed."""


@njit(cache=True, nogil=True, error_model="numpy")
def _update_part(
    part: tuple[int, int],
    ends: NDArray[np.int64],
    lines: NDArray[np.float64] | None,
    window: Plain,
    revision: int,
    store: Plain,
    constants: Plain,
) -> int:
    """Update the cells from one column of the window to another; the number of updates.

    Each thread has a `touched` of its own: near the sensor all beams mark the same tiles, and two threads
    that mark one wait for each other's caches most of the time.
    """
    (first, end), (touched, cells, column) = part, store
    mine = window[0] + first, window[1], end - first, window[3]
    marks, feet = touched[first >> TILE_BITS : (end + TILE - 1) >> TILE_BITS], column[first:end]
    if lines is None:
        return bresenham.update_cells(ends, mine, marks, revision, cells, feet, constants)[0]
    return dda.update_cells(ends, lines, mine, marks, revision, cells, feet, constants)[0]


@njit(cache=True, nogil=True, error_model="numpy")
def serve(
    mailbox: Mailbox,
    patience: int,
    ends_room: NDArray[np.int64],
    lines_room: NDArray[np.float64] | None,
    store: Plain,
    constants: Plain,
) -> None:
    """A helper's: update every part that is posted, until none has been for `patience`, ns."""
    while taken(mailbox, patience):
        beams, revision, part = mailbox[_BEAMS], mailbox[_REVISION], (mailbox[_FIRST], mailbox[_END])
        window = mailbox[_WINDOW], mailbox[_WINDOW + 1], mailbox[_WINDOW + 2], mailbox[_WINDOW + 3]
        ends = ends_room[: 5 * beams].reshape((5, beams))
        if lines_room is None:
            updates = _update_part(part, ends, None, window, revision, store, constants)
        else:
            lines = lines_room[: 4 * beams].reshape((4, beams))
            updates = _update_part(part, ends, lines, window, revision, store, constants)
        mailbox[_UPDATES] = updates
        hand_over(mailbox, DONE)


@njit(cache=True, nogil=True, error_model="numpy")
def update_cells(
    ends: NDArray[np.int64],
    lines: NDArray[np.float64] | None,
    window: Plain,
    touched: NDArray[np.int64],
    revision: int,
    cells: NDArray[Any],
    column: NDArray[np.int64],
    constants: Plain,
    team: Plain,
) -> tuple[int, int]:
    """Do what `update_cells` of bresenham, or dda, does with a whole store, together with a team.

    `lines` are those of projection.Beams, None along Bresenham's; `team` is Team.arrays.
    """
    began, told, store = now(MONOTONIC), team[-1], (touched, cells, column)
    tiles = tiles_around(ends, CellRect(*window), 0)
    fresh, cuts = unmarked(touched, tiles), _cuts(ends, window, tiles, team)
    if cuts.size > 2:
        _post(ends, lines, window, revision, cuts, team)
    busy = now(OF_THREAD)
    own = _update_part((cuts[0], cuts[1]), ends, lines, window, revision, store, constants)
    busy, updates = now(OF_THREAD) - busy, own
    for n in range(1, cuts.size - 1):
        mailbox = team[0][n - 1]
        if done(mailbox):
            updates += mailbox[_UPDATES]
            _take_marks(team[1][n - 1], (cuts[n], cuts[n + 1]), tiles, touched)
        else:
            updates += _update_part((cuts[n], cuts[n + 1]), ends, lines, window, revision, store, constants)
    told[TOOK] = (now(MONOTONIC) - began) / NS if cuts.size > 2 else 0.0
    told[ALONE] = busy / NS * updates / max(own, 1)
    return updates, fresh - unmarked(touched, tiles)


@njit(cache=True, nogil=True, error_model="numpy")
def _cuts(
    ends: NDArray[np.int64], window: Plain, tiles: tuple[int, int, int, int], team: Plain
) -> NDArray[np.int64]:
    """The columns of the window at which parts begin, as many as are worth it, and its width."""
    mailboxes, told = team[0], team[-1]
    awake = 0
    for n in range(mailboxes.shape[0]):
        awake += int(state(mailboxes[n]) == EMPTY)
    left = tiles[0] << TILE_BITS
    width = min(tiles[1] << TILE_BITS, window[2]) - left  # bounds may run through a tile
    work = np.zeros((width + _WIDE - 1) // _WIDE)
    work_of_beams(ends, 0, (window[0] + left, window[1], width, window[3]), _WIDE, work)
    cuts = left + even_cuts(work, 1 + awake, told[LEAST], 0.0) * _WIDE
    cuts[0], cuts[-1] = 0, window[2]
    return cuts


@njit(cache=True, nogil=True, error_model="numpy")
def _take_marks(
    marks: NDArray[np.int64],
    part: tuple[int, int],
    tiles: tuple[int, int, int, int],
    touched: NDArray[np.int64],
) -> None:
    """Write into `touched` what a helper has marked in its part, and clear its marks."""
    left, right = max(part[0] >> TILE_BITS, tiles[0]), min((part[1] + TILE - 1) >> TILE_BITS, tiles[1])
    for x in range(left, right):
        for y in range(tiles[2], tiles[3]):
            tile = np.uint64(x), np.uint64(y)
            touched[tile] = max(touched[tile], marks[tile])
            marks[tile] = 0


@njit(cache=True, nogil=True, error_model="numpy")
def _post(
    ends: NDArray[np.int64],
    lines: NDArray[np.float64] | None,
    window: Plain,
    revision: int,
    cuts: NDArray[np.int64],
    team: Plain,
) -> None:
    """Post all parts but the first, to whoever is awake."""
    mailboxes, _, ends_room, lines_room, _ = team
    ends_room[: ends.size] = ends.reshape(-1)
    if lines is not None:
        lines_room[: lines.size] = lines.reshape(-1)
    for n in range(1, cuts.size - 1):
        mailbox = mailboxes[n - 1]
        mailbox[_FIRST], mailbox[_END] = cuts[n], cuts[n + 1]
        mailbox[_BEAMS], mailbox[_REVISION] = ends.shape[1], revision
        for k in range(4):
            mailbox[_WINDOW + k] = window[k]
        change(mailbox, EMPTY, POSTED)
