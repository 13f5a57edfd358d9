"""Whether two programs made the same map of a workload."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.process import Peer
from benchmarks.peers.workload_file import read_map
from ogm_core.cells.classes import trinary
from ogm_core.cells.log_odds import probability_of
from ogm_core.grid import OccupancyGrid
from ogm_core.lattice import CellRect


def log_odds_in(rect: CellRect, grid: OccupancyGrid) -> NDArray[np.float64]:
    """Log odds of a rectangle of cells that holds the map, [iy, ix]; NaN where unknown."""
    snapshot = grid.snapshot()
    log_odds = np.full((rect.height, rect.width), np.nan)
    known = np.where(snapshot.published()[1], snapshot.log_odds(), np.nan)
    x, y = snapshot.offset[0] - rect.ix, snapshot.offset[1] - rect.iy
    log_odds[y : y + snapshot.height, x : x + snapshot.width] = known
    return log_odds


def different_cells(peer: Peer, grid: OccupancyGrid, scratch: Path) -> int:
    """Number of cells whose log odds, or being known, differ in a single bit from those of the peer's map."""
    rect, theirs = _dumped(peer, scratch)
    ours = log_odds_in(rect, grid)
    return int(np.count_nonzero(~((ours == theirs) | (np.isnan(ours) & np.isnan(theirs)))))


def same_class(peer: Peer, grid: OccupancyGrid, scratch: Path) -> float:
    """Share of the cells known to both maps that are in both occupied, free or undecided."""
    rect, theirs = _dumped(peer, scratch)
    ours = log_odds_in(rect, grid)
    both = ~(np.isnan(ours) | np.isnan(theirs))
    everywhere = np.ones(np.count_nonzero(both), np.bool_)
    classes = [trinary(probability_of(log_odds[both]), everywhere) for log_odds in (ours, theirs)]
    return float(np.mean(classes[0] == classes[1]))


def _dumped(peer: Peer, scratch: Path) -> tuple[CellRect, NDArray[np.float64]]:
    path = scratch / f"{peer.name}.map"
    peer.dump(path)
    dumped = read_map(path)
    path.unlink()
    return dumped
