"""Comparison with ground truth, where that is known: a simulated world.

A cell is truly occupied if the outline of an obstacle meets its closed square, so that a wall on the edge
between two cells makes both occupied.
"""

import operator
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import P_EDGE, row_bands
from ogm_core.cells.thresholds import OCCUPIED_ABOVE
from ogm_core.lattice import CellRect, Lattice
from ogm_core.quality.figures import BAND
from ogm_core.queries.cell_runs import counted
from ogm_core.simulation.worlds import World
from ogm_core.snapshot import MapSnapshot

SLACK = 1e-9
"""By how much a cell's square is widened on every side, cells: what rounding may move an outline by."""
_KNOWN, _OCCUPIED = 1, 2

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Runs = tuple[Ints, Ints, Ints]
"""Cells side by side: their row, first column and last column; none if the last is below the first."""


def truth_figures(
    snapshot: MapSnapshot, world: World, between: Callable[[], None] = lambda: None
) -> dict[str, float | None]:
    """How well a map agrees with the true world, cell by cell; None where there is nothing to judge.

    The snapshot is one that was not shrunk. Calls `between` often; what that raises ends it.

    - accuracy: share of the known cells with p > 0.5 where truly occupied, and not where not.
    - precision: share of the map's occupied cells (p > 0.65) that lie within one cell (in x and in y) of a
      truly occupied one.
    - recall: share of the truly occupied cells that lie within one cell of an occupied one. Judged are those
      with a known cell within one cell of them: the others were never looked at.
    - iou: TP / (TP + FP + FN); TP and FP are the map's occupied cells that precision finds right and wrong,
      FN the truly occupied cells that recall finds missed.
    - log_loss: mean over the known cells of -ln p(true class), p clipped to [1e-9, 1 - 1e-9].

    Truly occupied cells are also those beside the map's rectangle, so its cut changes nothing.
    """
    return _in_figures(_counts_of(snapshot, world, 0, snapshot.height, between))


