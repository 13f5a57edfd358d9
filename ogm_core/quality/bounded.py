"""Quality figures at a bounded cost, for whoever asks while the map is written: by visits of cells.

A visit is a look at a cell by one of the figures. What costs more than it may is judged in part, always the
same part of the same map, and the share is told.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.quality.figures import Consistency, ends_in_map, map_figures_within
from ogm_core.quality.truth import truth_figures_within
from ogm_core.sensor_models.beams import IX, IX0, IY, IY0, KIND, SKIPPED
from ogm_core.simulation.worlds import World
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import PlacedScan

VISITS = 2 * 10**8
"""So many cells may be visited for one answer: about a second."""


def bounded_figures(
    snapshot: MapSnapshot,
    settings: GridSettings,
    recent: Sequence[PlacedScan],
    world: World | None,
    between: Callable[[], None] = lambda: None,
    visits: int = VISITS,
) -> dict[str, Any]:
    """The figures of a map, its newest scans and a true world for at most so many visits.

    Those of `map_figures`, `consistency`, and `judged`: which share of the map's rows the map's figures are
    of, and `truth` (null without a world); of how many scans, and which share of all visits that `recent`
    would take, `consistency` is; how many visits there were. `truth` is None without a world, or if it
    would cost too much. Calls `between` often; what that raises ends it.
    """
    figures, map_share, spent = map_figures_within(snapshot, visits // 2)
    between()
    truth, truth_share = None, None
    if world is not None:
        truth, truth_share, more = truth_figures_within(snapshot, world, (visits - spent) // 2)
        spent += more
        between()
    agreed = _consistency_within(snapshot, settings, recent, visits - spent, between)
    figures["consistency"] = agreed.figures
    figures["judged"] = {
        "map": map_share,
        "scans": agreed.scans,
        "consistency": agreed.share,
        "truth": truth_share,
        "visits": spent + agreed.visits,
    }
    figures["truth"] = truth
    return figures


class _Agreed(NamedTuple):
    figures: dict[str, float | None]
    scans: int
    share: float
    visits: int


class _Reach(NamedTuple):
    """What a scan takes to be judged: the cells around all that it speaks of, and how many it visits."""

    box: CellRect
    visits: int


def _consistency_within(
    snapshot: MapSnapshot,
    settings: GridSettings,
    recent: Sequence[PlacedScan],
    visits: int,
    between: Callable[[], None],
) -> _Agreed:
    """Judge the newest scans that can be had for so many visits: of their cells, and of the map around them.

    Of one scan that alone costs more only every so-manieth beam is judged, and no cell in rows that are too
    far from the sensor's.
    """
    reaches = []
    for placed in reversed(recent):
        between()
        reaches.append(_reach(ends_in_map(placed, snapshot.lattice, settings), snapshot.rect))
    total = sum(reach.visits for reach in reaches)
    taken, window, spent = 0, CellRect(0, 0, 0, 0), 0
    for reach in reaches:
        joined = window.union(reach.box) if taken else reach.box
        if joined.cells + spent + reach.visits > visits:
            break
        taken, window, spent = taken + 1, joined, spent + reach.visits
    every = 1
    if reaches and not taken:
        taken, window = 1, _rows_around(reaches[0].box, recent[-1], snapshot, visits // 2)
        every = -(-reaches[0].visits // max(visits - window.cells, 1))
        spent = -(-reaches[0].visits // every)
    consistency = Consistency(snapshot, settings, window, every)
    for placed in list(reversed(recent))[:taken]:
        consistency.add(placed, between)
    share = 1.0 if taken == len(reaches) and every == 1 else spent / total
    return _Agreed(consistency.figures(), taken, share, window.cells + spent)


def _reach(ends: NDArray[np.int64], rect: CellRect) -> _Reach:
    """The part of the map that a scan's beams lie in, and how many of its cells they visit, at most."""
    counting = ends[:, ends[KIND] != SKIPPED]
    if not counting.shape[1]:
        return _Reach(CellRect(rect.ix, rect.iy, 0, 0), 0)
    columns, rows = counting[[IX, IX0]], counting[[IY, IY0]]
    west, south, east, north = (int(edge) for edge in (columns.min(), rows.min(), columns.max(), rows.max()))
    box = CellRect(west, south, east - west + 1, north - south + 1).intersection(rect)
    lengths = np.maximum(np.abs(columns[0] - columns[1]), np.abs(rows[0] - rows[1])) + 1
    return _Reach(box, int(np.minimum(lengths, max(box.width, box.height)).sum()))


def _rows_around(box: CellRect, placed: PlacedScan, snapshot: MapSnapshot, cells: int) -> CellRect:
    """The rows of a box around those that the sensor is in, of at most so many cells."""
    rows = min(box.height, cells // max(box.width, 1))
    own = int(np.clip(snapshot.lattice.cell_of(placed.pose.x, placed.pose.y)[1], box.iy, box.iy + box.height))
    south = min(max(own - rows // 2, box.iy), box.iy + box.height - rows)
    return CellRect(box.ix, south, box.width, rows)