def truth_figures_within(
    snapshot: MapSnapshot, world: World, visits: int
) -> tuple[dict[str, float | None] | None, float, int]:
    """The same at the cost of so many visits of cells: figures, share of the rows judged, visits spent.

    A map that costs more is judged by bands of rows spread over it, in which a cell, and a cell of an
    outline, costs a visit; the figures are None if not one band can be had for that.
    """
    bands = [slice(row, min(row + BAND, snapshot.height)) for row in range(0, snapshot.height, BAND)]
    costs = [_cost(snapshot, world, band) for band in bands] if bands else []
    if sum(costs) <= visits:
        return truth_figures(snapshot, world), 1.0, sum(costs)
    total, spent, rows = _Counts(), 0, 0
    every = -(-sum(costs) // max(visits, 1))
    for band, cost in list(zip(bands, costs, strict=True))[::every]:
        if spent + cost <= visits:
            counts = _counts_of(snapshot, world, band.start, band.stop)
            total = _Counts(*map(operator.add, total, counts))
            spent, rows = spent + cost, rows + band.stop - band.start
    return _in_figures(total) if rows else None, rows / snapshot.height, spent


class _Counts(NamedTuple):
    """Known cells, those on the true side of one half, their summed log loss; cells as `_matches` counts."""

    known: int = 0
    right: int = 0
    loss: float = 0.0
    occupied: int = 0
    found: int = 0
    looked_at: int = 0
    seen: int = 0


def _in_figures(counts: _Counts) -> dict[str, float | None]:
    missed = counts.looked_at - counts.seen
    return {
        "accuracy": _share(counts.right, counts.known),
        "precision": _share(counts.found, counts.occupied),
        "recall": _share(counts.seen, counts.looked_at),
        "iou": _share(counts.found, counts.occupied + missed),
        "log_loss": _share(counts.loss, counts.known),
    }


def _counts_of(
    snapshot: MapSnapshot, world: World, first: int, stop: int, between: Callable[[], None] = lambda: None
) -> _Counts:
    """What is counted in the map's rows from `first` to before `stop`."""
    ix, iy, width, _ = snapshot.rect
    around = CellRect(ix - 1, iy + first - 1, width + 2, stop - first + 2)
    truth = occupied_cells(world, snapshot.lattice, around, between)
    judged = _agreement(snapshot, truth[1:-1, 1:-1], first)
    return _Counts(*judged, *_matches(snapshot, truth, first, stop))


def _cost(snapshot: MapSnapshot, world: World, band: slice) -> int:
    """Cells that are visited to judge a band of rows, at most: its own, and those of the outlines in it.

    Along an outline lie no more cells than twice the rows and columns of its bounding box.
    """
    ix, iy, width, _ = snapshot.rect
    corner, height = np.array([ix, iy + band.start]), band.stop - band.start
    ends = snapshot.lattice.in_cells(world.segments.reshape(-1, 2, 2)) - corner
    centres = snapshot.lattice.in_cells(world.circles[:, :2]) - corner
    radii = (world.circles[:, 2] / snapshot.lattice.resolution)[:, np.newaxis]
    lows = np.concatenate((ends.min(axis=1), centres - radii))
    highs = np.concatenate((ends.max(axis=1), centres + radii))
    columns, rows = (
        np.maximum(last - first + 1, 0)
        for first, last in (_met(lows[:, k], highs[:, k], (width, height)[k]) for k in range(2))
    )
    along = 2 * (columns + rows)[rows > 0]
    return int(width * height + along.sum() + len(lows))


def occupied_cells(
    world: World, lattice: Lattice, rect: CellRect, between: Callable[[], None] = lambda: None
) -> Bools:
    """Which cells of `rect` an obstacle's outline meets: bool, [iy, ix]. Calls `between` often.

    A cell is its closed square, widened by 1e-9 cells on every side against rounding.
    """
    occupied = np.zeros((rect.height, rect.width), np.bool_)
    corner = np.array([rect.ix, rect.iy])
    ends = lattice.in_cells(world.segments.reshape(-1, 2, 2)) - corner
    centres = lattice.in_cells(world.circles[:, :2]) - corner
    for runs in _segment_runs(ends, rect):
        _mark(occupied, runs, between)
    for runs in _circle_runs(centres, world.circles[:, 2] / lattice.resolution, rect):
        _mark(occupied, runs, between)
    return occupied


def _agreement(snapshot: MapSnapshot, truth: Bools, first: int) -> tuple[int, int, float]:
    """Known cells, how many of them are on the true side of one half, and their summed log loss.

    `truth` is that of the map's rows from `first` on.
    """
    known, right, loss = 0, 0, 0.0
    for band in row_bands(truth.shape):
        true = truth[band]
        p, judged = snapshot.published(slice(first + band.start, first + band.start + len(true)))
        known += int(np.count_nonzero(judged))
        right += int(np.count_nonzero(judged & ((p > 0.5) == true)))
        losses = np.where(true, _loss_if_occupied(p), _loss_if_free(p))
        loss += float(losses.sum(where=judged))
    return known, right, loss


def _matches(snapshot: MapSnapshot, truth: Bools, first: int, stop: int) -> tuple[int, int, int, int]:
    """The map's occupied cells and how many are near a true one; the true cells looked at, and those seen.

    Counted are cells of the rows from `first` to before `stop`, and true ones beside the map. `truth` reaches
    one cell beyond them on every side.
    """
    beliefs = _with_two_around(snapshot, first, stop)
    occupied = found = looked_at = seen = 0
    counted = truth.copy()
    counted[0] &= first == 0
    counted[-1] &= stop == snapshot.height
    for band in row_bands(truth.shape):
        around = slice(band.start, band.stop + 2)
        near = _gathered(beliefs[around])[counted[band]]
        looked_at += int(np.count_nonzero(near))
        seen += int(np.count_nonzero(near & _OCCUPIED))
    for band in row_bands((stop - first, snapshot.width)):
        near_truth = _gathered(truth[band.start : band.stop + 2])
        mine = beliefs[2:-2, 2:-2][band] & _OCCUPIED != 0
        occupied += int(np.count_nonzero(mine))
        found += int(np.count_nonzero(mine & near_truth))
    return occupied, found, looked_at, seen


def _with_two_around(snapshot: MapSnapshot, first: int, stop: int) -> NDArray[np.uint8]:
    """Beliefs of the rows from `first` to before `stop` and two cells around; beyond the map they are 0."""
    south, north = max(first - 2, 0), min(stop + 2, snapshot.height)
    beyond = (south - (first - 2), stop + 2 - north), (2, 2)
    return np.pad(snapshot.encode(_belief, slice(south, north)), beyond)


def _gathered(codes: NDArray[Any]) -> NDArray[Any]:
    """The bits of the 3 x 3 cells around every cell but those at the edges."""
    columns = codes[:, :-2] | codes[:, 1:-1] | codes[:, 2:]
    gathered: NDArray[Any] = columns[:-2] | columns[1:-1] | columns[2:]
    return gathered


def _share(part: float, whole: int) -> float | None:
    return part / whole if whole else None


def _belief(p: Floats, known: Bools, _free_below: float) -> NDArray[np.uint8]:
    return np.where(known, np.where(p > OCCUPIED_ABOVE, _KNOWN | _OCCUPIED, _KNOWN), 0).astype(np.uint8)


def _loss_if_occupied(p: Floats) -> Floats:
    return -np.log(np.clip(p, P_EDGE, 1.0 - P_EDGE))


def _loss_if_free(p: Floats) -> Floats:
    return -np.log1p(-np.clip(p, P_EDGE, 1.0 - P_EDGE))


def _segment_runs(ends: Floats, rect: CellRect) -> Iterator[Runs]:
    """What segments meet; `ends` are in cells from the corner of `rect`, shape (n, 2, 2)."""
    (u1, v1), (u2, v2) = ends[:, 0].T, ends[:, 1].T
    for k, row in counted(*_met(np.minimum(v1, v2), np.maximum(v1, v2), rect.height)):
        climb = v2[k] - v1[k]
        # Where it crosses the lower and the upper edge of the row: shares of its length.
        with np.errstate(over="ignore"):
            lower = np.divide(row - SLACK - v1[k], climb, out=np.zeros(row.shape), where=climb != 0.0)
            upper = np.divide(row + 1 + SLACK - v1[k], climb, out=np.ones(row.shape), where=climb != 0.0)
        span = u2[k] - u1[k]
        one, other = (u1[k] + np.clip(share, 0.0, 1.0) * span for share in (lower, upper))
        yield row, *_met(np.minimum(one, other), np.maximum(one, other), rect.width)


def _circle_runs(centres: Floats, radii: Floats, rect: CellRect) -> Iterator[Runs]:
    """What circles meet: the cells that have a point no farther than the radius, and one no nearer."""
    u, v = centres.T
    for k, row in counted(*_met(v - radii, v + radii, rect.height)):
        lower, upper = row - SLACK - v[k], row + 1 + SLACK - v[k]
        nearest = np.maximum(0.0, np.maximum(lower, -upper))
        outer = _half_chord(radii[k], nearest)
        inner = _half_chord(radii[k], np.maximum(-lower, upper))
        # From left to right the row's cells are outside, on the circle, inside, on it again, outside.
        first, last = _met(u[k] - outer, u[k] + outer, rect.width)
        yield row, first, np.minimum(last, _met(u[k] - outer, u[k] - inner, rect.width)[1])
        yield row, np.maximum(first, _met(u[k] + inner, u[k] + outer, rect.width)[0]), last


def _half_chord(radius: Floats, distance: Floats) -> Floats:
    """Half the length of the chord at this distance from the centre, 0 if there is none."""
    return np.sqrt(np.maximum(0.0, (radius - distance) * (radius + distance)))


def _met(low: Floats, high: Floats, count: int) -> tuple[Ints, Ints]:
    """First and last of `count` widened cells in a row that meet [low, high]; last < first if none does."""
    first = np.clip(np.ceil(low - 1.0 - SLACK), 0, count)
    last = np.clip(np.floor(high + SLACK), -1, count - 1)
    return first.astype(np.int64), last.astype(np.int64)


def _mark(occupied: Bools, runs: Runs, between: Callable[[], None]) -> None:
    rows, first, last = runs
    between()
    for k, column in counted(first, last):
        between()
        occupied[rows[k], column] = True
